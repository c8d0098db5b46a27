"""Measurements as files, so that a benchmark that was interrupted goes on where it was."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from swarmssm.benchmark.measure_method import Measured
from swarmssm.errors import InputError
from swarmssm.files import write_beside

__all__ = [
    "CachedResult",
    "open_folder",
    "part_path",
    "read_part",
    "write_failure",
    "write_measured",
]

TASK = "task.json"
ARRAYS = ("crps", "log_score", "squared_error")


class CachedResult:
    """What a file holds: a measurement, or the reason why there is none."""

    def __init__(self, measured: Measured | None, reason: str) -> None:
        self.measured, self.reason = measured, reason


def open_folder(folder: Path, facts: dict[str, Any]) -> None:
    """Make the folder of measurements, or make sure that it belongs to this benchmark.

    Raises
    ------
    InputError
        If it holds measurements of other tracks or settings.
    """
    about = json.dumps(facts, indent=2, sort_keys=True)
    path = folder / TASK
    if path.exists():
        if path.read_text(encoding="utf-8") != about:
            raise InputError(
                f"{folder}: its measurements are of other tracks or settings. Choose another "
                "--out, or --overwrite them."
            )
        return
    folder.mkdir(parents=True, exist_ok=True)
    with write_beside(path) as temporary:
        temporary.write_text(about, encoding="utf-8")


def part_path(folder: Path, method: str, seed: int) -> Path:
    """Return where the measurement of a method with a seed lies."""
    return folder / f"{method.replace(':', '.')}-{seed}.npz"


def write_measured(path: Path, measured: Measured) -> None:
    """Write a measurement."""
    arrays = {name: getattr(measured, name) for name in ARRAYS}
    _write(path, {"facts": measured.facts, "reason": ""}, arrays)


def write_failure(path: Path, reason: str) -> None:
    """Write why there is none."""
    _write(path, {"facts": {}, "reason": reason}, {})


def read_part(path: Path) -> CachedResult | None:
    """Read a file; ``None`` if it is not there, or was not written by :func:`write_measured`."""
    try:
        with np.load(path) as file:
            about = json.loads(str(file["about"]))
            if about["reason"]:
                return CachedResult(None, str(about["reason"]))
            return CachedResult(Measured(about["facts"], *(file[name] for name in ARRAYS)), "")
    except (OSError, ValueError, KeyError):
        return None


def _write(path: Path, about: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Write all at once."""
    stream = io.BytesIO()
    np.savez_compressed(stream, about=np.array(json.dumps(about)), **arrays)
    with write_beside(path, overwrite=True) as temporary:
        temporary.write_bytes(stream.getvalue())
