"""What studies of simulated data share: running the fits, counting failures, checking numbers."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swarmssm.errors import InputError, WorkError
from swarmssm.jobs import Progress, Row, Work, parallel_map

__all__ = ["check_whole", "failures", "name_of", "run_study"]


def run_study(
    work: Work,
    count: int,
    settings: Mapping[str, Any],
    *,
    out: str | Path | None,
    resume: bool,
    processes: int,
    progress: Callable[[Progress], None] | None,
) -> list[Row]:
    """Return the rows of all simulated data sets, see :func:`swarmssm.jobs.parallel_map`.

    Raises
    ------
    InputError
        As ``parallel_map``.
    WorkError
        If all data sets failed, or nothing can be written.
    """
    rows = parallel_map(
        work,
        range(count),
        settings=settings,
        out=out,
        resume=resume,
        processes=processes,
        progress=progress,
    )
    if all("failed" in row for row in rows):
        raise WorkError(f"All {count} data sets failed; the first one: {rows[0]['failed']}")
    return rows


def failures(rows: Sequence[Row]) -> dict[str, Any]:
    """Return ``failed``, the number of failed data sets, and ``failures``, the reasons."""
    failed = [str(row["failed"]) for row in rows if "failed" in row]
    reasons = sorted({reason: failed.count(reason) for reason in failed}.items())
    return {
        "failed": len(failed),
        "failures": "; ".join(f"{count} x {reason}" for reason, count in reasons),
    }


def check_whole(name: str, value: Any, least: int) -> None:
    """Raise an ``InputError`` unless a value is a whole number from ``least``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{name}: it must be a whole number from {least}, not {value!r}.")


def name_of(part: str | Callable[..., Any]) -> str:
    """Return the name of a model or guide."""
    return part if isinstance(part, str) else getattr(part, "__qualname__", repr(part))
