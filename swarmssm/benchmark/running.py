"""Measure many methods, each in a process of its own."""

import contextlib
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from swarmssm.benchmark.measure_method import METHODS, measure
from swarmssm.benchmark.measurements import (
    CachedResult,
    open_folder,
    part_path,
    read_part,
    write_failure,
    write_measured,
)
from swarmssm.benchmark.task import Task
from swarmssm.benchmark.true_rule import TrueRule, has_floor
from swarmssm.errors import InputError, WorkError
from swarmssm.jobs import Progress, Row, parallel_map

__all__ = ["Job", "jobs_of", "run_jobs"]

#: By the clock a method may take this many budgets, for learning, forecasts and a busy machine, ...
PATIENCE = 6.0
#: ... and this many seconds besides.
GRACE = 900.0


@dataclass(frozen=True)
class Job:
    """One method with one seed."""

    method: str
    seed: int


def jobs_of(methods: Sequence[str], seeds: int) -> list[Job]:
    """Return what is to be measured: a method that draws nothing, once.

    A method is one of :data:`swarmssm.benchmark.METHODS`, or ``module:attribute`` of a
    baseline of your own.

    Raises
    ------
    InputError
        If there is no such method, one stands there twice, or there are no seeds.
    """
    from swarmssm.baselines.registry import BASELINES, baseline_named

    for name in methods:
        if ":" in name:
            baseline_named(name)
        elif name not in METHODS:
            raise InputError(
                f"methods: {name!r} is unknown; choose all, some of {', '.join(METHODS)}, or name "
                "your own as module:attribute."
            )
    if len(set(methods)) < len(methods):
        raise InputError(f"methods: one stands there twice in {', '.join(methods)}.")
    if not methods:
        raise InputError("methods: none is given.")
    if seeds < 1:
        raise InputError(f"seeds: it must be at least 1, and it is {seeds}.")

    def repeats(name: str) -> int:
        # The package's own models draw; a library that is missing shows when the method runs.
        if seeds == 1 or (name not in BASELINES and ":" not in name):
            return seeds
        with contextlib.suppress(InputError):
            return seeds if baseline_named(name).is_random else 1
        return seeds

    return [Job(name, seed) for name in methods for seed in range(repeats(name))]


#: The true rule draws nothing while it learns nothing.
FLOOR_JOB = Job(TrueRule.name, 0)


def run_jobs(
    task: Task,
    jobs: Sequence[Job],
    folder: Path,
    *,
    seconds: float | None = None,
    processes: int = 1,
    progress: Callable[[Progress], None] | None = None,
) -> dict[Job, CachedResult]:
    """Measure what is not measured yet, and the noise floor of tracks of which the rule is known.

    Each job runs in a process of its own on one thread, so that its time and memory are its own and
    one that breaks down leaves the others alone; why it broke down stands in its place. What was
    measured before with the same task and budget is taken from the folder; what failed is tried
    again.

    Parameters
    ----------
    task
        Task.
    jobs
        See :func:`jobs_of`.
    folder
        For the measurements.
    seconds
        Processor seconds that each may learn.
    processes
        How many at a time.
    progress
        Called at the start and after each method.

    Raises
    ------
    InputError
        If the folder belongs to another benchmark.
    WorkError
        If nothing can be written.
    """
    open_folder(folder, {"task": json.loads(task.digest()), "seconds": seconds})
    jobs = [*([FLOOR_JOB] if has_floor(task) else []), *jobs]
    paths = {job: part_path(folder, job.method, job.seed) for job in jobs}
    kept = {job: read_part(path) for job, path in paths.items()}
    done = sum(part is not None and part.measured is not None for part in kept.values())
    missing = [job for job, part in kept.items() if part is None or part.measured is None]

    def tell(now: Progress) -> None:
        if progress is not None:
            progress(Progress(done + now.done, len(paths), now.failed))

    rows = parallel_map(
        _Measure(task, tuple(missing), seconds, folder),
        range(len(missing)),
        processes=processes,
        isolated=True,
        timeout=None if seconds is None else PATIENCE * seconds + GRACE,
        progress=tell,
    )
    for job, row in zip(missing, rows, strict=True):
        if "failed" in row:
            write_failure(paths[job], row["failed"])
    parts = {}
    for job, path in paths.items():
        part = read_part(path)
        if part is None:
            raise WorkError(f"{path}: cannot be read again.")
        parts[job] = part
    return parts


@dataclass(frozen=True)
class _Measure:
    """Measure one method, and write what was found."""

    task: Task
    jobs: tuple[Job, ...]
    seconds: float | None
    folder: Path

    def __call__(self, index: int) -> Row:
        """Return an empty row, or the reason why there is no measurement."""
        job = self.jobs[index]
        path = part_path(self.folder, job.method, job.seed)
        path.unlink(missing_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                write_measured(path, measure(self.task, job.method, self.seconds, job.seed))
            except (InputError, WorkError) as error:
                return {"failed": str(error)}
            except Exception as error:  # An error in one method leaves the others alone.
                text = str(error).strip().splitlines()
                return {"failed": f"{type(error).__name__}: {text[0] if text else 'no message'}"}
        return {}
