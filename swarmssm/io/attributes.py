"""What a file says beside its arrays, as attributes that a NetCDF file can hold."""

import json
from pathlib import PurePath
from typing import Any

import numpy as np

__all__ = ["plain_attribute"]

#: An attribute of HDF5 may not be much longer.
MAX_BYTES = 60_000


def plain_attribute(value: object) -> Any:
    """Return a value as number, text or one-dimensional array; what is nested as JSON text.

    Returns
    -------
    The value, or None if there is nothing to say, it is too long, or has no such form.
    """
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, PurePath):
        value = str(value)
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float | str):
        fits = not isinstance(value, str) or len(value.encode("utf-8", "replace")) <= MAX_BYTES
        return value if fits else None
    if isinstance(value, int):
        return value if -(2**63) <= value < 2**63 else float(value)
    if not isinstance(value, dict | list | tuple | set) or not value:
        return None
    if isinstance(value, list) and all(type(item) in (int, float) for item in value):
        array = np.array(value)
        return array if array.dtype.kind in "if" and array.nbytes <= MAX_BYTES else None
    try:
        text = json.dumps(value, default=_jsonable, ensure_ascii=False)
    except (TypeError, ValueError, RecursionError):
        return None
    return text if len(text.encode("utf-8", "replace")) <= MAX_BYTES else None


def _jsonable(value: object) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, set):
        return sorted(value, key=str)
    return str(value)
