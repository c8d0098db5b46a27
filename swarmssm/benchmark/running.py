"""Measure many methods, each in a process of its own."""

import contextlib
import json
import math
import multiprocessing
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from pathlib import Path

from swarmssm.benchmark.parts import (
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

__all__ = ["Job", "jobs_of", "run_jobs"]

#: Seconds between two looks at the processes.
LOOK = 0.2
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
    from swarmssm.benchmark.measuring import METHODS

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
    progress: Callable[[int, int, str], None] | None = None,
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
        Told how many of how many are done, and which was done last.

    Raises
    ------
    InputError
        If the folder belongs to another benchmark.
    WorkError
        If nothing can be written.
    """
    if processes < 1:
        raise InputError(f"jobs: it must be at least 1, and it is {processes}.")
    open_folder(folder, {"task": json.loads(task.digest()), "seconds": seconds})
    jobs = [*([FLOOR_JOB] if has_floor(task) else []), *jobs]
    done: dict[Job, CachedResult] = {}
    for job in jobs:
        part = read_part(part_path(folder, job.method, job.seed))
        if part is not None and part.measured is not None:
            done[job] = part
    waiting = [job for job in jobs if job not in done]
    if progress is not None:
        progress(len(done), len(jobs), "")
    running: dict[Job, tuple[BaseProcess, float]] = {}
    context = _context()
    limit = math.inf if seconds is None else PATIENCE * seconds + GRACE
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                job = waiting.pop(0)
                path = part_path(folder, job.method, job.seed)
                work = (task, job, seconds, path)
                process = context.Process(target=_work, args=work, daemon=True)  # type: ignore[attr-defined]
                process.start()
                running[job] = (process, time.monotonic())
            time.sleep(LOOK)
            for job, (process, began) in list(running.items()):
                path = part_path(folder, job.method, job.seed)
                late = time.monotonic() - began > limit
                if process.is_alive() and not late:
                    continue
                del running[job]
                if process.is_alive():
                    process.kill()
                    write_failure(path, f"It had not finished after {limit / 60.0:.0f} minutes.")
                process.join()
                part = read_part(path)
                if part is None or (process.exitcode != 0 and part.measured is not None):
                    write_failure(path, f"Its process died ({process.exitcode}).")
                    part = read_part(path)
                if part is None:
                    raise WorkError(f"{path}: cannot be read again.")
                done[job] = part
                if progress is not None:
                    progress(len(done), len(jobs), job.method)
    finally:
        for process, _ in running.values():
            process.kill()
    return {job: done[job] for job in jobs}


def _context() -> BaseContext:
    """Return how processes begin: where it can be, as copies of one that has imported all."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["swarmssm.benchmark.measuring"])
    return context


def _work(task: Task, job: Job, seconds: float | None, path: Path) -> None:
    """Measure one method, in a process of its own."""
    import warnings

    import torch

    from swarmssm.benchmark.measuring import measure

    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    path.unlink(missing_ok=True)
    try:
        write_measured(path, measure(task, job.method, seconds, job.seed))
    except (InputError, WorkError) as error:
        write_failure(path, str(error))
    except Exception as error:  # A method's own mistake becomes its row; the others go on.
        text = str(error).strip().splitlines()
        write_failure(path, f"{type(error).__name__}: {text[0] if text else 'no message'}")
