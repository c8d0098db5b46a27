"""``compare``: which of several runs is best, by how much, and how surely."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import rich.console
import typer

from swarmssm.cli.console import print_json, print_rows, say, write_json
from swarmssm.cli.options import Format, Overwrite, Seed, TableFormat, TrustCode
from swarmssm.errors import InputError
from swarmssm.files import check_output

if TYPE_CHECKING:
    from swarmssm.inference import Fit

__all__ = ["Against", "Horizons", "compare", "load_other_runs", "parse_horizons"]

Against = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="RUN", help="Another run whose held-out forecasts are scored too; repeatable."
    ),
]
Horizons = Annotated[
    str | None, typer.Option(help="Steps ahead, with commas. Default: 1,2,5,10,20.")
]


def compare(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN RUN ... FILE", help="Run folders, and last the tracks to judge them on."
        ),
    ],
    method: Annotated[
        str,
        typer.Option(
            help="held-out: forecasts of frames kept back; lfo: leave-future-out, those frames one "
            "after another; loo: leave-one-out of the frames they were trained on."
        ),
    ] = "held-out",
    part: Annotated[
        str | None,
        typer.Option(
            help="train, validation, test or all. Default: what each run holds out of its own "
            "file, and all of another."
        ),
    ] = None,
    horizons: Horizons = None,
    origins: Annotated[
        int, typer.Option(help="Frames of each trial to forecast from. Of held-out.", min=1)
    ] = 40,
    draws: Annotated[
        int | None,
        typer.Option(
            help="Sampled futures of each origin (default 100), or of the parameters (400)."
        ),
    ] = None,
    window: Annotated[
        int | None,
        typer.Option(help="Frames in a window of loo and lfo. Default: trials, or about thirty."),
    ] = None,
    allow_seen: Annotated[
        bool,
        typer.Option("--allow-seen", help="Judge runs also on frames that they were trained on."),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="JSON file to write.")] = None,
    seed: Seed = 0,
    format: Format = TableFormat.text,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Rank runs by how probable they make what they have not seen, on the same frames."""
    from swarmssm import io
    from swarmssm.analysis.scoring import compare as ranked

    if out is not None:
        check_output(out, overwrite=overwrite)
    *runs, file = paths
    if horizons is not None and method != "held-out":
        raise InputError(f"--horizons: method {method} forecasts one step at a time; leave it out.")
    options = parse_horizons(horizons)
    fits = _load(runs, file, trust_code=trust_code)
    tracks = io.read(file)
    with _status() as show:
        result = ranked(
            fits,
            tracks,
            method=method,
            part=part,
            origins=origins,
            draws=draws,
            window=window,
            allow_seen=allow_seen,
            seed=seed,
            progress=show,
            **options,
        )
    found = result.to_dict()
    if out is not None:
        write_json(found, out, overwrite=overwrite)
    if format is TableFormat.json:
        print_json(found)
        return
    say(result.verdict())
    print_rows(f"{method} on {file}, part {result.data.attrs['part']}", result.rows())
    for note in result.notes:
        say(note)
    if out is not None:
        say(f"{out}: written.")


def _load(runs: Sequence[Path], file: Path, *, trust_code: bool) -> dict[str, "Fit"]:
    """Read the runs, named by their folders where that tells them apart."""
    from swarmssm.inference import Fit

    if len(runs) < 2:
        raise InputError(
            "compare: name at least two run folders, and last the tracks to judge them on, for "
            "instance: swarmssm compare RUN RUN FILE.nc"
        )
    if file.is_dir() and (file / "config.json").exists():
        raise InputError(
            f"{file}: this is a run folder. The last argument must be the tracks to judge on."
        )
    for path in runs:
        if path.is_file():
            raise InputError(
                f"{path}: this is a file. Run folders come first, and last the one file of tracks."
            )
    short = [path.resolve().name for path in runs]
    names = short if len(set(short)) == len(short) else [str(path) for path in runs]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{twice}: this run is given twice. Name different runs.")
    return {
        name: Fit.load(path, trust_code=trust_code) for name, path in zip(names, runs, strict=True)
    }


def parse_horizons(text: str | None) -> dict[str, Any]:
    """Read whole numbers with commas between them, as an option of the function; empty of none.

    Raises
    ------
    InputError
        If they are none, or below 1.
    """
    if text is None:
        return {}
    try:
        ahead = tuple(sorted({int(part) for part in text.split(",")}))
    except ValueError:
        raise InputError(f"--horizons: {text!r} is not of the form 1,5,10.") from None
    if ahead[0] < 1:
        raise InputError(f"--horizons: every horizon must be at least 1, not {ahead[0]}.")
    return {"horizons": ahead}


def load_other_runs(
    paths: Sequence[Path] | None, fitted: "Fit", trust_code: bool
) -> dict[str, "Fit"]:
    """Read runs, each named by its folder, or by its path if the fit's model has that name.

    Raises
    ------
    InputError
        If one cannot be read, or two have one name.
    """
    from swarmssm.inference import Fit

    others: dict[str, Fit] = {}
    for path in paths or []:
        name = path.resolve().name
        name = str(path) if name == fitted.settings.model else name
        if name in others:
            raise InputError(f"--against: two runs are called {name}. Rename the folder of one.")
        others[name] = Fit.load(path, trust_code=trust_code)
    return others


@contextmanager
def _status() -> Iterator[Callable[[str], None]]:
    """Show what is being done: a moving line on a terminal, plain lines elsewhere."""
    if sys.stderr.isatty():
        with rich.console.Console(stderr=True).status("comparing") as status:
            yield status.update
        return
    yield lambda words: typer.echo(words, err=True)
