"""A fit learns what is there to be learned, and tells how it went."""

import math

import numpy as np
import pytest
import torch
from pyro.infer import Trace_ELBO

from swarmssm import metrics
from swarmssm.inference import fit
from swarmssm.inference.data import windows_of
from swarmssm.inference.training import num_coordinates, quiet_pyro
from swarmssm.tracks import make_tracks

COLUMNS = [
    "epoch",
    "step",
    "loss",
    "validation_loss",
    "gradient_norm",
    "mse",
    "mae",
    "seconds",
]


@pytest.fixture(scope="module")
def circles():
    """Three individuals on circles of radius 1, each around its own place, in 8 frames."""
    turn = 2 * np.pi / 8
    angle = turn * np.arange(200)[:, None] + np.array([0.0, 1.0, 2.5])
    centres = np.array([[0, 0], [3, 1], [-2, 2]])
    position = centres + np.stack([np.cos(angle), np.sin(angle)], -1)
    velocity = turn * np.stack([-np.sin(angle), np.cos(angle)], -1)
    return make_tracks(position, velocity=velocity, fps=1.0)


@pytest.fixture(scope="module")
def circling(circles):
    return fit(
        "graph-vae",
        circles,
        epochs=200,
        window=None,
        batch_windows=None,
        lr=0.02,
        seed=0,
        graph="complete",
    )


def test_a_simple_motion_is_learned(circling, circles):
    """In the test part, predictions are nearer than half of what staying put would be off.

    It is off by the chord of an eighth of a circle: 2 sin(pi / 8), in two coordinates.
    """
    test = circling.part(circles, "test")
    error = circling.predictive(test)["position"] - test["position"]
    assert int(error.notnull().sum()) == 29 * 3 * 2
    staying = 2 * math.sin(math.pi / 8) / math.sqrt(2)
    assert float((error**2).mean()) ** 0.5 < 0.5 * staying


def test_the_history_tells_how_it_went(circling, circles):
    history = circling.history
    assert list(history.columns) == COLUMNS
    assert history["epoch"].tolist() == list(range(2, 201, 2))
    assert history["step"].tolist() == history["epoch"].tolist()  # one window, one batch
    assert (np.diff(history["seconds"]) > 0).all()
    assert (history["gradient_norm"] > 0).all()
    first, last = history.iloc[0], history.iloc[-1]
    for name in ("loss", "validation_loss", "mse"):
        assert last[name] < 0.1 * first[name]
    assert last["mae"] < 0.5 < first["mae"]  # staying put has an MAE of 1
    # The scores are those of scaled states on the training part, at the posterior mean.
    best = history["validation_loss"].idxmin()
    train = circling.part(circles, "train")
    predicted = circling.predictive(train)
    scaled = [
        circling.preparation.scaler.transform(
            np.concatenate(
                [
                    part[name].transpose("trial", "time", "individual", "space").to_numpy()
                    for name in ("position", "velocity")
                ],
                axis=-1,
            )
        )
        for part in (train, predicted)
    ]
    # One tells them in float32, the other in float64.
    assert metrics.mse(*scaled) == pytest.approx(history["mse"][best], rel=1e-3)
    assert metrics.mae(*scaled) == pytest.approx(history["mae"][best], rel=1e-3)


def test_noise_is_recovered():
    """Frames that know nothing of each other: what is learned is their mean and spread.

    A standard deviation is known from n numbers to within sd / sqrt(2 n), and the mean loss, a
    mean of 4 n logarithms of Gaussian densities, to within sqrt(0.5 / (4 n)) of their entropy.
    """
    n, deviations = 1000, np.array([0.5, 1.0, 2.0, 0.25])
    drawn = np.random.default_rng(0).normal(size=(n + 1, 1, 4)) * deviations + [1, 0, -1, 0]
    tracks = make_tracks(drawn[..., :2], velocity=drawn[..., 2:], fps=1.0)
    learned = fit(
        "graph-vae",
        tracks,
        steps=200,
        window=None,
        batch_windows=None,
        lr=0.1,
        fractions=(1, 0, 0),
        scaler="none",
        model_options={"scale": None},
    )
    found = learned.model.log_scale.detach().exp().numpy()
    np.testing.assert_allclose(found, deviations, rtol=6 / math.sqrt(2 * n))
    entropy = np.mean(0.5 * np.log(2 * np.pi * np.e) + np.log(deviations))
    last = learned.history.iloc[-1]
    assert abs(last["loss"] - entropy) < 6 * math.sqrt(0.5 / (4 * n))
    assert math.isnan(last["validation_loss"])


def validation_loss(fitted, tracks, window):
    """Return the validation loss of the weights that a fit has kept."""
    windows = windows_of(fitted.prepare(fitted.part(tracks, "validation")), window)
    with torch.no_grad(), torch.random.fork_rng():
        torch.manual_seed(fitted.settings.seed)
        loss = Trace_ELBO().loss(fitted.model, fitted.guide, windows)
    return loss / num_coordinates(windows, fitted.model)


@pytest.fixture(scope="module")
def hasty():
    """Return settings under which the validation loss goes up and down."""
    return {
        "window": 20,
        "batch_windows": 4,
        "lr": 0.05,
        "schedule": "constant",
        "validate_every": 1,
        "seed": 0,
    }


def test_the_best_weights_are_kept(swarm, hasty):
    fitted = fit("graph-vae", swarm, epochs=4, **hasty)
    losses = fitted.history["validation_loss"]
    best = losses.min()
    assert best < losses.iloc[-1]
    with quiet_pyro():
        found = validation_loss(fitted, swarm, 20)
    assert found == pytest.approx(best, rel=1e-5)


@pytest.mark.parametrize("patience", [1, 3])
def test_without_progress_it_stops(swarm, hasty, patience):
    told = []
    fitted = fit("graph-vae", swarm, epochs=60, patience=patience, **hasty, callbacks=[told.append])
    losses = fitted.history["validation_loss"]
    assert len(losses) == len(told) < 60
    assert losses.idxmin() == len(losses) - 1 - patience
    # It had not been out of patience before.
    since_best = [i - losses[: i + 1].idxmin() for i in range(len(losses))]
    assert max(since_best[:-1]) < patience
    # Without a validation part there is nothing to be patient with.
    blind = fit("graph-vae", swarm, epochs=4, patience=1, fractions=(1, 0, 0), **hasty)
    assert len(blind.history) == 4


def test_epochs_and_steps(swarm, brief):
    """Eight windows in batches of three are three steps an epoch."""
    told = []
    shared = {**brief, "batch_windows": 3}
    by_epoch = fit(tracks=swarm, **shared, callbacks=[told.append])
    assert [(p.epoch, p.step) for p in told] == [(1, 3), (2, 6), (3, 9)]
    assert {p.num_epochs for p in told} == {3}
    assert [p.row["loss"] for p in told] == by_epoch.history["loss"].tolist()
    assert told[-1].loss == told[-1].row["loss"]
    # Steps take the place of epochs, and are neither more nor fewer.
    for steps, last in ((7, (3, 7)), (9, (3, 9)), (1, (1, 1))):
        history = fit(tracks=swarm, **{**shared, "steps": steps}).history
        assert (history["epoch"].iloc[-1], history["step"].iloc[-1]) == last
    sparse = fit(tracks=swarm, **{**shared, "epochs": 5, "validate_every": 2}).history
    assert sparse["epoch"].tolist() == [2, 4, 5]


class Recorder:
    """Note what Adam is given at each step."""

    def __init__(self, monkeypatch):
        self.rates, self.norms = [], []
        original = torch.optim.Adam.step

        def step(optimizer, *args, **kwargs):
            (group,) = optimizer.param_groups
            self.rates.append(group["lr"])
            self.norms.append(math.hypot(*(float(p.grad.norm()) for p in group["params"])))
            return original(optimizer, *args, **kwargs)

        monkeypatch.setattr(torch.optim.Adam, "step", step)


def test_the_learning_rate_follows_its_schedule(swarm, brief, monkeypatch):
    seen = Recorder(monkeypatch)
    fit(tracks=swarm, **{**brief, "steps": 5, "lr": 0.02})
    expected = [0.01 * (1 + math.cos(math.pi * k / 5)) for k in range(5)]
    np.testing.assert_allclose(seen.rates, expected, rtol=1e-12)
    seen.rates.clear()
    fit(tracks=swarm, **{**brief, "steps": 5, "lr": 0.02, "schedule": "constant"})
    assert seen.rates == [0.02] * 5


def test_gradients_are_clipped(swarm, brief, monkeypatch):
    seen = Recorder(monkeypatch)
    free = fit(tracks=swarm, **{**brief, "steps": 3, "clip": None, "validate_every": 1}).history
    assert min(seen.norms) > 1
    # The history tells the norm of the epoch's last step, before it is clipped.
    np.testing.assert_allclose(free["gradient_norm"], seen.norms[1::2] + seen.norms[2:], rtol=1e-5)
    seen.norms.clear()
    fit(tracks=swarm, **{**brief, "steps": 3, "clip": 0.5})
    np.testing.assert_allclose(seen.norms, 0.5, rtol=1e-5)


def test_mini_batches_are_all_windows_in_an_order_of_their_own(swarm, brief, monkeypatch):
    from swarmssm.models import SwarmBatch

    taken = []
    original = SwarmBatch.select

    def select(batch, index):
        taken.append(index.tolist())
        return original(batch, index)

    monkeypatch.setattr(SwarmBatch, "select", select)
    fit(tracks=swarm, **{**brief, "batch_windows": 3})
    assert taken.pop(0) == [0, 1]  # on these, model and guide are looked at beforehand
    assert [len(rows) for rows in taken] == [3, 3, 2] * 3
    epochs = [[row for rows in taken[i : i + 3] for row in rows] for i in (0, 3, 6)]
    assert all(sorted(rows) == list(range(8)) for rows in epochs)
    assert len({tuple(rows) for rows in epochs}) == 3
    # One batch of all is not shuffled.
    taken.clear()
    fit(tracks=swarm, **{**brief, "batch_windows": None})
    assert taken == [[0, 1]]


def test_the_loss_is_per_observed_coordinate(swarm, with_gaps, brief):
    """Under one seed the first loss is the negative ELBO over the states that are scored."""
    for tracks in (swarm, with_gaps):
        settings = {**brief, "batch_windows": None, "steps": 1, "graph": "complete"}
        fitted = fit(tracks=tracks, **settings, lr=1e-12, fractions=(1, 0, 0))
        prepared = fitted.prepare(fitted.part(tracks, "train"))
        windows = windows_of(prepared, 20)
        coordinates = 4 * int((prepared.mask[:, 1:] & prepared.mask[:, :-1]).sum())
        with torch.random.fork_rng(), torch.no_grad():
            draws = []
            for seed in range(20):
                torch.manual_seed(seed)
                draws.append(Trace_ELBO().loss(fitted.model, fitted.guide, windows) / coordinates)
        found = fitted.history["loss"].item()
        assert abs(found - np.mean(draws)) < 6 * np.std(draws) * math.sqrt(1 + 1 / 20)
