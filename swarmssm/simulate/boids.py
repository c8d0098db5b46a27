"""Boids: cohesion, separation and alignment, as velocities or as accelerations."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy.typing as npt
import torch
import xarray as xr
from torch import Tensor

from swarmssm import forces
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.simulate.attention import Attention, attention_given, heeded
from swarmssm.simulate.directions import random_directions, unit
from swarmssm.simulate.recording import check_choice, check_number, check_space, record

__all__ = ["Boids", "simulate_boids"]

#: What holds for a parameter that is not given, for each form.
DEFAULTS: dict[str, dict[str, Any]] = {
    "acceleration": {
        "cohesion_gain": 0.5,
        "separation_gain": 0.3,
        "alignment_gain": 0.2,
        "wall_gain": 1.0,
        "min_speed": 0.6,
        "max_speed": 1.2,
        "noise": "multiplicative",
        "process_noise": 0.02,
    },
    "velocity": {
        "cohesion_gain": 0.5,
        "separation_gain": 0.3,
        "alignment_gain": 0.95,
        "wall_gain": 0.0,
        "min_speed": 0.0,
        "max_speed": math.inf,
        "noise": "additive",
        "process_noise": 0.3,
    },
}
DEFAULT_RADIUS = 2.5
#: Side of the square or cube in which there is one individual at the start, in radii of sight.
START_SPACING = 0.6
NOISES = ("additive", "multiplicative")
GAINS = {
    "cohesion": "cohesion_gain",
    "separation": "separation_gain",
    "alignment": "alignment_gain",
    "wall": "wall_gain",
    "speed_regulation": "relaxation_gain",
}


@dataclasses.dataclass(frozen=True)
class Boids:
    """The dynamics of :func:`simulate_boids`, which documents the parameters."""

    form: str
    dt: float
    space: int
    graph: GraphRule
    cohesion_gain: float
    separation_gain: float
    alignment_gain: float
    wall_gain: float
    relaxation_gain: float
    exponent: float
    half_width: float
    min_speed: float
    max_speed: float
    preferred_speed: float
    noise: str
    process_noise: float
    attention: Attention | None = None

    name: ClassVar[str] = "boids"
    remedy: ClassVar[str] = "Try a smaller dt, smaller gains, or a max_speed."
    force_meaning: ClassVar[str] = (
        "gain-weighted contribution to the acceleration, or in the velocity form to the velocity"
    )

    def __post_init__(self) -> None:
        check_choice("form", self.form, DEFAULTS)
        check_choice("noise", self.noise, NOISES)
        check_space(self.space)
        for name in ("dt", "half_width", "preferred_speed"):
            check_number(name, getattr(self, name), above_zero=True)
        for name in (*GAINS.values(), "exponent", "min_speed", "process_noise"):
            check_number(name, getattr(self, name))
        check_number("max_speed", self.max_speed, above_zero=True, finite=False)
        if self.min_speed > self.max_speed:
            raise InputError(
                f"min_speed: it is {self.min_speed:g} and must not be above max_speed, which is "
                f"{self.max_speed:g}."
            )
        if self.graph.kind == "visual" and (self.space == 3 or self.graph.body_length is None):
            raise InputError(
                "graph: a visual graph needs two dimensions and its body_length, for instance "
                "visual:body_length=0.5."
            )

    @property
    def terms(self) -> tuple[str, ...]:
        """The three social terms, and wall and speed regulation where their gain is not 0."""
        social = ("cohesion", "separation", "alignment")
        return (*social, *(t for t in list(GAINS)[3:] if getattr(self, GAINS[t]) > 0))

    @property
    def graph_rule(self) -> GraphRule:
        """The rule of the interaction graph."""
        return self.graph

    def start(
        self, trials: int, individuals: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Draw positions in a square or cube where neighbours are in sight, and all headings."""
        shape = (trials, individuals, self.space)
        spacing = START_SPACING * (self.graph.radius or DEFAULT_RADIUS)
        reach = 0.5 * spacing * individuals ** (1 / self.space)
        if self.wall_gain > 0:
            reach = min(reach, self.half_width)
        drawn = torch.rand(shape, dtype=torch.float64, generator=generator)
        speed = torch.rand((*shape[:-1], 1), dtype=torch.float64, generator=generator)
        slowest, fastest = self.min_speed, self.max_speed
        if math.isinf(fastest):
            slowest = max(slowest, 0.5 * self.preferred_speed)
            fastest = max(slowest, self.preferred_speed)
        speed = slowest + (fastest - slowest) * speed
        return reach * (2.0 * drawn - 1.0), speed * random_directions(shape, generator)

    def begin(self, velocities: Tensor) -> Tensor:
        """Return the velocities as they are."""
        return velocities

    def forces(self, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Return gain-weighted terms ``(..., term, individual, space)`` and the graph."""
        graph = self.graph(positions, velocities)
        relative = self.form == "acceleration"
        seen: tuple[Tensor, Tensor | float] = (graph, 1.0)
        if self.attention is not None:
            seen = heeded(graph, self.attention)
        edges, share = seen
        values = {
            "cohesion": lambda: share * forces.cohesion(positions, edges),
            "separation": lambda: forces.separation(positions, edges, self.exponent),
            "alignment": lambda: share * forces.alignment(velocities, edges, relative=relative),
            "wall": lambda: forces.wall(positions, self.half_width),
            "speed_regulation": lambda: forces.speed_regulation(velocities, self.preferred_speed),
        }
        weighted = [getattr(self, GAINS[term]) * values[term]() for term in self.terms]
        return torch.stack(weighted, -3), graph

    def move(
        self,
        positions: Tensor,
        velocities: Tensor,
        force: Tensor,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return the next positions and velocities; without a generator those free of noise."""
        if self.form == "acceleration":
            moved = velocities + self.dt * force.sum(-3)
        else:
            moved = force.sum(-3)
        if generator is not None:
            noise = torch.randn(moved.shape, dtype=moved.dtype, generator=generator)
            if self.noise == "additive":
                scale = torch.tensor(math.sqrt(self.dt), dtype=moved.dtype)
            else:
                scale = torch.linalg.vector_norm(velocities, dim=-1, keepdim=True)
            moved = moved + self.process_noise * scale * noise
        moved = self._clamp(moved, velocities)
        return positions + self.dt * moved, moved

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters, for JSON; a speed without limit is ``None``."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        values["graph"] = self.graph.to_dict()
        values["max_speed"] = None if math.isinf(self.max_speed) else self.max_speed
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Boids":
        """Return the dynamics that :meth:`to_dict` described."""
        limit = values["max_speed"]
        # Recordings of older versions say nothing of it.
        attention = values.get("attention")
        return cls(
            **{
                **values,
                "graph": GraphRule.from_dict(values["graph"]),
                "max_speed": math.inf if limit is None else limit,
                "attention": None if attention is None else attention_given(attention),
            }
        )

    def _clamp(self, moved: Tensor, velocities: Tensor) -> Tensor:
        """Bring the speed between its limits; who would stand still goes on as before."""
        speed = torch.linalg.vector_norm(moved, dim=-1, keepdim=True)
        allowed = speed.clamp(self.min_speed, self.max_speed)
        heading = unit(moved, unit(velocities, torch.zeros_like(velocities)))
        return torch.where(allowed == speed, moved, allowed * heading)


def simulate_boids(
    individuals: int = 10,
    steps: int = 1000,
    trials: int = 1,
    *,
    form: str = "acceleration",
    dt: float = 0.1,
    space: int = 2,
    radius: float | None = None,
    graph: GraphRule | str | None = None,
    cohesion_gain: float | None = None,
    separation_gain: float | None = None,
    alignment_gain: float | None = None,
    wall_gain: float | None = None,
    relaxation_gain: float = 0.0,
    exponent: float = 1.0,
    half_width: float = 4.0,
    min_speed: float | None = None,
    max_speed: float | None = None,
    preferred_speed: float = 1.0,
    noise: str | None = None,
    process_noise: float | None = None,
    attention: npt.ArrayLike | None = None,
    observation_noise: float = 0.0,
    seed: int | torch.Generator = 0,
    burn_in: int = 0,
    initial_position: npt.ArrayLike | None = None,
    initial_velocity: npt.ArrayLike | None = None,
) -> xr.Dataset:
    r"""Simulate boids, (3.16)-(3.20) of the thesis, with the truth behind every step.

    With the terms C, S, A of :mod:`swarmssm.forces` among the neighbours, the wall W and the speed
    regulation R,

    * ``form="velocity"``, (3.19): :math:`v' = k_c C + k_s S + k_a \bar v_j + k_w W + k_d R`;
    * ``form="acceleration"``:
      :math:`v' = v + dt\,(k_c C + k_s S + k_a (\bar v_j - v) + k_w W + k_d R)`.

    Noise is added to v', its length is then brought between ``min_speed`` and ``max_speed``, and
    :math:`p' = p + dt\, v'`. All individuals move at once.

    Parameters
    ----------
    individuals, steps, trials
        Their numbers; ``steps`` counts the frames of each trial, the first included.
    form
        ``"acceleration"`` or ``"velocity"``. The defaults of the former make a flock that wanders
        between soft walls. Those of the latter, without walls and limits of speed, make one that
        holds together and drifts: with an alignment gain below 1 its speed decays, and noise
        keeps it going.
    dt
        Seconds from one frame to the next.
    space
        Number of dimensions, 2 or 3.
    radius
        *r* of (3.20): how far an individual sees; 2.5.
    graph
        In place of the radius another rule of who sees whom, or its text such as
        ``"visual:body_length=0.5"`` (:class:`~swarmssm.graphs.GraphRule`).
    cohesion_gain, separation_gain, alignment_gain
        *k_c*, *k_s*, *k_a*: 0.5, 0.3, 0.2, and for velocities 0.5, 0.3, 0.95.
    wall_gain, half_width
        *k_w* and half the side of the box around the origin: 1, and for velocities 0, which is no
        wall.
    relaxation_gain, preferred_speed
        *k_d* and *v_0* of the speed regulation :math:`R = (v_0 - |v|)\, v / |v|`.
    exponent
        *n* of (3.17).
    min_speed, max_speed
        Limits of speed: 0.6 and 1.2, and for velocities 0 and ``math.inf``. Who would stand still
        below ``min_speed`` goes on in the old direction.
    noise, process_noise
        ``"additive"``: standard deviation ``process_noise * sqrt(dt)`` of each coordinate of v'.
        ``"multiplicative"``: ``process_noise * |v|``. The default is multiplicative with 0.02,
        and for velocities additive with 0.3.
    attention
        How much an individual heeds each neighbor, ``(individual, neighbor)`` of weights
        :math:`w_{ij}` from 0 upwards; all 1 if absent. The weight multiplies what j adds to the
        sum in S and, after the division by the number of neighbors, to the means in C and A:
        :math:`C_i = \sum_j w_{ij} (p_j - p_i) / |\mathcal{N}_i|`. One with weight 0 is in sight and
        counted among the neighbors, and moves i in no way.
        :func:`~swarmssm.simulate.attention.planted_attention` makes a leader or an isolated
        individual.
    observation_noise
        Standard deviation of what is added to each coordinate of the recorded positions.
    seed
        A whole number, or a generator, which is then used up.
    burn_in
        Steps that are made and not recorded.
    initial_position, initial_velocity
        State to begin with, ``(individual, space)`` or ``(trial, individual, space)``. If absent,
        positions are uniform in a square or cube around the origin with one individual in
        ``(0.6 r) ** space`` (but inside the walls), headings are uniform all around, and speeds
        between their limits, or without limit between a half and the whole ``preferred_speed``.

    Returns
    -------
    Tracks with ``trial``, and the truth of each step in further variables:

    ``force (trial, time, term, space, individual)``
        Contribution of each term, gain included, to the step from this frame: accelerations, or
        velocities in the velocity form. Terms are ``cohesion``, ``separation``, ``alignment`` and,
        where their gain is not 0, ``wall`` and ``speed_regulation``.
    ``adjacency``
        Who saw whom in that step, heeded or not.
    ``next_position``, ``next_velocity``
        The next state free of noise (speed limits applied), given the true state of this frame.
        What a recording differs from it by is the noise floor of every one-step score.
    ``true_position``, ``true_velocity``
        Only with observation noise. ``position`` is then the noisy one, and there is no
        ``velocity``; without it ``velocity`` is exact.

    ``attrs["simulation"]`` holds all parameters as JSON (:func:`~swarmssm.simulate.dynamics_of`).

    Raises
    ------
    InputError
        Naming the parameter that is out of range.
    WorkError
        If the simulation explodes, naming the step.
    """
    check_choice("form", form, DEFAULTS)
    if radius is not None and graph is not None:
        raise InputError("graph: it takes the place of radius; give only one of the two.")
    if isinstance(graph, str):
        graph = GraphRule.parse(graph)
    if graph is None:
        check_number("radius", DEFAULT_RADIUS if radius is None else radius)
        graph = GraphRule("radius", radius=DEFAULT_RADIUS if radius is None else radius)
    given = {
        "cohesion_gain": cohesion_gain,
        "separation_gain": separation_gain,
        "alignment_gain": alignment_gain,
        "wall_gain": wall_gain,
        "min_speed": min_speed,
        "max_speed": max_speed,
        "noise": noise,
        "process_noise": process_noise,
    }
    chosen = {name: value for name, value in given.items() if value is not None}
    dynamics = Boids(
        form=form,
        dt=dt,
        space=space,
        graph=graph,
        relaxation_gain=relaxation_gain,
        exponent=exponent,
        half_width=half_width,
        preferred_speed=preferred_speed,
        attention=None if attention is None else attention_given(attention, individuals),
        **{**DEFAULTS[form], **chosen},
    )
    return record(
        dynamics,
        individuals=individuals,
        steps=steps,
        trials=trials,
        observation_noise=observation_noise,
        seed=seed,
        burn_in=burn_in,
        initial_position=initial_position,
        initial_velocity=initial_velocity,
    )
