"""Many independent pieces of work over processes, each kept in a file as it is finished.

The file has a line of JSON for each piece, so that an interrupted study resumes where it stopped.
Its first line holds the settings that all pieces share.
"""

import json
import multiprocessing
import os
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TextIO

from swarmssm.errors import InputError, WorkError
from swarmssm.files import check_output

__all__ = ["Progress", "Row", "Work", "parallel_map"]

#: Result of one piece, as JSON holds it; it has ``failed`` (the reason) if the piece failed.
Row = dict[str, Any]
#: From the number of a piece to its row. Importable by other processes.
Work = Callable[[int], Row]


@dataclass(frozen=True)
class Progress:
    """Progress of work that is counted in pieces.

    Attributes
    ----------
    done, total
        Numbers of pieces, those of resumed runs included.
    failed
        How many of the finished pieces failed.
    """

    done: int
    total: int
    failed: int = 0


@dataclass
class _Running:
    """A process at work on one piece."""

    index: int
    process: BaseProcess
    deadline: float


def parallel_map(
    work: Work,
    indices: Sequence[int],
    *,
    settings: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    processes: int = 1,
    isolated: bool = False,
    timeout: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> list[Row]:
    """Compute a row for each index.

    Parameters
    ----------
    work
        Called with an index. An exception ends the whole call; a piece that may fail returns a row
        with ``failed``.
    indices
        Indices of the pieces.
    settings
        What determines the rows, as JSON holds it; the first line of the file.
    out
        File of JSON lines; absent, nothing is kept.
    resume
        Continue ``out`` if it exists: rows in it are not computed again. An incomplete last line
        is.
    processes
        Pieces at once. Each runs on one thread in a process of its own, except that with
        ``processes=1`` and without ``isolated`` all run in this process.
    isolated
        A process of its own for each piece in any case; one that dies, or takes longer than
        ``timeout``, yields a row with ``failed`` while the other pieces continue.
    timeout
        Seconds that an isolated piece may take; absent, any number.
    progress
        Called at the start and after each piece.

    Returns
    -------
    The rows in the order of ``indices``, each with its ``index``.

    Raises
    ------
    InputError
        If ``out`` exists and ``resume`` is false, is not such a file or has other settings;
        ``processes`` is not positive; or ``work`` cannot be pickled for other processes.
    WorkError
        If a process dies that is not isolated, or the file cannot be written.
    """
    if isinstance(processes, bool) or not isinstance(processes, int) or processes < 1:
        raise InputError(f"processes: it must be a whole number from 1, not {processes!r}.")
    head = json.loads(json.dumps(dict(settings or {})))
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
            progress(Progress(len(rows), len(wanted), failed))

    tell()
    existed = out is not None and out.exists()
    limit = float("inf") if timeout is None else timeout
    try:
        with _appending(out, head) as keep:
            for index, row in _finished(work, missing, processes, isolated, limit):
                rows[index] = {"index": index, **row}
                keep(rows[index])
                tell()
    except InputError:
        # An invalid argument that the first piece finds leaves no file behind.
        if out is not None and not existed and not rows:
            out.unlink(missing_ok=True)
        raise
    return [rows[index] for index in wanted]


def _finished(
    work: Work, indices: Sequence[int], processes: int, isolated: bool, limit: float
) -> Iterator[tuple[int, Row]]:
    """Yield indices and rows in the order in which they are finished."""
    if not isolated and (processes == 1 or len(indices) < 2):
        for index in indices:
            yield index, work(index)
        return
    try:
        pickle.dumps(work)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            "processes: this model or guide cannot be sent to other processes. Define it at the "
            "top level of a module, or use processes=1."
        ) from error
    context = _context(work)
    waiting = list(indices)
    running: dict[connection.Connection, _Running] = {}
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                receiver, one = _start(context, work, waiting.pop(0), limit)
                running[receiver] = one
            soonest = min(one.deadline for one in running.values())
            left = None if soonest == float("inf") else max(0.0, soonest - time.monotonic())
            ready = connection.wait(list(running), left)
            for receiver in [one for one in running if one in ready]:
                one = running.pop(receiver)
                yield one.index, _received(receiver, one, isolated)
            for receiver, one in list(running.items()):
                if time.monotonic() > one.deadline:
                    del running[receiver]
                    one.process.kill()
                    one.process.join()
                    yield one.index, {"failed": f"It was stopped after {limit / 60.0:.0f} minutes."}
    finally:
        for one in running.values():
            one.process.kill()
            one.process.join()


def _context(work: Work) -> BaseContext:
    """Return how processes start: copies of a server that has imported the work, or afresh.

    Never copies of this process: threads that torch has started do not survive a fork.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    module = getattr(work, "__module__", None) or type(work).__module__
    context.set_forkserver_preload([module])
    return context


def _start(
    context: BaseContext, work: Work, index: int, limit: float
) -> tuple[connection.Connection, _Running]:
    """Start a process for one piece; return where its result arrives."""
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(  # type: ignore[attr-defined]
        target=_work, args=(work, index, sender), daemon=True
    )
    process.start()
    sender.close()
    return receiver, _Running(index, process, time.monotonic() + limit)


def _received(receiver: connection.Connection, one: _Running, isolated: bool) -> Row:
    """Return the row of a process that has sent it, or has ended."""
    try:
        result = receiver.recv()
    except EOFError:
        result = None
    receiver.close()
    one.process.join()
    if isinstance(result, Exception):
        raise result
    if isinstance(result, dict):
        return result
    if isolated:
        return {"failed": f"Its process died (exit status {one.process.exitcode})."}
    raise WorkError(
        f"processes: one of them died (exit status {one.process.exitcode}), perhaps for lack of "
        "memory. Use fewer at once, and resume from what is finished."
    )


def _work(work: Work, index: int, sender: connection.Connection) -> None:
    """Compute one row in a process of its own, and send it, or the exception."""
    _prepare_process()
    result: Row | Exception
    try:
        result = work(index)
    except Exception as error:
        error.add_note(traceback.format_exc())
        result = error
    try:
        sender.send(result)
    except Exception as error:  # What cannot be pickled is told in words.
        sender.send(WorkError(f"The result of piece {index} cannot be sent ({error})."))


def _prepare_process() -> None:
    """Use one thread, and end without a traceback when the user interrupts."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    else:  # Read when torch is imported.
        os.environ["OMP_NUM_THREADS"] = "1"
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def _appending(out: Path | None, head: Row) -> Iterator[Callable[[Row], None]]:
    """Yield a function that appends a whole row to the file."""
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
    """Return the rows of a file by their index; an incomplete last line is cut off."""
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
        raise InputError(f"{out}: line 1 holds no settings; it cannot be continued.")
    if old != head:
        names = sorted(name for name in {*old, *head} if old.get(name) != head.get(name))
        raise InputError(
            f"{out}: it was made with other settings ({', '.join(names)}). Use the same ones, or "
            "another file."
        )
    rows = {}
    for number, row in enumerate(parsed[1:], 2):
        if not isinstance(row.get("index"), int):
            raise InputError(f"{out}: line {number} has no index; it cannot be continued.")
        rows[row["index"]] = row
    return rows


def _parsed(out: Path, number: int, line: bytes) -> Row:
    """Return the object in a line."""
    try:
        row = json.loads(line)
    except ValueError:
        row = None
    if not isinstance(row, dict):
        raise InputError(
            f"{out}: line {number} cannot be read as JSON. Remove that line, or use another file."
        )
    return row
