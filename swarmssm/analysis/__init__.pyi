from . import diagnostics, interpretation, plots, posterior, report, scoring
from .diagnostics.checks import (
    STATISTICS,
    ObservedSwarm,
    Statistic,
    check,
    loo_pit,
    one_step_pit,
)
from .diagnostics.recovery.study import recovery
from .diagnostics.sbc.study import sbc
from .interpretation.analyze import analyze
from .interpretation.forces import (
    force_agreement,
    force_maps,
    force_summary,
    posterior_forces,
    true_forces,
)
from .interpretation.inferred_edges import inferred_edges
from .interpretation.influence import find_isolated, find_leader, leadership_delays
from .interpretation.kernels import (
    interaction_kernels,
    kernel_agreement,
    true_kernels,
)
from .interpretation.latents import latent_force_alignment
from .interpretation.result import Analysis
from .plots.scenes import with_free_run
from .posterior import (
    to_inference_data,
)
from .report import (
    Page,
    analysis_page,
    comparison_page,
    run_page,
    run_section,
)
from .scoring import (
    Comparison,
    Evaluation,
    compare,
    evaluate,
    paired_difference,
    score,
    score_intervals,
    score_table,
    skill,
    summary,
    verdict,
)
from .scoring.table import format_number
from .scoring.thesis_scores import edge_table, horizon_table, scores_table

__all__ = [
    "STATISTICS",
    "Analysis",
    "Comparison",
    "Evaluation",
    "ObservedSwarm",
    "Page",
    "Statistic",
    "analysis_page",
    "analyze",
    "check",
    "compare",
    "comparison_page",
    "diagnostics",
    "edge_table",
    "evaluate",
    "find_isolated",
    "find_leader",
    "force_agreement",
    "force_maps",
    "force_summary",
    "format_number",
    "horizon_table",
    "inferred_edges",
    "interaction_kernels",
    "interpretation",
    "kernel_agreement",
    "latent_force_alignment",
    "leadership_delays",
    "loo_pit",
    "one_step_pit",
    "paired_difference",
    "plots",
    "posterior",
    "posterior_forces",
    "recovery",
    "report",
    "run_page",
    "run_section",
    "sbc",
    "score",
    "score_intervals",
    "score_table",
    "scores_table",
    "scoring",
    "skill",
    "summary",
    "to_inference_data",
    "true_forces",
    "true_kernels",
    "verdict",
    "with_free_run",
]
