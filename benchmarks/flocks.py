"""The experiment of `gain_recovery.py`, `calibration.py` and `collapsed_evidence.py`.

Flocks of ten boids, v' = v + dt (kc C + ks S + ka (mean v_j - v) + kd (v0 - |v|) v / |v|)
+ process_noise sqrt(dt) eps and p' = p + dt v', with dt = 0.1, n = 1, r = 2, v0 = 1, that start
uniformly in a box of 3 x 3 with headings within 0.8 rad of a common one and speed 1. Positions are
seen with noise; velocities are not.
"""

import math

import numpy as np
import pyro.distributions as dist
import torch
import xarray as xr

from swarmssm.models import (
    InitialStates,
    LatentEdges,
    PositionEmission,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.transitions import BoidsTransition
from swarmssm.simulate import simulate_boids

DT, RADIUS, SPEED = 0.1, 2.0, 1.0
TRUTH = {
    "transition.cohesion_gain": 0.6,
    "transition.separation_gain": 0.15,
    "transition.alignment_gain": 0.8,
    "transition.relaxation_gain": 0.5,
    "transition.process_noise": 0.15,
    "emission.noise": 0.03,
}
#: Standard deviations of the logarithm; the medians are the truth above.
PRIOR_SPREAD = dict.fromkeys(TRUTH, 0.5) | {"transition.process_noise": 0.3, "emission.noise": 0.3}
GAINS = list(TRUTH)[:4]


def prior(name: str) -> dist.LogNormal:
    """Return the prior of a parameter."""
    return dist.LogNormal(
        torch.tensor(math.log(TRUTH[name]), dtype=torch.float64),
        torch.tensor(PRIOR_SPREAD[name], dtype=torch.float64),
    )


def draw_truth(seed: int) -> dict[str, float]:
    """Draw all parameters from their priors."""
    rng = np.random.default_rng([seed, 1])
    return {
        name: float(value * np.exp(PRIOR_SPREAD[name] * rng.standard_normal()))
        for name, value in TRUTH.items()
    }


def simulate(
    truth: dict[str, float], seed: int, flocks: int, frames: int, individuals: int = 10
) -> xr.Dataset:
    """Simulate flocks; `position` is noisy, `true_position` and `true_velocity` are not."""
    rng = np.random.default_rng([seed, 2])
    position = rng.uniform(-1.5, 1.5, (flocks, individuals, 2))
    heading = rng.uniform(0.0, 2.0 * np.pi, (flocks, 1))
    heading = heading + rng.uniform(-0.8, 0.8, (flocks, individuals))
    own = {k.split(".")[1]: v for k, v in truth.items() if k.startswith("transition.")}
    return simulate_boids(
        individuals,
        frames,
        flocks,
        form="acceleration",
        dt=DT,
        radius=RADIUS,
        preferred_speed=SPEED,
        exponent=1.0,
        wall_gain=0.0,
        min_speed=0.0,
        max_speed=math.inf,
        noise="additive",
        observation_noise=truth["emission.noise"],
        seed=seed,
        initial_position=position,
        initial_velocity=np.stack([np.cos(heading), np.sin(heading)], -1),
        **own,
    )


def array(tracks: xr.Dataset, name: str) -> torch.Tensor:
    """Return a variable as ``(trial, time, individual, space)``."""
    values = tracks[name].transpose("trial", "time", "individual", "space").to_numpy()
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float64))


def windows(tracks: xr.Dataset) -> SwarmBatch:
    """Return the flocks as windows, seen by their noisy positions."""
    position = array(tracks, "position")
    mask = torch.ones(position.shape[:3], dtype=torch.bool)
    number = position.shape[2]
    complete = 1.0 - torch.eye(number, dtype=torch.float64)
    return SwarmBatch.of(position, mask, complete.expand(*position.shape[:3], number))


def flock_model(velocity_scale: float = 1.0) -> StateSpaceModel:
    """Return the law with all gains and noises unknown, the radius known."""
    transition = BoidsTransition(
        2,
        DT,
        cohesion_gain=prior("transition.cohesion_gain"),
        separation_gain=prior("transition.separation_gain"),
        alignment_gain=prior("transition.alignment_gain"),
        relaxation_gain=prior("transition.relaxation_gain"),
        process_noise=prior("transition.process_noise"),
        preferred_speed=SPEED,
    )
    scale = torch.tensor([2.0, 2.0, velocity_scale, velocity_scale], dtype=torch.float64)
    return StateSpaceModel(
        InitialStates(torch.zeros(4, dtype=torch.float64), scale),
        transition,
        PositionEmission(2, prior("emission.noise")),
        LatentEdges(f"radius:{RADIUS}"),
    ).double()


def design(position: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
    """Return the four terms with gain 1, ``(..., individual, space, term)``."""
    from swarmssm import forces
    from swarmssm.graphs import GraphRule

    graph = GraphRule.parse(f"radius:{RADIUS}")(position, velocity)
    terms = [
        forces.cohesion(position, graph),
        forces.separation(position, graph),
        forces.alignment(velocity, graph),
        forces.speed_regulation(velocity, SPEED),
    ]
    return torch.stack(terms, -1)


def regress(position: torch.Tensor, velocity: torch.Tensor) -> tuple[np.ndarray, np.ndarray, float]:
    """Regress accelerations on the four terms by least squares.

    Parameters
    ----------
    position, velocity
        ``(trial, time, individual, space)``, at the same frames.

    Returns
    -------
    Gains, their standard errors, and the residual noise in the unit of `process_noise`.
    """
    change = (velocity[:, 1:] - velocity[:, :-1]) / DT
    rows = design(position[:, :-1], velocity[:, :-1]).reshape(-1, 4).numpy()
    target = change.reshape(-1).numpy()
    gains, *_ = np.linalg.lstsq(rows, target, rcond=None)
    residual = target - rows @ gains
    variance = residual @ residual / (len(target) - 4)
    errors = np.sqrt(variance * np.diag(np.linalg.inv(rows.T @ rows)))
    return gains, errors, float(np.sqrt(variance * DT))


def finite_differences(tracks: xr.Dataset) -> tuple[np.ndarray, np.ndarray, float]:
    """Regress accelerations from differences of noisy positions, as is usually done."""
    position = array(tracks, "position")
    return regress(position[:, 1:], (position[:, 1:] - position[:, :-1]) / DT)


def exact_states(tracks: xr.Dataset) -> tuple[np.ndarray, np.ndarray, float]:
    """Regress on the true states: what finite data leave open even without tracking noise."""
    return regress(array(tracks, "true_position"), array(tracks, "true_velocity"))
