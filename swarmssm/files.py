"""Writing files so that nothing that existed is lost or half-written."""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from swarmssm.errors import InputError, WorkError

__all__ = ["check_output", "file_digest", "write_beside"]


def check_output(path: Path, *, overwrite: bool = False) -> Path:
    """Refuse an output path that cannot or must not be written, before any work is done.

    Parameters
    ----------
    path
        File or folder about to be written.
    overwrite
        Whether an existing file may be replaced.

    Returns
    -------
    The same path.

    Raises
    ------
    InputError
        If ``path`` exists and ``overwrite`` is false, is a folder, or lies in no folder.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist. Make it first.")
    if path.is_dir():
        raise InputError(f"{path}: this is a folder, and a file is to be written. Name a file.")
    if path.exists() and not overwrite:
        raise InputError(
            f"{path}: exists already and was left as it is. Choose another name or add --overwrite."
        )
    return path


@contextlib.contextmanager
def write_beside(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary path in the same folder; rename it to ``path`` when all went well.

    A reader sees the old file or the whole new one, never a part, even if the process is killed.

    Raises
    ------
    InputError
        As :func:`check_output`.
    WorkError
        If the write fails, for instance on a full disk; ``path`` is then as it was.
    """
    path = check_output(path, overwrite=overwrite)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({error.strerror}).") from error
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise WorkError(
            f"{path}: could not be written ({reason}); what was there before is unchanged."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _umask() -> int:
    """Return the process's umask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file as lower-case hexadecimal digits."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
