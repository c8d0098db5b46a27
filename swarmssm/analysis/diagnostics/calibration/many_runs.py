"""Many independent pieces of work over processes, each kept in a file as it is finished.

The file has a line of JSON for each piece: whoever stops in the middle, by hand or by a power cut,
goes on where it was. Its first line says what all of them were made with.
"""

import json
import multiprocessing
import os
import pickle
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from swarmssm.errors import InputError, WorkError
from swarmssm.files import check_output

__all__ = ["PieceProgress", "parallel_map"]

#: One finished piece: what JSON can hold; it has ``failed`` if it went wrong.
Row = dict[str, Any]
#: From the number of a piece to its row. Must be known to other processes by its name.
Work = Callable[[int], Row]


@dataclass(frozen=True)
class PieceProgress:
    """How far the work has come.

    Attributes
    ----------
    done, total
        Pieces, those of earlier runs included.
    failed
        How many of those that are done went wrong.
    """

    done: int
    total: int
    failed: int


def parallel_map(
    work: Work,
    indices: Sequence[int],
    *,
    settings: Mapping[str, Any],
    out: str | Path | None = None,
    resume: bool = False,
    processes: int = 1,
    progress: Callable[[PieceProgress], None] | None = None,
) -> list[Row]:
    """Do a piece of work for each of some numbers.

    Parameters
    ----------
    work
        Called with a number. What it raises ends everything; a piece that may go wrong returns
        a row with ``failed``.
    indices
        The numbers.
    settings
        What decides the pieces, as JSON holds it; stands in the first line of the file.
    out
        File of lines of JSON; absent, nothing is kept.
    resume
        Go on with ``out`` if it is there: what stands in it is not done again. A last line that
        was not written to its end is.
    processes
        How many at once. With 1 the work is done in this process.
    progress
        Called at the beginning and after each piece.

    Returns
    -------
    The rows in the order of ``indices``, with ``index``.

    Raises
    ------
    InputError
        If ``out`` is there without ``resume``, is no such file or was made with other settings,
        ``processes`` is no positive number, or ``work`` cannot be handed to other processes.
    WorkError
        If a process dies, or nothing can be written.
    """
    if isinstance(processes, bool) or not isinstance(processes, int) or processes < 1:
        raise InputError(f"processes: there must be at least 1, not {processes!r}.")
    head = json.loads(json.dumps(dict(settings)))
    rows: dict[int, Row] = {}
    if out is not None:
        out = Path(out)
        check_output(out, overwrite=resume)
        if resume and out.exists():
            rows = _read(out, head)
    wanted = list(dict.fromkeys(indices))
    rows = {index: rows[index] for index in wanted if index in rows}
    missing = [index for index in wanted if index not in rows]

    def tell() -> None:
        if progress is not None:
            failed = sum("failed" in row for row in rows.values())
            progress(PieceProgress(len(rows), len(wanted), failed))

    tell()
    begun = out is not None and out.exists()
    try:
        with _appending(out, head) as keep:
            for index, row in _done(work, missing, processes):
                rows[index] = {"index": index, **row}
                keep(rows[index])
                tell()
    except InputError:
        # A mistake that the first piece finds leaves nothing behind.
        if out is not None and not begun and not rows:
            out.unlink(missing_ok=True)
        raise
    return [rows[index] for index in wanted]


def _done(work: Work, indices: Sequence[int], processes: int) -> Iterator[tuple[int, Row]]:
    """Yield numbers and rows as they are finished."""
    if processes == 1 or len(indices) < 2:
        for index in indices:
            yield index, work(index)
        return
    try:
        pickle.dumps(work)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            "processes: this model or guide cannot be handed to other processes. Define it at the "
            "top of a module, or take processes=1."
        ) from error
    # Not fork: threads that torch has started do not survive it.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(processes, len(indices)), context, _begin)
    try:
        running = {pool.submit(work, index): index for index in indices}
        while running:
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                index = running.pop(future)
                yield index, future.result()
    except BrokenProcessPool as error:
        raise WorkError(
            "processes: one of them was ended from outside, perhaps for want of memory. Take fewer "
            "at once, and go on from what is finished."
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Prepare a process: one thread, and no tale to tell when the user interrupts."""
    import torch

    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def _appending(out: Path | None, head: Row) -> Iterator[Callable[[Row], None]]:
    """Yield what writes a row at the end of the file, whole and at once."""
    if out is None:
        yield lambda row: None
        return
    try:
        file: TextIO
        with out.open("a", encoding="utf-8") as file:

            def keep(row: Row) -> None:
                file.write(json.dumps(row, allow_nan=False) + "\n")
                file.flush()
                os.fsync(file.fileno())

            if file.tell() == 0:
                keep({"settings": head})
            yield keep
    except OSError as error:
        raise WorkError(f"{out}: cannot be written ({error.strerror}).") from error


def _read(out: Path, head: Row) -> dict[int, Row]:
    """Return the rows of a file by their number; cut off a line that was not finished."""
    try:
        data = out.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            with out.open("r+b") as file:
                file.truncate(len(whole))
    except OSError as error:
        raise InputError(f"{out}: cannot be read ({error.strerror}).") from error
    lines = whole.splitlines()
    if not lines:
        return {}
    parsed = [_parsed(out, number, line) for number, line in enumerate(lines, 1)]
    old = parsed[0].get("settings")
    if not isinstance(old, dict):
        raise InputError(f"{out}: line 1 holds no settings; it is no file to go on with.")
    if old != head:
        names = sorted(name for name in {*old, *head} if old.get(name) != head.get(name))
        raise InputError(
            f"{out}: it was made with other settings ({', '.join(names)}). Go on with the same "
            "ones, or choose another file."
        )
    rows = {}
    for number, row in enumerate(parsed[1:], 2):
        if not isinstance(row.get("index"), int):
            raise InputError(f"{out}: line {number} has no index; it is no file to go on with.")
        rows[row["index"]] = row
    return rows


def _parsed(out: Path, number: int, line: bytes) -> Row:
    """Return what stands in a line."""
    try:
        row = json.loads(line)
    except ValueError:
        row = None
    if not isinstance(row, dict):
        raise InputError(
            f"{out}: line {number} cannot be read as JSON. Remove that line, or choose another "
            "file."
        )
    return row
