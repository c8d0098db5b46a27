"""How far long work has come: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import rich.console
import rich.progress
import typer

from swarmssm.cli.console import short

if TYPE_CHECKING:
    from swarmssm.inference import TrainingProgress
    from swarmssm.jobs import Progress

__all__ = ["counting_progress", "stages", "training_progress"]

#: Seconds between two lines where there is no terminal.
LINE_EVERY = 10.0


@contextmanager
def training_progress(label: str) -> Iterator[Callable[["TrainingProgress"], None]]:
    """Show how training goes on."""
    if sys.stderr.isatty():
        with _bar(label, "loss -") as show:
            yield lambda now: show(now.epoch, now.num_epochs, f"loss {short(now.loss)}")
        return
    lines = _Lines(label)

    def line(now: "TrainingProgress") -> None:
        whole = "" if now.num_epochs is None else f" of {now.num_epochs}"
        text = f"epoch {now.epoch}{whole}, loss {short(now.loss)}"
        lines.tell(text, at_once=now.epoch == now.num_epochs)

    yield line


@contextmanager
def counting_progress(
    label: str, things: str = "data sets"
) -> Iterator[Callable[["Progress"], None]]:
    """Show how many things are done, such as simulated data sets."""
    if sys.stderr.isatty():
        with _bar(label) as show:
            yield lambda now: show(now.done, now.total, _failed(now))
        return
    lines = _Lines(label)
    began = time.monotonic()
    first: int | None = None

    def line(now: "Progress") -> None:
        nonlocal first
        begins = first is None
        first = now.done if first is None else first
        text = f"{now.done} of {now.total} {things}"
        if now.failed:
            text += f", {_failed(now)}"
        own = now.done - first
        if own and now.done < now.total:
            left = (time.monotonic() - began) / own * (now.total - now.done)
            text += f", about {short(left / 60.0)} min left"
        lines.tell(text, at_once=begins or now.done == now.total)

    yield line


def _failed(now: "Progress") -> str:
    return f"{now.failed} failed" if now.failed else ""


@contextmanager
def _bar(label: str, beside: str = "") -> Iterator[Callable[[int, int | None, str], None]]:
    """Show a bar; yield what is told how much of how much is done, and words beside it."""
    columns = (
        rich.progress.TextColumn("{task.description}"),
        rich.progress.BarColumn(),
        rich.progress.MofNCompleteColumn(),
        rich.progress.TimeRemainingColumn(),
        rich.progress.TextColumn("{task.fields[beside]}"),
    )
    with rich.progress.Progress(*columns, console=rich.console.Console(stderr=True)) as bar:
        task = bar.add_task(label, total=None, beside=beside)
        yield lambda done, total, words: bar.update(task, completed=done, total=total, beside=words)


class _Lines:
    """Lines, none too soon after the last."""

    def __init__(self, label: str) -> None:
        self.label = label
        self.last = time.monotonic()

    def tell(self, text: str, *, at_once: bool) -> None:
        """Print a line, at once or else if the last one is long ago."""
        now = time.monotonic()
        if at_once or now - self.last >= LINE_EVERY:
            self.last = now
            typer.echo(f"{self.label}: {text}", err=True)


@contextmanager
def stages() -> Iterator[Callable[[str], None]]:
    """Show what is being done: a moving line on a terminal, plain lines elsewhere."""
    if sys.stderr.isatty():
        with rich.console.Console(stderr=True).status("beginning") as status:
            yield status.update
        return
    yield lambda what: typer.echo(what, err=True)
