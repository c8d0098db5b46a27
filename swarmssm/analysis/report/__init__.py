"""Reports: one self-contained HTML page of blocks for a run, an analysis or a comparison."""

from swarmssm.analysis.report.compare import comparison_page
from swarmssm.analysis.report.page import (
    Figure,
    Grid,
    Note,
    Page,
    Player,
    Prose,
    Section,
    Table,
    Verdict,
    figure,
)
from swarmssm.analysis.report.player import player_fragment, player_page
from swarmssm.analysis.report.run import analysis_page, run_page, run_section

__all__ = [
    "Figure",
    "Grid",
    "Note",
    "Page",
    "Player",
    "Prose",
    "Section",
    "Table",
    "Verdict",
    "analysis_page",
    "comparison_page",
    "figure",
    "player_fragment",
    "player_page",
    "run_page",
    "run_section",
]
