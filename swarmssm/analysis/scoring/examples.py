"""What the figures of an evaluation show: one imitation, some graphs, runs from random starts."""

import numpy as np
import torch
import xarray as xr

from swarmssm.analysis.posterior.subject import Subject
from swarmssm.analysis.scoring.forecasters import Forecaster, diverged
from swarmssm.inference.prediction import seeded
from swarmssm.tracks import Array, spatial_attributes

__all__ = ["graph_snapshots", "imitation", "random_starts"]

NUM_SNAPSHOTS = 3
NUM_RANDOM_STARTS = 4


def imitation(subject: Subject, forecaster: Forecaster, one_step: Array, seed: int) -> xr.Dataset:
    """Return one trial as it was, as predicted step by step, and as a free run.

    The trial with the most of its states known; from its frame with the most individuals, the
    earliest of them in the first half of the trial.
    """
    trial = int(subject.mask.sum(axis=(1, 2)).argmax())
    present = subject.mask[trial].sum(axis=-1)
    rows = np.flatnonzero(present)
    first = int(rows[0] + np.argmax(present[rows[0] : max(rows[-1] // 2, rows[0]) + 1]))
    steps = int(rows[-1]) - first
    true = subject.states[trial, first : first + steps + 1]
    free = np.full_like(true, np.nan)
    free[0] = true[0]
    if steps:
        runs = forecaster.simulate(np.array([trial]), np.array([first]), steps, draws=1, seed=seed)
        if runs is not None:
            free[1:] = runs[0, 0]
    single = one_step[trial, first : first + steps + 1]
    dims = ("time", "individual", "space")
    data = {}
    for name, states in (("true", true), ("one_step", single), ("free_run", free)):
        finite = np.where(np.isfinite(states), states, np.nan)
        position, velocity = np.split(finite, 2, axis=-1)
        data[name], data[f"{name}_velocity"] = (dims, position), (dims, velocity)
    coords = {
        "time": np.arange(steps + 1) / subject.fps,
        "space": subject.tracks["space"].to_numpy(),
        "individual": subject.tracks["individual"].to_numpy(),
    }
    label = str(subject.tracks["trial"].to_numpy()[trial])
    return xr.Dataset(data, coords, {"trial": label, **spatial_attributes(subject.tracks)})


def graph_snapshots(subject: Subject, probability: Array | None) -> xr.Dataset:
    """Return some frames of one trial with their true graph and what was predicted of it."""
    if probability is None:
        probability = np.full(subject.adjacency.shape, np.nan)
    trial = int(subject.mask.sum(axis=(1, 2)).argmax())
    both = subject.mask[trial, 1:].sum(axis=-1) * subject.mask[trial, :-1].any(axis=-1)
    usable = 1 + np.flatnonzero(both)
    if not usable.size:
        usable = np.flatnonzero(subject.mask[trial].any(axis=-1))
    shares = np.linspace(0, 1, NUM_SNAPSHOTS + 2)[1:-1]
    rows = np.unique(usable[(shares * (usable.size - 1)).round().astype(np.int64)])
    known = subject.mask[trial, rows]
    position = subject.states[trial, rows, :, : subject.num_space]
    pairs = ("snapshot", "individual", "neighbor")
    names = subject.tracks["individual"].to_numpy()
    return xr.Dataset(
        {
            "position": (("snapshot", "individual", "space"), position),
            "true": (pairs, subject.adjacency[trial, rows]),
            "probability": (
                pairs,
                np.where(known[..., None] & known[:, None], probability[trial, rows], np.nan),
            ),
        },
        {
            "snapshot": (rows - np.flatnonzero(subject.mask[trial].any(axis=-1))[0]) / subject.fps,
            "space": subject.tracks["space"].to_numpy(),
            "individual": names,
            "neighbor": names,
        },
        spatial_attributes(subject.tracks),
    )


def random_starts(subject: Subject, edges: str, *, steps: int, seed: int) -> xr.Dataset:
    """Return free runs from random starts (section 4.3, fig. 4.14).

    Positions are uniform in the box of the scored positions, velocities are drawn from all those
    scored, each by itself. The first graph is that of the rule; where none is known, that of a
    random frame.
    """
    generator = np.random.default_rng(seed)
    known = subject.states[subject.mask]
    low, high = np.split(np.stack([known.min(axis=0), known.max(axis=0)]), 2, axis=-1)[0]
    count = subject.mask.shape[-1]
    shape = (NUM_RANDOM_STARTS, count)
    position = generator.uniform(low, high, (*shape, subject.num_space))
    velocity = known[generator.integers(len(known), size=shape), subject.num_space :]
    start = np.concatenate([position, velocity], axis=-1)
    rule = subject.fit.preparation.rule
    if rule is None:
        frames = subject.inputs.adjacency.flatten(0, 1)
        graph = frames[torch.from_numpy(generator.integers(len(frames), size=len(start)))]
    else:
        graph = rule(torch.from_numpy(position), torch.from_numpy(velocity))
    predictor = subject.fit.predictor(edges)
    beginning = predictor.begin_at(torch.from_numpy(start), graph)
    with seeded(seed):
        path = predictor.run(beginning, steps, sample=True)
    states = subject.fit.preparation.scaler.inverse(path.states.numpy().astype(np.float64))
    states = diverged(states, np.ones(states.shape[:-1], dtype=bool))
    states = np.concatenate([start[:, None], states], axis=1)
    states = np.where(np.isfinite(states), states, np.nan)
    dims = ("run", "time", "individual", "space")
    position, velocity = np.split(states, 2, axis=-1)
    return xr.Dataset(
        {"position": (dims, position), "velocity": (dims, velocity)},
        {
            "time": np.arange(steps + 1) / subject.fps,
            "space": subject.tracks["space"].to_numpy(),
            "individual": subject.tracks["individual"].to_numpy(),
        },
        spatial_attributes(subject.tracks),
    )
