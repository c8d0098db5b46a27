"""The command as a whole: subcommands, exit statuses, and errors as sentences."""

import os
import re
import sys
import traceback
import warnings
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from swarmssm import __version__
from swarmssm.cli.analyzing import analyze
from swarmssm.cli.animating import animate
from swarmssm.cli.benchmarking import benchmark
from swarmssm.cli.calibrating import recovery, sbc
from swarmssm.cli.checking import check
from swarmssm.cli.comparing import compare
from swarmssm.cli.demo import demo
from swarmssm.cli.fitting import fit
from swarmssm.cli.models import models
from swarmssm.cli.reporting import report
from swarmssm.cli.running import evaluate, forecast, rollout
from swarmssm.cli.simulating import simulate
from swarmssm.cli.tracks import import_tracks, info
from swarmssm.errors import SwarmssmError, WorkError

__all__ = ["app", "main"]


class _Commands(TyperGroup):
    """The subcommands; one that is stopped by hand has failed, and says so."""

    def invoke(self, ctx: Any) -> Any:
        """Run a subcommand."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise WorkError("stopped by hand before the work was done.") from None


app = typer.Typer(
    name="swarmssm",
    cls=_Commands,
    help="Learn how the members of a group move each other, from their tracks alone.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(demo)
app.add_typer(simulate, name="simulate")
app.command("import")(import_tracks)
app.command("info")(info)
app.command("models")(models)
app.command("fit")(fit)
app.command("evaluate")(evaluate)
app.command("forecast")(forecast)
app.command("rollout")(rollout)
app.command("check")(check)
app.command("compare")(compare)
app.command("benchmark")(benchmark)
app.command("analyze")(analyze)
app.command("animate")(animate)
app.command("sbc")(sbc)
app.command("recovery")(recovery)
app.command("report")(report)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"swarmssm {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Say the version."),
    ] = False,
    debug: Annotated[
        bool,
        typer.Option("--debug", help="Before an error, show the traceback of what led to it."),
    ] = False,
) -> None:
    """Learn how the members of a group move each other, from their tracks alone."""
    _shown["traceback"] = debug


#: What the options of the command as a whole ask for, once it runs.
_shown = {"traceback": False}


def main() -> None:
    """Run the command; exit with 0 done, 1 the work failed, 2 the call or the input is wrong."""
    # The networks are small: more threads gain nothing where the processor is free, and wait for
    # each other twenty times as long as they work where it is not. Set before torch is imported.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Libraries warn about their own future; a user of the command can do nothing about it.
    warnings.filterwarnings("ignore", category=FutureWarning)
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    try:
        app()
    except SwarmssmError as error:
        if _shown["traceback"]:
            traceback.print_exception(error)
        _fail(str(error), error.exit_status)
    except MemoryError:
        _fail("there is not enough memory for this; take fewer individuals, frames or draws.", 1)
    except BrokenPipeError:
        # The reader of our output went away (for instance `| head`): nothing is left to be said.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


#: Arguments that errors of the library name as in Python, and the command as options.
ARGUMENT = re.compile(
    r"\b(allow_pickle|centroid|data|edges|empty|fps|graph|overwrite|resume|trust_code|video)="
    r"(?:True|\"([^\"]*)\"|(\.\.\.|[\d.]+))"
)


def as_options(sentence: str) -> str:
    """Write the arguments that a sentence names as options: ``fps=25`` as ``--fps 25``."""

    def option(found: re.Match[str]) -> str:
        value = (found[2] or found[3] or "").removeprefix("...")
        return f"--{found[1].replace('_', '-')} {value}".rstrip()

    return ARGUMENT.sub(option, sentence)


def _fail(sentence: str, status: int) -> None:
    sys.stdout.flush()
    sentence = as_options(sentence)
    typer.echo(f"swarmssm: {sentence}", err=True)
    sys.exit(status)
