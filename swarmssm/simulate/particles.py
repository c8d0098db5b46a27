"""Particles in a box, joined by springs or by electric charge: the physics of relational inference.

The two systems on which neural relational inference was shown first. What joins whom is drawn once
for each trial, or anew every so many frames, and goes with the tracks as ``edge_type``.
"""

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
import xarray as xr
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.simulate.recording import (
    check_number,
    check_size,
    check_space,
    generator_of,
    initial_state,
)
from swarmssm.tracks import make_tracks

__all__ = ["Charged", "Springs", "simulate_charged", "simulate_springs"]

#: Trials that move in one go: their pairs fit the cache of the processor.
TOGETHER = 500


@dataclasses.dataclass(frozen=True)
class Particles:
    """What springs and charges share; :func:`simulate_springs` documents the parameters.

    ``edge_type (..., individual, neighbor)`` says which pairs are joined how. It belongs to the
    trial, not to the dynamics, so that :meth:`to_dict` leaves it out.
    """

    dt: float
    substeps: int
    space: int
    strength: float
    half_width: float
    start_spread: float
    start_speed: float
    max_force: float
    edge_type: Tensor | None = dataclasses.field(default=None, compare=False, repr=False)

    name: ClassVar[str]
    terms: ClassVar[tuple[str, ...]]
    remedy: ClassVar[str] = "Try more substeps or a smaller strength."
    force_meaning: ClassVar[str] = "acceleration at the beginning of the step"

    def __post_init__(self) -> None:
        check_space(self.space)
        check_size("substeps", self.substeps, 1)
        for name in ("dt", "half_width", "max_force"):
            check_number(name, getattr(self, name), above_zero=True)
        for name in ("strength", "start_spread", "start_speed"):
            check_number(name, getattr(self, name))

    @property
    def graph_rule(self) -> None:
        """There is none: who is joined does not follow from where they are."""
        return None

    def joined(self, edge_type: Tensor) -> Tensor:
        """Return the graph ``(..., individual, neighbor)`` of the pairs that move each other."""
        raise TypeError(f"{type(self).__name__} must define joined(edge_type)")

    def pull(self, square: Tensor, edge_type: Tensor) -> Tensor:
        """Return the factor of ``x_i - x_j`` in the acceleration of i, given the square of it."""
        raise TypeError(f"{type(self).__name__} must define pull(square, edge_type)")

    def start(
        self, trials: int, individuals: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Draw positions around the origin, and velocities of one speed all around."""
        shape = (trials, individuals, self.space)
        draws = torch.randn((2, *shape), dtype=torch.float64, generator=generator)
        bounced, _ = self.bounce(self.start_spread * draws[0], draws[1])
        length = torch.linalg.vector_norm(draws[1], dim=-1, keepdim=True)
        return bounced, self.start_speed * draws[1] / length

    def begin(self, velocities: Tensor) -> Tensor:
        """Return the velocities as they are: every one is possible."""
        return velocities

    def forces(self, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Return the one term ``(..., 1, individual, space)`` and the graph."""
        edge_type = self.known_edges().expand(*positions.shape[:-1], positions.shape[-2])
        flat, kinds = _trial_last(positions, edge_type)
        force = self.acceleration(flat, kinds)
        return (
            force.permute(2, 1, 0).reshape(positions.shape).unsqueeze(-3),
            self.joined(edge_type),
        )

    def move(
        self,
        positions: Tensor,
        velocities: Tensor,
        force: Tensor,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return the state one frame later; there is no noise, and a generator changes nothing."""
        edge_type = self.known_edges().expand(*positions.shape[:-1], positions.shape[-2])
        place, kinds = _trial_last(positions, edge_type)
        speed, _ = _trial_last(velocities, edge_type)
        pushed, _ = _trial_last(force.sum(-3), edge_type)
        place, speed = self.fly(place, speed, pushed, kinds)[:2]
        shape = positions.shape
        return place.permute(2, 1, 0).reshape(shape), speed.permute(2, 1, 0).reshape(shape)

    def fly(
        self, place: Tensor, speed: Tensor, force: Tensor, kinds: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Leap through one frame; all ``(space, individual, trial)``, and so is the last force."""
        step = self.dt / self.substeps
        for _ in range(self.substeps):
            speed = speed + 0.5 * step * force
            place, speed = self.bounce(place + step * speed, speed)
            force = self.acceleration(place, kinds)
            speed = speed + 0.5 * step * force
        return place, speed, force

    def acceleration(self, place: Tensor, kinds: Tensor) -> Tensor:
        """Return that of ``(space, individual, trial)``; kinds ``(individual, neighbor, trial)``.

        With the trials last, what is summed over are short axes and what runs along is a long one.
        """
        apart = place.unsqueeze(2) - place.unsqueeze(1)
        force = (self.pull(apart.square().sum(0), kinds) * apart).sum(2)
        return force.clamp(-self.max_force, self.max_force)

    def bounce(self, place: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Reflect who went through a wall."""
        beyond = place.abs() > self.half_width
        if not bool(beyond.any()):
            return place, speed
        side = place.sign()
        mirrored = (2.0 * self.half_width * side - place).clamp(-self.half_width, self.half_width)
        return torch.where(beyond, mirrored, place), torch.where(beyond, -side * speed.abs(), speed)

    def known_edges(self) -> Tensor:
        """Return the edge types, or say that they are needed."""
        if self.edge_type is None:
            raise InputError(
                f"simulate {self.name}: the edge types are not known. Give the dynamics their "
                "edge_type."
            )
        return self.edge_type

    def with_edges(self, edge_type: Tensor) -> Self:
        """Return the same dynamics for pairs joined like this."""
        return dataclasses.replace(self, edge_type=edge_type)

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters but the edges, for JSON."""
        fields = (field.name for field in dataclasses.fields(self))
        return {name: getattr(self, name) for name in fields if name != "edge_type"}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the dynamics that :meth:`to_dict` described."""
        return cls(**values)


class Springs(Particles):
    """The dynamics of :func:`simulate_springs`; edge type 1 is a spring."""

    name: ClassVar[str] = "springs"
    terms: ClassVar[tuple[str, ...]] = ("spring",)

    def joined(self, edge_type: Tensor) -> Tensor:
        """Return the pairs with a spring."""
        return edge_type.to(torch.uint8)

    def pull(self, square: Tensor, edge_type: Tensor) -> Tensor:
        """Hooke's law, with no length of its own."""
        return -self.strength * edge_type


class Charged(Particles):
    """The dynamics of :func:`simulate_charged`; edge type 0 attracts, 1 repels."""

    name: ClassVar[str] = "charged"
    terms: ClassVar[tuple[str, ...]] = ("charge",)

    def joined(self, edge_type: Tensor) -> Tensor:
        """Return all pairs of two."""
        return 1 - torch.eye(edge_type.shape[-1], dtype=torch.uint8).expand(edge_type.shape)

    def pull(self, square: Tensor, edge_type: Tensor) -> Tensor:
        """Coulomb's law; with oneself, and exactly on top of each other, nothing."""
        cube = square * square.sqrt()
        apart = square > 0.0
        return torch.where(apart, self.strength * (2.0 * edge_type - 1.0) / cube, 0.0)


def simulate_springs(
    individuals: int = 5,
    steps: int = 49,
    trials: int = 1,
    *,
    dt: float = 0.1,
    substeps: int = 100,
    space: int = 2,
    strength: float = 0.1,
    half_width: float = 5.0,
    start_spread: float = 0.5,
    start_speed: float = 0.5,
    max_force: float = 100.0,
    edge_probability: float = 0.5,
    springs: npt.ArrayLike | None = None,
    switch_every: int | None = None,
    observation_noise: float = 0.0,
    seed: int | torch.Generator = 0,
    burn_in: int = 0,
    initial_position: npt.ArrayLike | None = None,
    initial_velocity: npt.ArrayLike | None = None,
) -> xr.Dataset:
    r"""Simulate particles in a box, some pairs of which are joined by springs.

    .. math::
        \ddot x_i = -k \sum_j s_{ij} (x_i - x_j), \qquad s_{ij} = s_{ji} \in \{0, 1\},

    with elastic walls, integrated by leapfrog in ``substeps`` steps a frame. There is no noise:
    given the springs, the future is certain. Defaults are those of the paper's data, which have no
    observation noise either; frame 0 is the start itself, where the paper's first is 0.1 later.

    Parameters
    ----------
    individuals, steps, trials
        Their numbers; ``steps`` counts the frames of each trial, the first included.
    dt, substeps
        Seconds from one frame to the next, and into how many steps they are cut.
    space
        Number of dimensions, 2 or 3.
    strength
        *k*, the same for all springs.
    half_width
        Half the side of the box around the origin.
    start_spread, start_speed
        Standard deviation of each coordinate at the start, and the speed of all there.
    max_force
        No component of an acceleration is beyond this.
    edge_probability
        That a pair has a spring; pairs are independent.
    springs
        In place of drawing them, 0 and 1 ``(individual, neighbor)`` or ``(trial, individual,
        neighbor)``, symmetric.
    switch_every
        Draw all springs anew every so many frames; ``None``: they last for the whole trial.
    observation_noise
        Standard deviation of what is added to each coordinate of the recorded positions.
    seed
        A whole number, or a generator, which is then used up.
    burn_in
        Frames that are made and not recorded.
    initial_position, initial_velocity
        State to begin with, ``(individual, space)`` or ``(trial, individual, space)``.

    Returns
    -------
    Tracks with ``trial``, and the truth of each step in further variables:

    ``edge_type (trial, time, individual, neighbor)``
        What joins whom in the step from this frame: 1 is a spring.
    ``adjacency``
        Who moves whom in that step: the pairs with a spring.
    ``force (trial, time, term, space, individual)``
        The acceleration at this frame.
    ``next_position``, ``next_velocity``
        The true next state.
    ``true_position``, ``true_velocity``
        Only with observation noise. ``position`` is then the noisy one, and there is no
        ``velocity``.

    ``attrs["simulation"]`` holds all parameters as JSON (:func:`~swarmssm.simulate.dynamics_of`).

    Raises
    ------
    InputError
        Naming the parameter that is out of range.

    References
    ----------
    Kipf, Fetaya, Wang, Welling and Zemel (2018), Neural relational inference for interacting
    systems, ICML.
    """
    dynamics = Springs(
        dt, substeps, space, strength, half_width, start_spread, start_speed, max_force
    )
    check_number("edge_probability", edge_probability, most=1.0)
    start = _Start(individuals, steps, trials, seed, burn_in, initial_position, initial_velocity)
    given = None if springs is None else _pairs_given(springs, trials, individuals)

    def draw(generator: torch.Generator) -> Tensor:
        drawn = torch.rand(
            (trials, individuals, individuals), dtype=torch.float64, generator=generator
        )
        upper = (drawn < edge_probability).triu(1)
        return (upper | upper.mT).to(torch.uint8)

    return _record(dynamics, start, draw, given, switch_every, observation_noise)


def simulate_charged(
    individuals: int = 5,
    steps: int = 49,
    trials: int = 1,
    *,
    dt: float = 0.1,
    substeps: int = 100,
    space: int = 2,
    strength: float = 1.0,
    half_width: float = 5.0,
    start_spread: float = 1.0,
    start_speed: float = 0.5,
    max_force: float = 100.0,
    positive_probability: float = 0.5,
    charges: npt.ArrayLike | None = None,
    switch_every: int | None = None,
    observation_noise: float = 0.0,
    seed: int | torch.Generator = 0,
    burn_in: int = 0,
    initial_position: npt.ArrayLike | None = None,
    initial_velocity: npt.ArrayLike | None = None,
) -> xr.Dataset:
    r"""Simulate charged particles in a box, which attract or repel each other.

    .. math::
        \ddot x_i = k \sum_{j \ne i} q_i q_j \frac{x_i - x_j}{|x_i - x_j|^3}, \qquad q_i = \pm 1,

    with elastic walls, integrated as :func:`simulate_springs` does. ``max_force`` cuts off close
    encounters, as in the paper's data.

    Parameters
    ----------
    individuals, steps, trials, dt, substeps, space, half_width, start_spread, start_speed, \
    max_force, observation_noise, seed, burn_in, initial_position, initial_velocity
        As in :func:`simulate_springs`.
    strength
        *k*.
    positive_probability
        That a charge is +1; else it is -1.
    charges
        In place of drawing them, 1 and -1 ``(individual)`` or ``(trial, individual)``.
    switch_every
        Draw all charges anew every so many frames; ``None``: they last for the whole trial.

    Returns
    -------
    As :func:`simulate_springs`. ``edge_type`` is 0 where two attract each other and 1 where they
    repel, as in the paper; 0 on the diagonal. ``adjacency`` joins all pairs.

    Raises
    ------
    InputError
        Naming the parameter that is out of range.

    References
    ----------
    Kipf, Fetaya, Wang, Welling and Zemel (2018), Neural relational inference for interacting
    systems, ICML.
    """
    dynamics = Charged(
        dt, substeps, space, strength, half_width, start_spread, start_speed, max_force
    )
    check_number("positive_probability", positive_probability, most=1.0)
    start = _Start(individuals, steps, trials, seed, burn_in, initial_position, initial_velocity)
    given = None if charges is None else _repelling(_charges(charges, trials, individuals))

    def draw(generator: torch.Generator) -> Tensor:
        drawn = torch.rand((trials, individuals), dtype=torch.float64, generator=generator)
        return _repelling(drawn < positive_probability)

    return _record(dynamics, start, draw, given, switch_every, observation_noise)


@dataclasses.dataclass
class _Start:
    """How a simulation begins, checked."""

    individuals: int
    steps: int
    trials: int
    seed: int | torch.Generator
    burn_in: int
    position: npt.ArrayLike | None
    velocity: npt.ArrayLike | None

    def __post_init__(self) -> None:
        for name, least in (("individuals", 1), ("steps", 2), ("trials", 1), ("burn_in", 0)):
            check_size(name, getattr(self, name), least)

    def draw(self, dynamics: Particles, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return positions and velocities ``(trial, individual, space)``."""
        positions, velocities = dynamics.start(self.trials, self.individuals, generator)
        if self.position is not None:
            positions = initial_state("initial_position", self.position, positions)
            if bool((positions.abs() > dynamics.half_width).any()):
                raise InputError(
                    "initial_position: somebody is outside the box, whose half_width is "
                    f"{dynamics.half_width:g}."
                )
        if self.velocity is not None:
            velocities = initial_state("initial_velocity", self.velocity, velocities)
        return positions, velocities


def _record(
    dynamics: Particles,
    start: _Start,
    draw: Any,
    given: Tensor | None,
    switch_every: int | None,
    observation_noise: float,
) -> xr.Dataset:
    """Run the particles, and label what happened."""
    check_number("observation_noise", observation_noise)
    if switch_every is not None:
        check_size("switch_every", switch_every, 1)
        if given is not None:
            raise InputError(
                "switch_every: the pairs are given, so that none are drawn. Leave one of them out."
            )
    generator = generator_of(start.seed)
    positions, velocities = start.draw(dynamics, generator)
    frames = start.burn_in + start.steps
    period = frames if switch_every is None else switch_every
    epochs = [draw(generator) if given is None else given for _ in range(-(-frames // period))]
    edge_type = torch.stack(epochs, 1).repeat_interleave(period, 1)[:, :frames]
    noise = observation_noise * torch.randn(
        (start.trials, start.steps, *positions.shape[1:]), dtype=torch.float64, generator=generator
    )
    parts = zip(
        torch.split(positions, TOGETHER),
        torch.split(velocities, TOGETHER),
        _by_trials(epochs),
        strict=True,
    )
    flown = [_fly(dynamics, *part, frames, period) for part in parts]
    states = [torch.cat(values)[:, start.burn_in :] for values in zip(*flown, strict=True)]
    return _labelled(dynamics, start, states, edge_type[:, start.burn_in :], noise, switch_every,
                     observation_noise)  # fmt: skip


def _by_trials(epochs: list[Tensor]) -> list[list[Tensor]]:
    """Return the graphs of all epochs, apart for those trials that move together."""
    return [
        list(part) for part in zip(*(torch.split(graph, TOGETHER) for graph in epochs), strict=True)
    ]


def _fly(
    dynamics: Particles,
    positions: Tensor,
    velocities: Tensor,
    epochs: list[Tensor],
    frames: int,
    period: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return ``(trial, frame, individual, space)`` of positions, velocities and forces.

    There is one frame more than asked for, the state that follows the last.
    """
    place, speed = positions.permute(2, 1, 0).contiguous(), velocities.permute(2, 1, 0).contiguous()
    kept: list[list[Tensor]] = [[], [], []]
    for frame in range(frames):
        if frame % period == 0:
            kinds = epochs[frame // period].permute(1, 2, 0).to(place.dtype).contiguous()
            force = dynamics.acceleration(place, kinds)
        for values, value in zip(kept, (place, speed, force), strict=True):
            values.append(value)
        place, speed, force = dynamics.fly(place, speed, force, kinds)
    for values, value in zip(kept, (place, speed, force), strict=True):
        values.append(value)
    whole = [torch.stack(values).permute(3, 0, 2, 1) for values in kept]
    return whole[0], whole[1], whole[2]


def _labelled(
    dynamics: Particles,
    start: _Start,
    states: list[Tensor],
    edge_type: Tensor,
    noise: Tensor,
    switch_every: int | None,
    observation_noise: float,
) -> xr.Dataset:
    """Return the tracks."""
    dims = ("trial", "time", "space", "individual")
    edge_dims = ("trial", "time", "individual", "neighbor")
    place, speed, force = (value.numpy() for value in states)
    exact = observation_noise == 0
    truth = {
        "next_position": place[:, 1:],
        "next_velocity": speed[:, 1:],
        **({} if exact else {"true_position": place[:, :-1], "true_velocity": speed[:, :-1]}),
    }
    settings = {
        **dynamics.to_dict(),
        "dynamics": dynamics.name,
        "observation_noise": observation_noise,
        "burn_in": start.burn_in,
        "switch_every": switch_every,
        "seed": None if isinstance(start.seed, torch.Generator) else int(start.seed),
    }
    tracks = make_tracks(
        place[:, :-1] + noise.numpy(),
        fps=1.0 / dynamics.dt,
        velocity=speed[:, :-1] if exact else None,
        adjacency=dynamics.joined(edge_type).numpy(),
        variables={
            **{name: (dims, np.swapaxes(value, -1, -2)) for name, value in truth.items()},
            "edge_type": (edge_dims, edge_type.numpy()),
        },
        source_software="swarmssm",
        attrs={"simulation": json.dumps(settings)},
    )
    force_dims = ("trial", "time", "term", "space", "individual")
    shown = np.swapaxes(force[:, :-1], -1, -2)[:, :, None]
    tracks = tracks.assign_coords(term=list(dynamics.terms)).assign(
        force=(force_dims, shown, {"meaning": dynamics.force_meaning})
    )
    tracks["next_position"].attrs["meaning"] = "true position one step later"
    tracks["next_velocity"].attrs["meaning"] = "true velocity one step later"
    return tracks


def _trial_last(values: Tensor, edge_type: Tensor) -> tuple[Tensor, Tensor]:
    """Fold the leading axes into one, and put it last."""
    flat = values.reshape(-1, *values.shape[-2:]).permute(2, 1, 0)
    kinds = edge_type.reshape(-1, *edge_type.shape[-2:]).permute(1, 2, 0)
    return flat, kinds.to(values.dtype)


def _repelling(positive: Tensor) -> Tensor:
    """Return 1 for pairs of one sign, ``(trial, individual, neighbor)``; the diagonal is 0."""
    alike = positive.unsqueeze(-1) == positive.unsqueeze(-2)
    return (alike & ~torch.eye(positive.shape[-1], dtype=torch.bool)).to(torch.uint8)


def _pairs_given(springs: npt.ArrayLike, trials: int, individuals: int) -> Tensor:
    """Return given springs ``(trial, individual, neighbor)``, checked."""
    shape = (trials, individuals, individuals)
    pairs = _expanded("springs", springs, shape)
    own = torch.diagonal(pairs, dim1=-2, dim2=-1)
    good = ((pairs == 0) | (pairs == 1)).all() and (pairs == pairs.mT).all() and (own == 0).all()
    if not bool(good):
        raise InputError(
            "springs: each entry must be 0 or 1, the same for both of a pair, and 0 on the "
            "diagonal."
        )
    return pairs.to(torch.uint8)


def _charges(charges: npt.ArrayLike, trials: int, individuals: int) -> Tensor:
    """Return which of the given charges are positive, ``(trial, individual)``."""
    signs = _expanded("charges", charges, (trials, individuals))
    if not bool((signs.abs() == 1).all()):
        raise InputError("charges: each must be 1 or -1.")
    return signs > 0


def _expanded(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> Tensor:
    """Return an array of the given shape, its first axis possibly left out."""
    try:
        return torch.as_tensor(np.array(values, dtype=np.float64)).expand(shape)
    except (ValueError, TypeError, RuntimeError) as error:
        raise InputError(
            f"{name}: its shape must be {shape[1:]} or {shape}, and it is {np.shape(values)}."
        ) from error
