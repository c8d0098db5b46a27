"""Labelled posteriors, forces, checks, comparison, plots and the report."""

from swarmssm.analysis.evaluate import evaluate
from swarmssm.analysis.evaluation import Evaluation
from swarmssm.analysis.report import build_report, report_many, report_run, write_report
from swarmssm.analysis.table import edge_table, format_number, horizon_table, scores_table
from swarmssm.analysis.thesis import FOOTNOTE as THESIS_FOOTNOTE

__all__ = [
    "THESIS_FOOTNOTE",
    "Evaluation",
    "build_report",
    "edge_table",
    "evaluate",
    "format_number",
    "horizon_table",
    "report_many",
    "report_run",
    "scores_table",
    "write_report",
]
