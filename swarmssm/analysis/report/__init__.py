"""The report: one self-contained HTML file that says what a fit is worth."""

from swarmssm.analysis.report.analysis_page import analysis_page, report_analysis
from swarmssm.analysis.report.build import build_report, report_many, report_run, write_report
from swarmssm.analysis.report.sections import Picture, Section, section_of

__all__ = [
    "Picture",
    "Section",
    "analysis_page",
    "build_report",
    "report_analysis",
    "report_many",
    "report_run",
    "section_of",
    "write_report",
]
