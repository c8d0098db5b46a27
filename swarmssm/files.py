"""Writing files so that nothing that existed is lost or half-written."""

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from swarmssm.errors import InputError, SwarmssmError, WorkError

__all__ = ["check_output", "file_digest", "write_beside"]

#: Bytes; a disk with less is full.
SMALLEST_SPACE = 4096


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
        If ``path`` exists and ``overwrite`` is false, is a folder or a device, or lies in no
        folder.
    """
    path = Path(path)
    try:
        if not path.parent.is_dir():
            raise InputError(f"{path}: the folder {path.parent} does not exist. Make it first.")
        if path.is_dir():
            raise InputError(f"{path}: this is a folder, and a file is to be written. Name a file.")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: this is no ordinary file, and would be lost. Name a file.")
        if path.exists() and not overwrite:
            raise InputError(
                f"{path}: exists already and was left as it is. Choose another name or add "
                "overwrite=True."
            )
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}). Name another.") from error
    return path


@contextlib.contextmanager
def write_beside(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary path in the same folder; rename it to ``path`` when all went well.

    A reader sees the old file or the whole new one, never a part, even if the process is killed.
    A replaced file keeps its permissions, and a link goes on pointing to the file that is replaced.
    The temporary name ends in ``.part``: a writer that goes by the name's ending, as
    :func:`numpy.savez` does, must be given an open stream or the format.

    Raises
    ------
    InputError
        As :func:`check_output`.
    WorkError
        If the write fails, for instance on a full disk; ``path`` is then as it was.
    """
    path = check_output(path, overwrite=overwrite)
    try:
        target = check_output(Path(os.path.realpath(path)), overwrite=overwrite)
        name = f".{target.name[:40]}.{secrets.token_hex(8)}.part"
        temporary = target.with_name(name)
        mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({error.strerror}).") from error
    try:
        if mode is not None:
            # What nobody else may read is not shown while it is written either.
            temporary.chmod(mode | stat.S_IRUSR | stat.S_IWUSR)
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        if mode is not None:
            temporary.chmod(mode)
        os.replace(temporary, target)
    except SwarmssmError:
        raise
    except Exception as error:
        reason = _reason(error, target.parent)
        if reason is None:
            raise
        raise WorkError(
            f"{path}: could not be written ({reason}); what was there before is unchanged."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _reason(error: Exception, folder: Path) -> str | None:
    """Return why the system refused a write, or None if that is not what went wrong.

    HDF5 and safetensors hide the system's words or its number in a message of their own, and torch
    tells of a full disk by a position that it did not expect.
    """
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    hidden = re.search(r"\b(?:errno|os error)\W{1,3}(\d+)", str(error))
    if hidden:
        return os.strerror(int(hidden[1]))
    if shutil.disk_usage(folder).free < SMALLEST_SPACE:
        return os.strerror(errno.ENOSPC)
    if isinstance(error, OSError):
        return str(error).partition("\n")[0] or type(error).__name__
    return None


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file as lower-case hexadecimal digits.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with Path(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
