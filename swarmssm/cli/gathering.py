"""``gather``: one page on analyses of several sets."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from swarmssm.cli.console import say
from swarmssm.cli.options import Overwrite
from swarmssm.errors import InputError
from swarmssm.files import check_output

__all__ = ["gather"]


def gather(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]FILE...",
            help="Files of analyze, each with the name of its set. Default: the file's own.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="HTML page to write.")],
    title: Annotated[
        str | None, typer.Option(help="Heading of the page. Default: from the names.")
    ] = None,
    text: Annotated[
        Path | None, typer.Option(help="Markdown file of your own to stand above the figures.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Put analyses of several sets on one page: rules, force maps, held-out scores side by side."""
    from swarmssm.analysis.interpretation.result import Analysis
    from swarmssm.analysis.report.gathered_page import report_gathered

    check_output(out, overwrite=overwrite)
    named = _named(files)
    prose = None if text is None else _read(text)
    for path in (*named.values(), *([] if text is None else [text])):
        if path.resolve() == out.resolve():
            raise InputError(f"{out}: this is read, and would be lost. Name another with --out.")
    analyses = {name: Analysis.read(path) for name, path in named.items()}
    report_gathered(analyses, out, title=title, text=prose, overwrite=overwrite)
    count = len(analyses)
    say(f"{out}: {count} {'analysis' if count == 1 else 'analyses'}; open it in a browser.")


def _named(files: Sequence[str]) -> dict[str, Path]:
    """Read names and files; one without a name has that of its file."""
    named: dict[str, Path] = {}
    for text in files:
        name, equals, place = text.partition("=")
        name = name.strip()
        if not equals or Path(text).exists():
            name, place = Path(text).stem, text
        if not name or not place:
            raise InputError(f"{text!r} is not of the form NAME=FILE.")
        if name in named:
            raise InputError(
                f"{place}: there is a set named {name} already. Write another name before it, as "
                "NAME=FILE."
            )
        named[name] = Path(place)
    return named


def _read(path: Path) -> str:
    """Read a text."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: this is no text in UTF-8. Save it as such.") from error
