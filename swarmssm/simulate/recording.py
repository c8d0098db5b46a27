"""Run dynamics, and write down what happened together with the truth behind it."""

import json
import math
from collections.abc import Iterable
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt
import torch
import xarray as xr
from torch import Tensor

from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import GraphRule
from swarmssm.tracks import make_tracks

__all__ = [
    "Dynamics",
    "check_choice",
    "check_number",
    "check_size",
    "check_space",
    "directions_given",
    "generator_of",
    "initial_state",
    "record",
]

#: Beyond this the tracks would be refused, and nothing sensible goes so far.
FARTHEST = 1e12


class Dynamics(Protocol):
    """How a group moves in one step. All tensors ``(..., individual, space)``, float64."""

    name: ClassVar[str]
    #: What the numbers of :meth:`forces` mean, for the reader of the tracks.
    force_meaning: ClassVar[str]
    #: Which parameter to try when the positions leave the finite numbers.
    remedy: ClassVar[str]

    @property
    def dt(self) -> float:
        """Seconds from one state to the next."""

    @property
    def space(self) -> int:
        """Number of spatial dimensions, 2 or 3."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the forces."""

    @property
    def graph_rule(self) -> GraphRule | None:
        """The rule of the interaction graph, if it is one of those that have a name."""

    def start(
        self, trials: int, individuals: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Draw positions and velocities to begin with, ``(trial, individual, space)``."""

    def begin(self, velocities: Tensor) -> Tensor:
        """Return the velocities that the dynamics can begin with, nearest to the given ones."""

    def forces(self, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Return forces ``(..., term, individual, space)`` and the graph that they act along."""

    def move(
        self,
        positions: Tensor,
        velocities: Tensor,
        force: Tensor,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return the next positions and velocities; without a generator those free of noise."""

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters, for JSON."""


def record(
    dynamics: Dynamics,
    *,
    individuals: int,
    steps: int,
    trials: int,
    observation_noise: float,
    seed: int | torch.Generator,
    burn_in: int,
    initial_position: npt.ArrayLike | None,
    initial_velocity: npt.ArrayLike | None,
) -> xr.Dataset:
    """Run the dynamics, all trials in one batch, and return the tracks with the truth.

    Parameters are those that the simulators share, see :func:`swarmssm.simulate.simulate_boids`.

    Raises
    ------
    InputError
        If one of them is out of range.
    WorkError
        If a position is no longer a finite number.
    """
    for name, count, least in (
        ("individuals", individuals, 1),
        ("steps", steps, 2),
        ("trials", trials, 1),
        ("burn_in", burn_in, 0),
    ):
        check_size(name, count, least)
    check_number("observation_noise", observation_noise)
    generator = generator_of(seed)
    positions, velocities = dynamics.start(trials, individuals, generator)
    if initial_position is not None:
        positions = initial_state("initial_position", initial_position, positions)
    if initial_velocity is not None:
        velocities = dynamics.begin(initial_state("initial_velocity", initial_velocity, velocities))

    shape = (trials, steps, individuals, dynamics.space)
    kept = {
        name: torch.empty(shape, dtype=torch.float64)
        for name in ("position", "velocity", "next_position", "next_velocity")
    }
    forces = torch.empty((trials, steps, len(dynamics.terms), *shape[2:]), dtype=torch.float64)
    edges = torch.empty((*shape[:-1], individuals), dtype=torch.uint8)
    for step in range(-burn_in, steps):
        force, graph = dynamics.forces(positions, velocities)
        if step >= 0:
            expected = dynamics.move(positions, velocities, force)
            now = (positions, velocities, *expected)
            for target, value in zip(kept.values(), now, strict=True):
                target[:, step] = value
            forces[:, step], edges[:, step] = force, graph
        if step == steps - 1:
            break
        positions, velocities = dynamics.move(positions, velocities, force, generator)
        if not (positions.abs() < FARTHEST).all():
            raise WorkError(
                f"simulate {dynamics.name}: in step {step + burn_in + 1} of {steps + burn_in} a "
                f"position left the finite numbers. {dynamics.remedy}"
            )
    noise = observation_noise * torch.randn(shape, dtype=torch.float64, generator=generator)
    return _tracks(dynamics, kept, forces, edges, noise, seed, observation_noise, burn_in)


def check_size(name: str, value: int, least: int) -> int:
    """Return a whole number that is not below ``least``, or raise an InputError."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{name}: it must be a whole number from {least} upwards, not {value!r}.")
    return int(value)


def check_number(
    name: str,
    value: float,
    *,
    above_zero: bool = False,
    finite: bool = True,
    most: float = math.inf,
) -> None:
    """Raise an InputError for a number below 0, or where told equal to 0, infinite or too large."""
    number = isinstance(value, float | int | np.number) and not isinstance(value, bool)
    good = number and 0.0 <= value <= most
    if not good or (above_zero and value == 0.0) or (finite and math.isinf(value)):
        least = "above 0" if above_zero else "from 0 upwards"
        bound = "" if math.isinf(most) else f", at most {most:.6g}"
        raise InputError(f"{name}: it must be a number {least}{bound}, not {value!r}.")


def check_choice(name: str, value: str, choices: Iterable[str]) -> None:
    """Raise an InputError for a word that is not among the choices."""
    choices = list(choices)
    if value not in choices:
        raise InputError(f"{name}: {value!r} is unknown; choose one of {', '.join(choices)}.")


def check_space(space: int) -> None:
    """Raise an InputError unless there are 2 or 3 dimensions."""
    if space not in (2, 3):
        raise InputError(f"space: there can be 2 or 3 dimensions, not {space!r}.")


def directions_given(velocities: Tensor) -> Tensor:
    """Return the directions of initial velocities; refuse one of 0."""
    speed: Tensor = torch.linalg.vector_norm(velocities, dim=-1, keepdim=True)
    if not (speed > 0).all():
        raise InputError("initial_velocity: each needs a direction, and one is 0.")
    return velocities / speed


def generator_of(seed: int | torch.Generator) -> torch.Generator:
    """Return the generator, or a new one with the given seed."""
    if isinstance(seed, torch.Generator):
        return seed
    return torch.Generator().manual_seed(check_size("seed", seed, 0))


def initial_state(name: str, values: npt.ArrayLike, like: Tensor) -> Tensor:
    """Return an initial state of the shape ``(trial, individual, space)``."""
    try:
        array = torch.as_tensor(np.array(values, dtype=np.float64))
        array = array.expand(like.shape).clone()
    except (ValueError, TypeError, RuntimeError) as error:
        raise InputError(
            f"{name}: its shape must be (individual, space) or (trial, individual, space), here "
            f"{tuple(like.shape[1:])} or {tuple(like.shape)}, and it is {np.shape(values)}."
        ) from error
    if not array.isfinite().all():
        raise InputError(f"{name}: every entry must be a finite number.")
    return array


def _tracks(
    dynamics: Dynamics,
    kept: dict[str, Tensor],
    forces: Tensor,
    edges: Tensor,
    noise: Tensor,
    seed: int | torch.Generator,
    observation_noise: float,
    burn_in: int,
) -> xr.Dataset:
    """Label everything."""
    dims = ("trial", "time", "space", "individual")
    states = {name: value.mT.numpy() for name, value in kept.items()}
    variables = {name: (dims, states[name]) for name in ("next_position", "next_velocity")}
    exact = observation_noise == 0
    if not exact:
        variables["true_position"] = (dims, states["position"])
        variables["true_velocity"] = (dims, states["velocity"])
    settings = {
        **dynamics.to_dict(),
        "dynamics": dynamics.name,
        "observation_noise": observation_noise,
        "burn_in": burn_in,
        "seed": None if isinstance(seed, torch.Generator) else int(seed),
    }
    tracks = make_tracks(
        (kept["position"] + noise).numpy(),
        fps=1.0 / dynamics.dt,
        velocity=kept["velocity"].numpy() if exact else None,
        variables=variables,
        source_software="swarmssm",
        attrs={"simulation": json.dumps(settings)},
    )
    force_dims = ("trial", "time", "term", "space", "individual")
    edge_dims = ("trial", "time", "individual", "neighbor")
    rule = dynamics.graph_rule
    edge_attrs = {} if rule is None else {"rule": json.dumps(rule.to_dict())}
    tracks = tracks.assign_coords(
        term=list(dynamics.terms), neighbor=tracks["individual"].to_numpy()
    ).assign(
        force=(force_dims, forces.mT.numpy(), {"meaning": dynamics.force_meaning}),
        adjacency=(edge_dims, edges.numpy(), edge_attrs),
    )
    tracks["next_position"].attrs["meaning"] = "noise-free position one step later"
    tracks["next_velocity"].attrs["meaning"] = "noise-free velocity one step later"
    return tracks
