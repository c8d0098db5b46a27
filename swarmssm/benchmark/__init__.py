"""Every method on the same tracks, with the same scores, in one table."""

from swarmssm.benchmark.measure_method import FLOOR, METHODS, Measured, measure
from swarmssm.benchmark.models import MODELS
from swarmssm.benchmark.results import Results, collect
from swarmssm.benchmark.running import Job, jobs_of, run_jobs
from swarmssm.benchmark.task import Task, make_task
from swarmssm.benchmark.writing import (
    benchmark_page,
    check_outputs,
    markdown,
    write_results,
)

__all__ = [
    "FLOOR",
    "METHODS",
    "MODELS",
    "Job",
    "Measured",
    "Results",
    "Task",
    "benchmark_page",
    "check_outputs",
    "collect",
    "jobs_of",
    "make_task",
    "markdown",
    "measure",
    "run_jobs",
    "write_results",
]
