"""Scores of methods of which the errors are known in the head."""

from typing import ClassVar

import numpy as np
import pytest

from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.analysis.scoring.forecasters import BaselineForecaster
from swarmssm.analysis.scoring.references import ConstantVelocity
from swarmssm.benchmark import make_task, measure
from swarmssm.errors import InputError

from .conftest import FPS, straight


def test_constant_velocity_is_right_where_nobody_turns():
    far = {"horizons": (1, 50)}
    task = make_task(straight(200, trials=4), split_by="trial", **far)
    found = measure(task, "constant-velocity", 1, 0)
    assert found.facts["mse"] == pytest.approx(0.0, abs=1e-20)
    assert found.facts["roll_50"] == pytest.approx(0.0, abs=1e-20)
    assert found.facts["amd_error"] == pytest.approx(0.0, abs=1e-12)
    assert found.facts["unscored"] == 0.0
    np.testing.assert_allclose(found.squared_error, 0.0, atol=1e-20)


def test_staying_put_errs_by_the_steps_themselves():
    task = make_task(straight(200), horizons=(1, 5))
    found = measure(task, "stay-put", None, 0)
    # (4.3) is the mean step over the mean step, the same in each frame of a straight line.
    assert found.facts["mae"] == pytest.approx(1.0)
    scale = np.array(task.scaler.scale)
    step = task.states[0, 1] - task.states[0, 0]
    # k steps ahead each position is off by k steps.
    expected = 25.0 * ((step / scale) ** 2).mean()
    assert found.facts["roll_5"] == pytest.approx(expected)


def test_the_true_rule_of_a_swarm_without_noise_makes_no_error(noiseless):
    found = measure(
        make_task(noiseless, horizons=(1, 50), samples=10, free_steps=10), "noise-floor", None, 0
    )
    assert found.facts["mse"] == pytest.approx(0.0, abs=1e-18)
    assert found.facts["roll_50"] == pytest.approx(0.0, abs=1e-12)
    assert found.facts["knows_true_form"]


def test_the_true_rule_with_noise_is_as_sure_as_it_ought_to_be(flock):
    brief = {"horizons": (1, 10), "free_steps": 10}
    facts = measure(make_task(flock, samples=60, **brief), "noise-floor", None, 0).facts
    naive = measure(make_task(flock, **brief), "constant-velocity", None, 0).facts
    assert facts["mse"] < naive["mse"]
    assert facts["crps_10"] < naive["crps_10"]
    assert facts["log_score_10"] > naive["log_score_10"]
    # One trial of 40 origins, 5 individuals, 2 coordinates: at most 400 hits, of which the 40
    # origins are the independent ones.
    assert abs(facts["coverage_10"] - 0.9) < 6.0 * np.sqrt(0.9 * 0.1 / 40)


@pytest.mark.slow
def test_a_model_of_the_package_is_measured_on_the_same_frames(flock):
    task = make_task(flock)
    ours = measure(task, "boids", 20.0, 0)
    floor = measure(task, "noise-floor", None, 0)
    assert ours.crps.shape == floor.crps.shape
    np.testing.assert_array_equal(np.isnan(ours.crps), np.isnan(floor.crps))
    assert ours.facts["knows_true_form"]
    # It knows the forms: five gains from 4 x 149 x 5 steps leave it near the floor.
    assert ours.facts["mse"] < 1.1 * floor.facts["mse"]
    assert ours.facts["parameters"] > 5


class Half(Baseline):
    """Forecasts every second individual only, and breaks down for the first."""

    name: ClassVar[str] = "half"
    title: ClassVar[str] = "half"

    def step(self, window, fps):
        following = ConstantVelocity().step(window, fps)
        following[..., 1::2, :] = np.nan
        return following


def test_who_is_lost_is_infinitely_wrong():
    task = make_task(straight(200, 4))
    trials, rows = task.forecast_origins
    paths = BaselineForecaster(Half(), task.scored).expected(trials, rows, 2)
    assert np.isinf(paths[..., 1::2, :]).all()
    np.testing.assert_allclose(paths[:, :1, ::2], task.scored.ahead(trials, rows, 1)[:, :, ::2])


def test_histories_before_the_first_frame_are_unknown():
    class Long(ConstantVelocity):
        order = 30

        def step(self, window, fps):
            seen.append(window.shape[-3])
            unknown.append(np.isnan(window[:, 0]).all())
            return super().step(window, fps)

    seen, unknown = [], []
    task = make_task(straight(40, trials=4), split_by="trial", horizons=(1,))
    trials, rows = task.forecast_origins
    BaselineForecaster(Long(), task.scored).expected(trials[:1], rows[:1], 1)
    assert rows[0] == 9
    assert seen == [30]
    assert unknown == [True]


def test_a_rule_that_is_not_known_is_no_floor():
    with pytest.raises(InputError, match="no attribute simulation"):
        measure(make_task(straight(200)), "noise-floor", None, 0)


def test_frames_per_second_are_the_tracks():
    assert make_task(straight()).fps == FPS
