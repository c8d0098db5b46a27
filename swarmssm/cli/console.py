"""What the subcommands print: lines, tables, JSON."""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import rich.console
import rich.markup
import rich.table
import typer

if TYPE_CHECKING:
    from swarmssm.analysis import Evaluation

__all__ = [
    "print_all_scores",
    "print_evaluation",
    "print_json",
    "print_rows",
    "print_table",
    "say",
    "short",
    "write_json",
]

#: What the text of a number starts with, or of one that is not there.
NUMBER = "0123456789-–+.±"


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
    """Print a table: words to the left, numbers to the right."""
    console = rich.console.Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    table = rich.table.Table(title=title or None, title_justify="left", show_header=any(columns))
    texts = [[short(cell) for cell in row] for row in rows]
    together = list(zip(columns, *texts, strict=True))
    # Each column has a border and a blank to both sides.
    widths = _widths(together, console.width - 3 * len(together) - 1)
    for index, ((column, *cells), width) in enumerate(zip(together, widths, strict=True)):
        number = index > 0 and all(cell[:1] in NUMBER or cell == "infinite" for cell in cells)
        justify: Literal["left", "right"] = "right" if number else "left"
        table.add_column(column, justify=justify, overflow="fold", width=width)
    for row in texts:
        table.add_row(*map(rich.markup.escape, row))
    console.print(table)


def _widths(columns: Sequence[Sequence[str]], room: int) -> list[int | None]:
    """Return widths of columns in which no word is broken; ``None`` where there is no room."""
    whole = [max(map(len, texts), default=1) for texts in columns]
    least = [max((len(word) for t in texts for word in t.split()), default=1) for texts in columns]
    # What a row is of stays on one line where that leaves room for words of the others.
    if sum(least) - least[0] + whole[0] <= room:
        least[0] = whole[0]
    if sum(whole) <= room or sum(least) > room:
        return [None] * len(columns)
    share = (room - sum(least)) / (sum(whole) - sum(least))
    return [low + int(share * (high - low)) for low, high in zip(least, whole, strict=True)]


def print_rows(title: str, rows: Sequence[Mapping[str, object]]) -> None:
    """Print rows that all have the same columns."""
    if rows:
        print_table(title, list(rows[0]), [list(row.values()) for row in rows])


def print_evaluation(title: str, result: "Evaluation") -> None:
    """Print the verdict of an evaluation, and a row a method."""
    say(result.verdict())
    frame = result.summary()
    rows = frame.reset_index(names="method").to_dict("records")
    print_rows(title, [{str(k): v for k, v in row.items()} for row in rows])
    for note in result.notes:
        say(note)


def print_all_scores(result: "Evaluation", thesis: str | None = None) -> None:
    """Print all scores of an evaluation, and those that the thesis prints if asked."""
    from swarmssm import analysis
    from swarmssm.analysis.scoring.table import format_unit
    from swarmssm.analysis.scoring.thesis import FOOTNOTE

    print_rows("one step, free runs and edges", analysis.scores_table(result, thesis))
    if thesis is not None:
        say(FOOTNOTE)
    print_rows("squared error at each step ahead, scaled states", analysis.horizon_table(result))
    print_rows(
        "log score of positions at each step ahead, nats per coordinate (higher is better)",
        analysis.horizon_table(result, "log_score"),
    )
    unit = format_unit(result.settings["unit"])
    print_rows(
        f"CRPS of positions at each step ahead{f', {unit}' if unit else ''} (lower is better)",
        analysis.horizon_table(result, "crps"),
    )
    print_rows(
        "share of positions inside the 90 % interval of the forecast",
        analysis.horizon_table(result, "coverage"),
    )
    print_rows("edges of the next graph", analysis.edge_table(result))


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
