"""The filter of many draws against filterpy, and against the package's own filter of one."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from filterpy.kalman import KalmanFilter
from scipy.stats import multivariate_normal

from swarmssm.analysis.posterior import draw_filter
from swarmssm.analysis.posterior.draw_filter import filter_draws
from swarmssm.inference.data import Preparation, prepare
from swarmssm.inference.filtering import collapsed_evidence
from swarmssm.models.parameters import assign
from swarmssm.tracks.scaling import Scaler

DT, SPACE, STATE = 0.2, 2, 4
DRAWS = {
    "transition.alignment_gain": torch.tensor([0.5, 1.5, -0.4], dtype=torch.float64),
    "transition.process_noise": torch.tensor([0.4, 0.2, 0.9], dtype=torch.float64),
}


@pytest.fixture
def prepared(gappy):
    """The first and last trial, in double precision."""
    plain = Preparation(Scaler("none", (0.0,) * 4, (1.0,) * 4), "auto", None, True, "positions")
    found = prepare(gappy.isel(trial=[0, -1]), plain)
    return replace(found, observations=found.observations.double())


@pytest.fixture
def model(law):
    """The law with priors on what the draws are of; their values do not matter."""
    own = law()
    assign(own.transition, "alignment_gain", "Normal(0, 1)")
    assign(own.transition, "process_noise", "LogNormal(0, 1)")
    return own.double()


def judge(prepared, trial, alignment, noise):
    """Filter one trial with filterpy; return the densities of frames and of single positions."""
    mask = prepared.mask[trial].numpy()
    values = prepared.observations[trial].numpy()
    present = np.maximum.accumulate(mask, 0) & np.maximum.accumulate(mask[::-1], 0)[::-1]
    times, count = mask.shape
    kf = KalmanFilter(dim_x=count * STATE, dim_z=count * SPACE)
    first = np.tile([0.0, 0.0, 0.1, 0.0], count)
    spread = np.tile(np.square([1.5, 1.0, 0.5, 0.5]), count)
    there = np.repeat(present[0], STATE)
    kf.x, kf.P = np.where(there, first, 0.0)[:, None], np.diag(np.where(there, spread, 0.0))
    joint, own = np.zeros(times), np.full((times, count), np.nan)
    for t in range(times):
        if t:
            graph = prepared.adjacency[trial, t - 1].numpy().astype(float)
            degree = graph.sum(-1, keepdims=True)
            pull = graph / np.where(degree > 0, degree, 1.0) - np.diag(degree[:, 0] > 0)
            force = np.kron(pull, np.hstack([0.8 * np.eye(2), alignment * np.eye(2)]))
            force += np.kron(np.eye(count), np.hstack([np.zeros((2, 2)), -0.3 * np.eye(2)]))
            pick = np.kron(np.eye(count), np.hstack([np.zeros((2, 2)), np.eye(2)]))
            velocity = pick + DT * force
            reach = np.kron(np.eye(count), np.vstack([DT * np.eye(2), np.eye(2)]))
            still = np.kron(np.eye(count), np.diag([1.0, 1.0, 0.0, 0.0]))
            matrix = still + reach @ velocity
            shake = noise**2 * DT * reach @ reach.T
            stays = np.repeat(present[t] & present[t - 1], STATE)
            comes = np.repeat(present[t] & ~present[t - 1], STATE)
            kf.F = matrix * stays[:, None]
            kf.Q = shake * np.outer(stays, stays) + np.diag(np.where(comes, spread, 0.0))
            kf.predict()
            kf.x = kf.x + np.where(comes, first, 0.0)[:, None]
        seen = np.flatnonzero(mask[t])
        if not seen.size:
            continue
        rows = np.concatenate([[STATE * i, STATE * i + 1] for i in seen])
        pick = np.eye(count * STATE)[rows]
        blur = 0.1**2 * np.eye(len(rows))
        around = pick @ kf.P @ pick.T + blur
        mean = (pick @ kf.x)[:, 0]
        sight = values[t, seen].reshape(-1)
        joint[t] = multivariate_normal.logpdf(sight, mean, around)
        for place, individual in enumerate(seen):
            part = slice(2 * place, 2 * place + 2)
            own[t, individual] = multivariate_normal.logpdf(
                sight[part], mean[part], around[part, part]
            )
        kf.update(sight[:, None], R=blur, H=pick)
    return joint, own


def test_each_draw_is_filterpys(prepared, model):
    found = filter_draws(model, prepared, DRAWS, 3, 1)
    for draw in range(3):
        numbers = [float(values[draw]) for values in DRAWS.values()]
        for trial in range(2):
            joint, own = judge(prepared, trial, *numbers)
            # The law's own parameters are of single precision: 0.8 and 0.3 are 1e-8 off.
            np.testing.assert_allclose(found.joint[draw, trial], joint, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(found.density[draw, trial], own, rtol=1e-5, atol=1e-5)


def test_chunks_and_draws_do_not_mix(prepared, model, monkeypatch):
    whole = filter_draws(model, prepared, DRAWS, 3, 1)
    monkeypatch.setattr(draw_filter, "CHUNK", 1)
    single = filter_draws(model, prepared, DRAWS, 3, 1)
    torch.testing.assert_close(whole.joint, single.joint)
    torch.testing.assert_close(whole.density, single.density, equal_nan=True)


@pytest.mark.parametrize(("layout", "limit"), [("joint", 30), ("blocks", 1)])
def test_frames_add_up_to_the_evidence(prepared, model, monkeypatch, layout, limit):
    monkeypatch.setattr(draw_filter, "JOINT_LIMIT", limit)
    found = filter_draws(model, prepared, DRAWS, 3, 1)
    batch = prepared.batch()
    batch = replace(batch, adjacency=batch.adjacency.double())
    for draw in range(3):
        values = {name: own[draw] for name, own in DRAWS.items()}
        evidence = collapsed_evidence(model, batch, values, method="extended", layout=layout)
        torch.testing.assert_close(found.joint[draw].sum(-1), evidence)


def test_a_model_without_priors_has_one_draw(prepared, law):
    found = filter_draws(law().double(), prepared, {}, 1, 5)
    assert found.joint.shape[:2] == (1, 2)
    assert found.replicates.shape[:2] == (5, 2)


def test_replicates_have_the_moments_that_were_foreseen(prepared, law):
    count = 4000
    found = filter_draws(law().double(), prepared, {}, 1, count)
    mask = prepared.mask
    assert bool(found.replicates.isnan().any(-1).eq(~mask).all())
    drawn = found.replicates[:, mask]
    # N(m, s^2) of what was seen: log-density of it by the draws' own moments is the filter's.
    truth = prepared.observations[mask]
    mean, centred = drawn.mean(0), drawn - drawn.mean(0)
    spread = torch.einsum("dki,dkj->kij", centred, centred) / (count - 1)
    z = (mean - truth).unsqueeze(-1)
    squared = (z.mT @ torch.linalg.solve(spread, z)).flatten()
    density = -0.5 * squared - 0.5 * torch.logdet(spread) - np.log(2 * np.pi)
    # Of squared/2: its standard error is sqrt(squared / n) from the mean and squared/sqrt(2 n) from
    # the variance; of the logarithm of the determinant sqrt(2 / n) and more.
    error = (squared / count).sqrt() + squared / np.sqrt(2 * count) + np.sqrt(2 * 2 / count)
    assert bool(((density - found.density[0][mask]).abs() < 5.0 * error).all())
