"""Linear Gaussian swarms, and the dense joint Gaussian of a window of one."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyro.distributions as dist
import pytest
import torch

from swarmssm.graphs import neighbor_mean
from swarmssm.models import (
    Emission,
    InitialStates,
    KinematicTransition,
    LinearTransition,
    PositionEmission,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.parameters import assign
from swarmssm.models.transitions import Transition

#: Said by torch of itself, the first time that it differentiates forwards.
OWN_WARNING = "ignore:.torch.jit.script. is deprecated:DeprecationWarning"
DOUBLE = torch.float64
SPACE, STATE = 2, 4


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent == Path(__file__).parent:
            item.add_marker(pytest.mark.filterwarnings(OWN_WARNING))


class Springs(KinematicTransition):
    """v' = v + dt (0.8 (mean p_j - p) + 0.5 (mean v_j - v) - 0.2 v) + noise."""

    def __init__(self, noise=0.3, dt=0.2):
        super().__init__(SPACE, dt)
        assign(self, "noise", noise)

    def velocity(self, positions, velocities, inputs):
        both = torch.cat([positions, velocities], -1)
        mean, has = neighbor_mean(both, inputs.adjacency)
        pull = torch.where(has, mean - both, 0.0)
        force = 0.8 * pull[..., :SPACE] + 0.5 * pull[..., SPACE:] - 0.2 * velocities
        if inputs.controls is not None:
            force = force + inputs.controls.unsqueeze(-2)
        return dist.Normal(velocities + self.dt * force, self.noise).to_event(1)


class Bent(Springs):
    """Springs in a bent world: the velocity also follows ``bend * sin(2 p)``."""

    def __init__(self, bend=0.5, **options):
        super().__init__(**options)
        self.bend = bend

    def velocity(self, positions, velocities, inputs):
        straight = super().velocity(positions, velocities, inputs)
        moved = straight.mean + self.dt * self.bend * torch.sin(2 * positions)
        return dist.Normal(moved, self.noise).to_event(1)


class Wave(Transition):
    """A single number: z' = 0.9 z + bend sin(2 z) + noise."""

    def __init__(self, bend):
        super().__init__(1)
        self.bend = bend
        assign(self, "noise", 0.4)

    def forward(self, states, inputs):
        mean = 0.9 * states + self.bend * torch.sin(2 * states)
        return dist.Normal(mean, self.noise).to_event(1)


class Curved(Emission):
    """x = z + bend z^2 / 2 of each feature that is seen, with noise."""

    def __init__(self, bend, seen, noise=0.5):
        super().__init__()
        self.bend, self.seen = bend, seen
        assign(self, "noise", noise)

    def forward(self, states):
        seen = states[..., : self.seen]
        return dist.Normal(seen + 0.5 * self.bend * seen**2, self.noise).to_event(1)


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def general_transition(offset=0.0):
    """A matrix without structure, a little contracting, and full noise."""
    matrix = 0.7 * torch.eye(STATE, dtype=DOUBLE) + 0.15 * rand(STATE, STATE, seed=1)
    coupling = 0.2 * rand(STATE, STATE, seed=2)
    tril = torch.tril(0.1 * rand(STATE, STATE, seed=3), -1) + 0.3 * torch.eye(STATE, dtype=DOUBLE)
    return LinearTransition(STATE, matrix, tril, coupling, offset * rand(STATE, seed=4))


def linear_initial():
    return InitialStates(
        torch.tensor([0.5, -1.0, 0.3, 0.1], dtype=DOUBLE),
        torch.tensor([2.0, 1.5, 0.7, 0.9], dtype=DOUBLE),
    )


@pytest.fixture
def linear_swarm():
    """Build a model by kind of transition."""

    def build(kind, tracking=(0.2, 0.3), **options):
        kinds = {"kinematic": Springs, "general": general_transition}
        transition = kinds[kind](**options)
        initial = linear_initial()
        emission = PositionEmission(SPACE, torch.tensor(tracking))
        return StateSpaceModel(initial, transition, emission).double()

    return build


@pytest.fixture
def bent_swarm():
    """Build a model that is linear but for ``bend``."""

    def build(bend=0.5, curve=0.3, tracking=0.5, **options):
        model = linear_initial(), Bent(bend, **options), Curved(curve, SPACE, tracking)
        return StateSpaceModel(*model).double()

    return build


@pytest.fixture
def wave():
    """Build a model of a single number, seen with noise."""

    def build(bend):
        initial = InitialStates(torch.tensor([0.3]), torch.tensor([0.8]))
        return StateSpaceModel(initial, Wave(bend), Curved(bend, 1)).double()

    return build


@pytest.fixture
def observed():
    """Replace the observations of a batch by those of paths drawn from a model."""

    def draw(model, batch, seed=0):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            paths = model.chain(batch, {}).sample()
            seen = model.emission(paths).sample() * batch.mask.unsqueeze(-1)
        return replace(batch, observations=seen), paths

    return draw


@pytest.fixture
def windows():
    """Make batches of random graphs and observations."""

    def make(batch=2, times=7, individuals=3, missing=(), absent=(), controls=False, seed=10):
        mask = torch.ones(batch, times, individuals, dtype=torch.bool)
        present = mask.clone()
        for index in missing:
            mask[index] = False
        for index in absent:
            mask[index] = False
            present[index] = False
        graph = (rand(batch, times, individuals, individuals, seed=seed) > 0).to(DOUBLE)
        graph = graph * (1 - torch.eye(individuals, dtype=DOUBLE))
        graph = graph * mask.unsqueeze(-1) * mask.unsqueeze(-2)
        observations = 2 * rand(batch, times, individuals, SPACE, seed=seed + 1)
        exogenous = rand(batch, times, SPACE, seed=seed + 2) if controls else None
        made = SwarmBatch.of(observations * mask.unsqueeze(-1), mask, graph, exogenous)
        return replace(made, present=present)

    return make


@dataclass
class Dense:
    """Mean and covariance of all states of a window, and of what was seen, by plain numpy."""

    matrices: list[np.ndarray]
    offsets: list[np.ndarray]
    noises: list[np.ndarray]
    mean: np.ndarray
    covariance: np.ndarray
    pick: np.ndarray
    tracking: np.ndarray
    seen: np.ndarray

    @property
    def log_evidence(self):
        gap, spread = self._seen_moments()
        sign, logdet = np.linalg.slogdet(spread)
        assert sign > 0
        return -0.5 * (gap @ np.linalg.solve(spread, gap) + logdet + len(gap) * np.log(2 * np.pi))

    def _seen_moments(self):
        spread = self.pick @ self.covariance @ self.pick.T + self.tracking
        return self.seen - self.pick @ self.mean, spread

    def posterior(self):
        """Return mean and covariance of all states given what was seen."""
        gap, spread = self._seen_moments()
        gain = np.linalg.solve(spread, self.pick @ self.covariance).T
        return self.mean + gain @ gap, self.covariance - gain @ self.pick @ self.covariance


@pytest.fixture
def dense_judge():
    """Return the dense Gaussian of one window, by asking the model's means at unit vectors."""

    def judge(model, batch, window):
        individuals, times = batch.num_individuals, batch.num_times
        joint = individuals * STATE
        initial = model.initial()
        fresh = np.tile(initial.mean.detach().numpy(), individuals)
        spread = np.diag(np.tile(initial.variance.detach().numpy(), individuals))
        there = batch.present[window].repeat_interleave(STATE, -1).numpy()
        units = torch.eye(joint, dtype=DOUBLE).reshape(joint, individuals, STATE)
        mean = [np.where(there[0], fresh, 0.0)]
        covariance = np.zeros((times * joint, times * joint))
        covariance[:joint, :joint] = spread * np.outer(there[0], there[0])
        matrices, offsets, noises = [], [], []
        for t in range(times - 1):
            inputs = batch.select(torch.tensor([window])).steps().at(t)
            base = model.transition(torch.zeros(1, individuals, STATE, dtype=DOUBLE), inputs)
            offset = base.mean.detach().numpy().reshape(joint)
            moved = model.transition(units, inputs).mean.detach().numpy().reshape(joint, joint)
            matrix = (moved - offset).T
            blocks = base.covariance_matrix.detach().expand(1, individuals, STATE, STATE)[0]
            noise = torch.block_diag(*blocks).numpy()
            persists = there[t] & there[t + 1]
            enters = there[t + 1] & ~there[t]
            matrix = matrix * np.outer(persists, there[t])
            offset = np.where(persists, offset, np.where(enters, fresh, 0.0))
            noise = noise * np.outer(persists, persists) + spread * np.outer(enters, enters)
            matrices.append(matrix)
            offsets.append(offset)
            noises.append(noise)
            mean.append(matrix @ mean[-1] + offset)
            here, after = slice(t * joint, (t + 1) * joint), slice((t + 1) * joint, (t + 2) * joint)
            covariance[after, : (t + 1) * joint] = matrix @ covariance[here, : (t + 1) * joint]
            covariance[: (t + 1) * joint, after] = covariance[after, : (t + 1) * joint].T
            covariance[after, after] = matrix @ covariance[here, here] @ matrix.T + noise
        rows = np.flatnonzero(
            torch.cat(
                [batch.mask[window].unsqueeze(-1)] * SPACE
                + [torch.zeros_like(batch.mask[window]).unsqueeze(-1)] * SPACE,
                -1,
            )
        )
        pick = np.eye(times * joint)[rows]
        sigma = model.emission.noise.numpy()
        seen = batch.observations[window][batch.mask[window]].reshape(-1).numpy()
        tracking = np.diag(np.tile(sigma**2, len(seen) // SPACE))
        return Dense(
            matrices, offsets, noises, np.concatenate(mean), covariance, pick, tracking, seen
        )

    return judge
