"""The report: one self-contained HTML file that says what a fit is worth."""

from swarmssm.analysis.report.analysis_page import analysis_page, report_analysis
from swarmssm.analysis.report.build import build_report, report_many, report_run, write_report
from swarmssm.analysis.report.gathered_page import gathered_page, report_gathered
from swarmssm.analysis.report.sections import Picture, Section, section_of

__all__ = [
    "Picture",
    "Section",
    "analysis_page",
    "build_report",
    "gathered_page",
    "report_analysis",
    "report_gathered",
    "report_many",
    "report_run",
    "section_of",
    "write_report",
]
