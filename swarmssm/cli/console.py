"""What the subcommands share: tables, JSON, progress, named values."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import rich.console
import rich.progress
import rich.table
import typer

from swarmssm.errors import InputError

if TYPE_CHECKING:
    from swarmssm.analysis import Evaluation
    from swarmssm.inference import Progress

__all__ = [
    "Overwrite",
    "Seed",
    "TableFormat",
    "TrustCode",
    "named_texts",
    "named_values",
    "print_evaluation",
    "print_json",
    "print_table",
    "say",
    "short",
    "training_progress",
    "write_json",
]

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Seed = Annotated[int, typer.Option(help="Seed of all random draws.", min=0)]
TrustCode = Annotated[
    bool,
    typer.Option("--trust-code", help="Let a run import the module:attribute that it names."),
]
#: Seconds between two lines of progress where there is no terminal.
LINE_EVERY = 10.0


class TableFormat(StrEnum):
    """How a table is printed."""

    text = "text"
    json = "json"


def say(text: str) -> None:
    """Print a line for a person."""
    typer.echo(text)


def short(value: object) -> str:
    """Return a number with three significant digits, and a dash for what is not known."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}"
    return str(value)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table: names to the left, numbers to the right."""
    table = rich.table.Table(title=title or None, title_justify="left", show_header=any(columns))
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*(rich.markup.escape(short(cell)) for cell in row))
    width = None if sys.stdout.isatty() else 120
    rich.console.Console(width=width, highlight=False).print(table)


def print_rows(title: str, rows: Sequence[Mapping[str, object]]) -> None:
    """Print rows that all have the same columns."""
    if rows:
        print_table(title, list(rows[0]), [list(row.values()) for row in rows])


def print_evaluation(title: str, result: "Evaluation", thesis: str | None = None) -> None:
    """Print the scores of a fit beside those of its rivals, and of the thesis if asked."""
    from swarmssm import analysis

    print_rows(title, analysis.scores_table(result, thesis))
    if thesis is not None:
        say(analysis.THESIS_FOOTNOTE)
    print_rows("squared error at each step ahead, scaled states", analysis.horizon_table(result))
    print_rows(
        "log score of positions at each step ahead, nats per coordinate (higher is better)",
        analysis.horizon_table(result, "log_score"),
    )
    print_rows("edges of the next graph", analysis.edge_table(result))
    for note in result.notes:
        say(note)


def print_json(value: object) -> None:
    """Print JSON; what is not a finite number becomes null."""
    typer.echo(json.dumps(_plain(value), indent=2))


def write_json(value: object, path: Path, *, overwrite: bool) -> None:
    """Write JSON beside and rename."""
    from swarmssm.files import write_beside

    with write_beside(path, overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(_plain(value), indent=2) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """Return a value as JSON holds it."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def named_values(pairs: Sequence[str], option: str) -> dict[str, Any]:
    """Read ``name=value`` pairs; a value is a number, JSON, or else text.

    Raises
    ------
    InputError
        If one has no ``=``, or a name stands twice.
    """
    values: dict[str, Any] = {}
    for name, text in named_texts(pairs, option).items():
        try:
            values[name] = json.loads(text)
        except ValueError:
            values[name] = text
    return values


def named_texts(pairs: Sequence[str], option: str) -> dict[str, str]:
    """Read ``name=text`` pairs as they are.

    Raises
    ------
    InputError
        If one has no ``=``, or a name stands twice.
    """
    texts: dict[str, str] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise InputError(f"{option}: {pair!r} is not of the form name=value.")
        if name in texts:
            raise InputError(f"{option}: {name} stands there twice.")
        texts[name] = text.strip()
    return texts


@contextmanager
def training_progress(label: str) -> Iterator[Callable[["Progress"], None]]:
    """Show how training goes on: a bar on a terminal, plain lines elsewhere."""
    if sys.stderr.isatty():
        columns = (
            rich.progress.TextColumn("{task.description}"),
            rich.progress.BarColumn(),
            rich.progress.MofNCompleteColumn(),
            rich.progress.TimeRemainingColumn(),
            rich.progress.TextColumn("loss {task.fields[loss]}"),
        )
        console = rich.console.Console(stderr=True)
        with rich.progress.Progress(*columns, console=console) as bar:
            task = bar.add_task(label, total=None, loss="-")

            def show(progress: "Progress") -> None:
                bar.update(
                    task,
                    completed=progress.epoch,
                    total=progress.num_epochs,
                    loss=short(progress.loss),
                )

            yield show
        return
    last = time.monotonic()

    def line(progress: "Progress") -> None:
        nonlocal last
        done = progress.epoch == progress.num_epochs
        whole = "" if progress.num_epochs is None else f" of {progress.num_epochs}"
        if done or time.monotonic() - last >= LINE_EVERY:
            last = time.monotonic()
            typer.echo(
                f"{label}: epoch {progress.epoch}{whole}, loss {short(progress.loss)}",
                err=True,
            )

    yield line
