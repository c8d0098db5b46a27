"""The scores on known data reproduce figures that were published with the data."""

import json

import numpy as np
import pytest

from swarmssm import metrics

HISTORY = 49
HORIZONS = (1, 5, 10, 20, 50)


@pytest.fixture(scope="module")
def boids(shared_data):
    """Test runs (trial, time, individual, [x, y, vx, vy]), scale and offset, and the rule."""
    with np.load(shared_data / "boids_benchmark" / "boids.npz") as file:
        states = file["X"].astype(float)
        train, test = states[file["train"]], states[file["test"]]
        rule = json.loads(str(file["params"]))
    low, high = train.min(axis=(0, 1, 2)), train.max(axis=(0, 1, 2))
    return test, (lambda states: (states - low) / (high - low)), rule


def stay(states, rule):
    return states


def constant_velocity(states, rule):
    position, velocity = states[..., :2], states[..., 2:]
    return np.concatenate([position + rule["dt"] * velocity, velocity], axis=-1)


def noise_free_step(states, rule):
    """Take the simulator's own step without its noise, as the data's README writes it."""
    position, velocity = states[..., :2], states[..., 2:]
    to_other = position[..., None, :, :] - position[..., :, None, :]
    distance = np.linalg.norm(to_other, axis=-1)
    sees = (distance < rule["r"]) & ~np.eye(position.shape[-2], dtype=bool)
    number = np.maximum(sees.sum(axis=-1), 1)[..., None]
    cohesion = (sees[..., None] * to_other).sum(axis=-2) / number
    inverse_square = np.divide(1.0, distance**2, out=np.zeros_like(distance), where=sees)
    separation = -(inverse_square[..., None] * to_other).sum(axis=-2)
    difference = velocity[..., None, :, :] - velocity[..., :, None, :]
    alignment = (sees[..., None] * difference).sum(axis=-2) / number
    wall = -np.sign(position) * np.maximum(np.abs(position) - rule["W"], 0)
    velocity = velocity + rule["dt"] * (
        rule["kc"] * cohesion + rule["ks"] * separation + rule["ka"] * alignment + rule["kw"] * wall
    )
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    velocity = velocity * np.clip(speed, rule["vmin"], rule["vmax"]) / speed
    return np.concatenate([position + rule["dt"] * velocity, velocity], axis=-1)


def run(step, start, rule, num_steps):
    """Return ``num_steps`` states after ``start``, on an axis before the individuals."""
    path = [start]
    for _ in range(num_steps):
        path.append(step(path[-1], rule))
    return np.stack(path[1:], axis=-3)


ONE_STEP = [
    (stay, "0.02560", "1.003"),
    (constant_velocity, "0.02289", "0.891"),
    (noise_free_step, "0.00505", "0.445"),
]


@pytest.mark.parametrize(("step", "mse", "mae"), ONE_STEP)
def test_one_step_scores_of_the_boids(boids, step, mse, mae):
    """States min-max scaled, |.| over all four, predictions of t >= 49, L of the whole test runs.

    MAE of staying put is therefore not 1 exactly: the first 49 steps are in L alone.
    """
    test, scaled, rule = boids
    predicted = np.full_like(test, np.nan)
    predicted[:, HISTORY:] = scaled(step(test[:, HISTORY - 1 : -1], rule))
    assert f"{metrics.mse(scaled(test), predicted):.5f}" == mse
    assert f"{metrics.mae(scaled(test), predicted):.3f}" == mae


SEVERAL_STEPS = [
    (stay, ["1.05e-04", "2.27e-03", "7.74e-03", "2.26e-02", "6.85e-02"]),
    (constant_velocity, ["9.31e-05", "1.97e-03", "6.62e-03", "1.89e-02", "5.93e-02"]),
    (noise_free_step, ["2.39e-05", "1.03e-04", "2.00e-04", "7.44e-04", "3.43e-03"]),
]


@pytest.mark.parametrize(("step", "errors"), SEVERAL_STEPS)
def test_errors_of_the_boids_at_several_steps(boids, step, errors):
    """Plain mean square of the scaled error at step k, from 36 starts, every 25 steps from 49."""
    test, scaled, rule = boids
    starts = np.arange(HISTORY, 949, 25)
    truth = np.stack([test[:, start + 1 : start + 51] for start in starts])
    forecasts = run(step, np.stack([test[:, start] for start in starts]), rule, 50)
    scores = metrics.horizon_errors(scaled(truth), scaled(forecasts), HORIZONS)
    assert [f"{error:.2e}" for error in scores.squared_error] == errors
    assert (scores.num_scored == 36 * 3 * 10).all()


FREE_RUNS = [
    (None, "0.975", "0.649"),
    (stay, "1.109 (0.255)", "0.603 (0.153)"),
    (constant_velocity, "2.196 (1.241)", "0.603 (0.153)"),
    (noise_free_step, "0.984 (0.086)", "0.636 (0.077)"),
]


@pytest.mark.parametrize(("step", "cohesion", "alignment"), FREE_RUNS)
def test_free_runs_of_the_boids(boids, step, cohesion, alignment):
    """Mean AMD and AVD of 200 steps from five starts (and mean absolute error over time).

    Where the runs start was not printed: these five give all fourteen figures.
    """
    test, _, rule = boids
    starts = [49, 249, 449, 649, 790]
    truth = np.stack([test[:, start + 1 : start + 201] for start in starts])
    path = truth
    if step:
        path = run(step, np.stack([test[:, start] for start in starts]), rule, 200)
    for score, part, printed in (
        (metrics.amd, np.s_[..., :2], cohesion),
        (metrics.avd, np.s_[..., 2:], alignment),
    ):
        values = score(path[part])
        error = np.abs(values - score(truth[part])).mean()
        shown = f"{values.mean():.3f}" + (f" ({error:.3f})" if step else "")
        assert shown == printed


RECORDINGS = {
    "guppies_trex8/guppies_trex8": ("25 125 315", 0.43, 0.64, None),
    "guppy_pair/guppy_pair_trial_b": ("3 45 327", None, None, 137),
    "sunbleak_trex/sunbleak_frames1200-1499": ("1.7 5.6 9.9", 0.12, 0.74, 1.9),
    "zebrafish_idtracker8/zebrafish_idtracker8": ("30 116 355", 0.35, 0.19, None),
    "zebrafish100_idtracker/zebrafish100_idtracker": ("89 309 770", 0.68, 0.37, 95),
    "sheep_dog/sheep_dog_events_1-2-3-4-5-6": ("0.5 1.5 3.3", 0.90, 0.09, 0.53),
    "goats_gps/goats_gps": ("0 0.15 0.93", 0.53, 0.23, 2.9),
}


@pytest.mark.parametrize(("name", "figures"), RECORDINGS.items())
def test_sanity_figures_of_the_recordings(shared_data, name, figures):
    """Raw finite differences: speed quantiles, mean polarization and |rotation|, median distance.

    Among the goats 44 % of the steps are zero: counted, they would halve both orders. The distance
    is the median over all individuals and frames; for the two groups of eight the printed one is
    another, and so is the polarization of the pair.
    """
    quantiles, polarization, rotation, nearest = figures
    with np.load(shared_data / f"{name}.npz") as file:
        positions = file["xy"].astype(float)
        velocities = np.diff(positions, axis=0) * float(file["fps"])
        if "segment" in file.files:  # drives laid end to end
            velocities[np.diff(file["segment"]) != 0] = np.nan
    if name.startswith("sheep"):
        positions, velocities = positions[:, :14], velocities[:, :14]  # without dog and shepherd

    measured = np.nanquantile(metrics.speeds(velocities), [0.05, 0.5, 0.95])
    for value, printed in zip(measured, quantiles.split(), strict=True):
        assert value == pytest.approx(float(printed), abs=half_a_digit(printed))
    # A flat 0.005 is half of the last digit printed.
    if polarization:
        order = metrics.polarization(velocities)
        assert np.nanmean(order) == pytest.approx(polarization, abs=0.005)
    if rotation:
        order = metrics.rotation(positions[1:], velocities)
        assert np.nanmean(order) == pytest.approx(rotation, abs=0.005)
    if nearest:
        median = np.nanmedian(metrics.nearest_neighbor_distance(positions))
        assert median == pytest.approx(nearest, abs=half_a_digit(str(nearest)))


def half_a_digit(printed):
    """Return by how much a number may differ from its print."""
    return 0.5 * 10.0 ** -len(printed.partition(".")[2])
