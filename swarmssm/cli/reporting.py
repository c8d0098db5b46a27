"""``report``: one page on a run, or on analyses of several sets side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swarmssm.cli.comparing import Against, load_other_runs
from swarmssm.cli.console import say
from swarmssm.cli.options import Overwrite, Seed, TrustCode
from swarmssm.cli.progress import stages
from swarmssm.errors import InputError
from swarmssm.files import check_output

if TYPE_CHECKING:
    from swarmssm.analysis.report import Page

__all__ = ["report"]


def report(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN | --compare [NAME=]FILE...",
            help="The folder of a run; with --compare files of analyze, each with the name of its "
            "set. Default: the file's own.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="HTML page to write.")],
    compare: Annotated[
        bool, typer.Option("--compare", help="Compare analyses of several sets.")
    ] = False,
    data: Annotated[
        Path | None, typer.Option(help="The tracks of the fit. Default: the file it was fitted on.")
    ] = None,
    against: Against = None,
    checks: Annotated[
        int,
        typer.Option(
            help="Swarms to simulate from the model and compare with the recording; 0 for none."
        ),
    ] = 100,
    forces: Annotated[bool, typer.Option(help="Infer forces and kernels.")] = True,
    player: Annotated[
        bool, typer.Option(help="Add a player of the recording and a free run.")
    ] = True,
    title: Annotated[str | None, typer.Option(help="Heading of the page.")] = None,
    text: Annotated[
        Path | None, typer.Option(help="With --compare: a Markdown file to put first.")
    ] = None,
    seed: Seed = 0,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Write one self-contained HTML page on a run, or with --compare on several analyses."""
    check_output(out, overwrite=overwrite)
    if compare:
        if data is not None or against:
            raise InputError("--data, --against: they belong to a run, and not to --compare.")
        page = _comparison(sources, out, title, text)
    elif len(sources) > 1:
        raise InputError(
            f"{sources[1]}: one run is reported at a time. Add other runs with --against, or "
            "compare files of analyze with --compare."
        )
    elif text is not None:
        raise InputError("--text: it belongs to --compare.")
    else:
        page = _of_run(
            Path(sources[0]),
            data,
            against,
            title=title,
            checks=checks,
            forces=forces,
            player=player,
            seed=seed,
            trust_code=trust_code,
        )
    page.write(out, overwrite=overwrite)
    say(f"{out}: written. Open it in a browser.")


def _of_run(
    run: Path,
    data: Path | None,
    against: Sequence[Path] | None,
    *,
    title: str | None,
    checks: int,
    forces: bool,
    player: bool,
    seed: int,
    trust_code: bool,
) -> "Page":
    """Return the page on a run and the tracks that it was fitted on."""
    from swarmssm import analysis, inference, io
    from swarmssm.inference.fitting import tracks_digest

    fitted = inference.Fit.load(run, trust_code=trust_code)
    known = fitted.provenance.get("data", {})
    path = data or Path(known.get("file") or "")
    if data is None and not (known.get("file") and path.exists()):
        raise InputError(
            f"{run}: the tracks it was fitted on are no longer at {path}. Name them with --data."
        )
    tracks = io.read(path)
    if tracks_digest(tracks) != known.get("sha256"):
        raise InputError(
            f"{path}: these are not the tracks that {run} was fitted on. Name them with --data."
        )
    with stages() as show:
        return analysis.run_page(
            fitted,
            tracks,
            title=title or f"{fitted.settings.model} on {path.name}",
            against=load_other_runs(against, fitted, trust_code) or None,
            checks=checks,
            forces=forces,
            player=player,
            seed=seed,
            progress=show,
        )


def _comparison(sources: Sequence[str], out: Path, title: str | None, text: Path | None) -> "Page":
    """Return the page on several analyses."""
    from swarmssm.analysis import Analysis, comparison_page

    named = _named(sources)
    prose = None if text is None else _read(text)
    for path in (*named.values(), *([] if text is None else [text])):
        if path.resolve() == out.resolve():
            raise InputError(f"{out}: this file is read and cannot be written. Choose another.")
    analyses = {name: Analysis.read(path) for name, path in named.items()}
    return comparison_page(analyses, title, text=prose)


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
                f"{place}: a set named {name} is given twice. Write another name before it, as "
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
        raise InputError(f"{path}: this is not text in UTF-8. Save it as such.") from error
