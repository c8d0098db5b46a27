"""``swarmssm simulate``: swarms of which the truth is known."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from swarmssm.cli.console import say
from swarmssm.cli.options import Overwrite, Seed, named_values
from swarmssm.errors import InputError
from swarmssm.files import check_output

__all__ = ["simulate"]

simulate = typer.Typer(
    help="Simulate a swarm of which the truth is known, into a NetCDF file.", no_args_is_help=True
)

Individuals = Annotated[int, typer.Option(help="Individuals in each trial.")]
Steps = Annotated[int, typer.Option(help="Frames of each trial.")]
Trials = Annotated[int, typer.Option(help="Independent trials.")]
Out = Annotated[Path, typer.Option(help="NetCDF file to write.")]
Dt = Annotated[float | None, typer.Option(help="Seconds between two frames.")]
Space = Annotated[int, typer.Option(help="Dimensions of space, 2 or 3.")]
ProcessNoise = Annotated[float | None, typer.Option(help="Noise of the motion.")]
ObservationNoise = Annotated[
    float, typer.Option(help="Standard deviation of the tracking noise, in length units.")
]
Further = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Any other parameter of the simulator, for instance --set separation_gain=0.3.",
    ),
]


@simulate.command("boids")
def _boids(
    out: Out,
    individuals: Individuals = 10,
    steps: Steps = 1000,
    trials: Trials = 1,
    form: Annotated[
        str, typer.Option(help="acceleration, or velocity as printed in the thesis's (3.19).")
    ] = "acceleration",
    radius: Annotated[float | None, typer.Option(help="Radius of perception.")] = None,
    dt: Dt = None,
    space: Space = 2,
    process_noise: ProcessNoise = None,
    observation_noise: ObservationNoise = 0.0,
    leader: Annotated[
        int | None,
        typer.Option(
            help="Index (from 0) of a leader: others follow it, and it responds to nobody."
        ),
    ] = None,
    leader_strength: Annotated[
        float, typer.Option(help="How many times the leader counts for the others.")
    ] = 3.0,
    isolated: Annotated[
        int | None,
        typer.Option(help="Index (from 0) of an individual that interacts with nobody."),
    ] = None,
    seed: Seed = 0,
    further: Further = None,
    overwrite: Overwrite = False,
) -> None:
    """Boids with cohesion, separation and alignment, (3.16)-(3.20) of the thesis."""
    from swarmssm.simulate import simulate_boids
    from swarmssm.simulate.attention import planted_attention

    given: dict[str, Any] = {
        "form": form,
        "radius": radius,
        "dt": dt,
        "process_noise": process_noise,
    }
    if leader is not None or isolated is not None:
        if "attention" in named_values(further or [], "--set"):
            raise InputError(
                "--set: attention gives all weights; leave out --leader and --isolated."
            )
        given["attention"] = planted_attention(
            individuals, leader=leader, strength=leader_strength, isolated=isolated
        )
    _write(
        simulate_boids,
        individuals,
        steps,
        trials,
        space,
        observation_noise,
        seed,
        given,
        further,
        out,
        overwrite,
    )


@simulate.command("vicsek")
def _vicsek(
    out: Out,
    individuals: Individuals = 100,
    steps: Steps = 1000,
    trials: Trials = 1,
    radius: Annotated[float | None, typer.Option(help="Radius of interaction.")] = None,
    dt: Dt = None,
    space: Space = 2,
    process_noise: ProcessNoise = None,
    observation_noise: ObservationNoise = 0.0,
    seed: Seed = 0,
    further: Further = None,
    overwrite: Overwrite = False,
) -> None:
    """Self-propelled particles that take over the mean heading nearby (Vicsek et al. 1995)."""
    from swarmssm.simulate import simulate_vicsek

    given = {"radius": radius, "dt": dt, "process_noise": process_noise}
    _write(
        simulate_vicsek,
        individuals,
        steps,
        trials,
        space,
        observation_noise,
        seed,
        given,
        further,
        out,
        overwrite,
    )


@simulate.command("couzin")
def _couzin(
    out: Out,
    individuals: Individuals = 100,
    steps: Steps = 1000,
    trials: Trials = 1,
    dt: Dt = None,
    space: Space = 2,
    process_noise: ProcessNoise = None,
    observation_noise: ObservationNoise = 0.0,
    seed: Seed = 0,
    further: Further = None,
    overwrite: Overwrite = False,
) -> None:
    """Zones of repulsion, orientation and attraction (Couzin et al. 2002)."""
    from swarmssm.simulate import simulate_couzin

    given = {"dt": dt, "process_noise": process_noise}
    _write(
        simulate_couzin,
        individuals,
        steps,
        trials,
        space,
        observation_noise,
        seed,
        given,
        further,
        out,
        overwrite,
    )


def _write(
    simulator: Callable[..., Any],
    individuals: int,
    steps: int,
    trials: int,
    space: int,
    observation_noise: float,
    seed: int,
    given: dict[str, Any],
    further: list[str] | None,
    out: Path,
    overwrite: bool,
) -> None:
    """Simulate with the parameters given, and write the tracks."""
    from swarmssm import io

    check_output(out, overwrite=overwrite)
    parameters = {name: value for name, value in given.items() if value is not None}
    known = inspect.signature(simulator).parameters
    for name, value in named_values(further or [], "--set").items():
        if name not in known:
            raise InputError(
                f"--set: there is no parameter {name}; choose among {', '.join(known)}."
            )
        if not isinstance(value, int | float | str | list) or isinstance(value, bool):
            raise InputError(f"--set: {name} must be a number, a word or a list, not {value!r}.")
        parameters[name] = value
    common = {
        "individuals": individuals,
        "steps": steps,
        "trials": trials,
        "space": space,
        "observation_noise": observation_noise,
        "seed": seed,
    }
    try:
        tracks = simulator(**{**common, **parameters})
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"--set: a parameter has the wrong type ({error}).") from error
    io.write(tracks, out, overwrite=overwrite)
    say(f"{out}: {trials} trials of {individuals} individuals and {steps} frames.")
