"""Labelled posteriors, forces, checks, comparison, plots and the reports.

Of several functions of one name - each analysis has a ``sentence`` of its own - the module says
which is meant.
"""

from swarmssm.analysis.diagnostics.checks import (
    STATISTICS,
    Statistic,
    Swarm,
    check,
    loo_pit,
    one_step_pit,
)
from swarmssm.analysis.diagnostics.checks import sentence as check_sentence
from swarmssm.analysis.diagnostics.recovery.study import recovery
from swarmssm.analysis.diagnostics.sbc.study import sbc
from swarmssm.analysis.interpretation.analyze import analyze
from swarmssm.analysis.interpretation.forces import (
    force_agreement,
    force_map,
    force_maps,
    force_summary,
    posterior_forces,
    raw_force_map,
    true_forces,
)
from swarmssm.analysis.interpretation.inferred_edges import inferred_edges
from swarmssm.analysis.interpretation.influence import find_isolated, find_leader, leadership_delays
from swarmssm.analysis.interpretation.kernels import (
    interaction_kernels,
    kernel_agreement,
    true_kernels,
)
from swarmssm.analysis.interpretation.latents import latent_force_alignment
from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.plots.scenes import free_run, scenes_of, with_free_run
from swarmssm.analysis.posterior import (
    pointwise_log_likelihood,
    to_inference_data,
    window_log_likelihood,
)
from swarmssm.analysis.posterior.accelerations import (
    AccelerationModel,
    PosteriorPaths,
    acceleration_model,
    posterior_paths,
)
from swarmssm.analysis.report import (
    analysis_page,
    build_report,
    full_section,
    gathered_page,
    report_analysis,
    report_gathered,
    report_run,
    write_report,
)
from swarmssm.analysis.scoring import (
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
from swarmssm.analysis.scoring.forecast_fans import forecast_fan
from swarmssm.analysis.scoring.table import format_number
from swarmssm.analysis.scoring.thesis import FOOTNOTE as THESIS_FOOTNOTE
from swarmssm.analysis.scoring.thesis_scores import edge_table, horizon_table, scores_table

__all__ = [
    "STATISTICS",
    "THESIS_FOOTNOTE",
    "AccelerationModel",
    "Analysis",
    "Comparison",
    "Evaluation",
    "PosteriorPaths",
    "Statistic",
    "Swarm",
    "acceleration_model",
    "analysis_page",
    "analyze",
    "build_report",
    "check",
    "check_sentence",
    "compare",
    "edge_table",
    "evaluate",
    "find_isolated",
    "find_leader",
    "force_agreement",
    "force_map",
    "force_maps",
    "force_summary",
    "forecast_fan",
    "format_number",
    "free_run",
    "full_section",
    "gathered_page",
    "horizon_table",
    "inferred_edges",
    "interaction_kernels",
    "kernel_agreement",
    "latent_force_alignment",
    "leadership_delays",
    "loo_pit",
    "one_step_pit",
    "paired_difference",
    "pointwise_log_likelihood",
    "posterior_forces",
    "posterior_paths",
    "raw_force_map",
    "recovery",
    "report_analysis",
    "report_gathered",
    "report_run",
    "sbc",
    "scenes_of",
    "score",
    "score_intervals",
    "score_table",
    "scores_table",
    "skill",
    "summary",
    "to_inference_data",
    "true_forces",
    "true_kernels",
    "verdict",
    "window_log_likelihood",
    "with_free_run",
    "write_report",
]
