"""Opening what a user names: every way in which a file can be bad becomes one sentence.

The libraries below raise whatever they like on a damaged file, and believe what its header claims.
:func:`reading` turns the first into an :class:`~swarmssm.errors.InputError`, :func:`check_claim`
refuses the second before memory is asked for.
"""

import contextlib
import math
import os
import stat
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from swarmssm.errors import InputError, SwarmssmError

__all__ = ["check_claim", "check_memory", "existing", "first_bytes", "reading", "shorten"]

#: No compression in use here shrinks data by more than about this factor (deflate: 1032).
MAX_COMPRESSION = 1100
#: What any file may claim, however small it is.
FREE_CLAIM = 2**26
#: Taken as the machine's memory where the system does not tell.
UNKNOWN_MEMORY = 2**36


def existing(path: str | os.PathLike[str]) -> Path:
    """Return the path of a file or folder that is there.

    Raises
    ------
    InputError
        If there is no such file, it may not be looked at, or it is a device or a pipe.
    """
    place = Path(path)
    try:
        mode = place.stat().st_mode
    except FileNotFoundError:
        raise InputError(f"{place}: there is no such file or folder. Check the name.") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{place}: cannot be read ({reason}).") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{place}: this is neither a file nor a folder. Name a file.")
    wanted = os.R_OK | (os.X_OK if stat.S_ISDIR(mode) else 0)
    if not os.access(place, wanted, effective_ids=os.access in os.supports_effective_ids):
        raise InputError(f"{place}: cannot be read (Permission denied).")
    return place


@contextlib.contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a bad file into a sentence, and keep it from warning.

    Parameters
    ----------
    path
        The file being read.
    kind
        What it should be, for the sentence: ``"npz file"``.

    Raises
    ------
    InputError
        For every exception inside, except those of this package, which pass unchanged.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except SwarmssmError:
        raise
    except MemoryError as error:
        raise InputError(f"{path}: it needs more memory than this machine has.") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: this is a folder, and a file is needed. Name one.") from error
    except OSError as error:
        if error.errno and error.strerror:
            raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
        raise InputError(_damaged(path, kind)) from error
    except Exception as error:
        # h5py, pyarrow, zipfile and xarray have no common root: on mutated files they were seen to
        # raise KeyError, RuntimeError, NotImplementedError, struct.error, UnicodeDecodeError ...
        raise InputError(_damaged(path, kind)) from error


def _damaged(path: Path, kind: str) -> str:
    return (
        f"{path}: this is not a whole {kind}; it is cut short or damaged. Copy or export it again."
    )


def check_claim(path: Path, name: str, shape: Sequence[int], itemsize: int) -> int:
    """Refuse an array whose claimed size its file cannot hold, or this machine cannot.

    Parameters
    ----------
    path
        The file, whose size on disk bounds what it can hold.
    name
        Which array, for the sentence.
    shape, itemsize
        What the header claims.

    Returns
    -------
    Its size in bytes.

    Raises
    ------
    InputError
        If the claim is negative, more than the file could hold if it were compressed as far as is
        possible, or more than this machine's memory.
    """
    if any(size < 0 for size in shape):
        raise InputError(f"{path}: array {name} claims the shape {tuple(shape)}; it is damaged.")
    claimed = math.prod(int(size) for size in shape) * itemsize
    held = path.stat().st_size
    if claimed > max(held * MAX_COMPRESSION, FREE_CLAIM):
        raise InputError(
            f"{path}: array {name} claims {_gigabytes(claimed)} GB, which a file of {held} bytes "
            "cannot hold. It is damaged; copy or export it again."
        )
    check_memory(path, claimed, f"array {name}")
    return claimed


def check_memory(path: Path, size: int, what: str) -> None:
    """Refuse ``what`` of ``size`` bytes if this machine has not as much memory.

    Raises
    ------
    InputError
        Naming the file and both sizes.
    """
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        memory = UNKNOWN_MEMORY
    if size > memory:
        raise InputError(
            f"{path}: {what} would take {_gigabytes(size)} GB, and this machine has "
            f"{_gigabytes(memory)} GB of memory. Cut the recording into parts."
        )


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.3g}" if size < 1e300 else "endless"


def first_bytes(path: Path, count: int = 4096) -> bytes:
    """Return the first bytes of a file.

    Raises
    ------
    InputError
        If it cannot be opened, or is empty.
    """
    with reading(path, "file"), path.open("rb") as stream:
        start = stream.read(count)
    if not start:
        raise InputError(f"{path}: the file is empty. Export it again.")
    return start


def shorten(text: object, length: int = 40) -> str:
    """Return a text from a file fit for a sentence: printable, in quotes, and not long."""
    shown = repr(str(text))
    return shown if len(shown) <= length else f"{shown[: length - 4]}...{shown[0]}"
