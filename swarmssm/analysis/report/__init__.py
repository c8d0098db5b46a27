"""The report: one self-contained HTML file that says what a fit is worth."""

from swarmssm.analysis.report.analysis_page import analysis_page, report_analysis
from swarmssm.analysis.report.build import build_report, full_section, report_run, write_report
from swarmssm.analysis.report.gathered_page import gathered_page, report_gathered
from swarmssm.analysis.report.player import (
    player_assets,
    player_fragment,
    player_html,
    write_player,
)
from swarmssm.analysis.report.sections import Picture, Section, section_of

__all__ = [
    "Picture",
    "Section",
    "analysis_page",
    "build_report",
    "full_section",
    "gathered_page",
    "player_assets",
    "player_fragment",
    "player_html",
    "report_analysis",
    "report_gathered",
    "report_run",
    "section_of",
    "write_player",
    "write_report",
]
