import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmssm.errors import InputError
from swarmssm.tracks.time_grid import (
    MAX_FPS,
    check_fps,
    check_increasing,
    grid_rows,
    rate_of,
    time_grid,
)

RATES = [30.0, 25.0, 29.97, 30000 / 1001, 59.94, 1.0, 0.1, 1 / 900, 1 / 86400, 240.0, 1000.0]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("length", [2, 3, 50, 20_000])
def test_the_rate_of_exact_stamps_is_told_exactly(rate: float, length: int):
    assert rate_of(np.arange(length) / rate) == pytest.approx(rate, rel=2e-9)
    # A rate that people write down with a few digits comes back to the last bit.
    if rate in (30.0, 25.0, 29.97, 59.94, 1.0, 0.1, 240.0, 1000.0):
        assert rate_of(np.arange(length) / rate) == rate


def test_stamps_rounded_to_a_millisecond_tell_the_true_rate():
    # The typical step is 0.033 s, that is 30.303 frames per second: after 25 frames it is off by
    # a quarter of a step, and after 20 000 by 200 steps.
    stamps = np.round(np.arange(20_000) / 30.0, 3)
    assert rate_of(stamps) == 30.0
    assert rate_of(stamps[:7]) == pytest.approx(30.0, rel=5e-3)


def test_stamps_in_single_precision_tell_the_true_rate():
    stamps = (1e3 + np.arange(20_000) / 29.97).astype(np.float32).astype(np.float64)
    # Rounding moves a stamp by at most e = 2**-15 s (half a unit in the last place below 2048 s).
    # The slope is then off by at most e * sum|k - mean| / sum (k - mean)^2 steps, that is 3 e / n.
    assert rate_of(stamps) == pytest.approx(29.97, rel=3 * 2**-15 * 29.97 / 20_000)


@given(st.integers(0, 2**32 - 1))
def test_jitter_moves_the_rate_by_no_more_than_its_standard_error(seed: int):
    generator = np.random.default_rng(seed)
    rate, length, jitter = 23.45678, 300, 0.05
    stamps = (np.arange(length) + jitter * generator.uniform(-1, 1, length)) / rate
    # Least squares: sd of the slope = sd of a stamp * sqrt(12 / n^3), in steps a step. The
    # returned rate lies within three of them of the estimate, which lies within six of the truth.
    sd = jitter / np.sqrt(3) * np.sqrt(12 / length**3)
    assert abs(rate_of(stamps) / rate - 1) < (6 + 3) * sd * 1.01


def test_holes_do_not_slow_the_rate():
    kept = np.sort(np.random.default_rng(0).choice(2000, 1500, replace=False))
    assert rate_of(np.round(kept / 30.0, 3)) == 30.0
    # A hole of a hundred steps of 0.033 s would be one frame too long.
    halves = np.concatenate([np.arange(50), 150 + np.arange(50)])
    assert rate_of(np.round(halves / 30.0, 3)) == 30.0
    # Every tenth frame: with the frame numbers the rate of the recording, else that of the rows.
    every_tenth = np.arange(0, 1000, 10)
    assert rate_of(every_tenth / 30.0, every_tenth) == 30.0
    assert rate_of(every_tenth / 30.0) == 3.0


def test_rows_of_jittering_stamps_are_snapped_to_the_grid():
    # Worked by hand, at 10 frames per second; frame 2 is missing.
    rows, stamps, frames, fps = time_grid(4, 10.0, time=[5.0, 5.12, 5.29, 5.4])
    np.testing.assert_array_equal(rows, [0, 1, 3, 4])
    assert frames is None
    assert fps == 10.0
    # Steps off the grid of the first stamp: 0, .2, -.1, 0; their median is 0.
    np.testing.assert_allclose(stamps, [5.0, 5.1, 5.2, 5.3, 5.4], rtol=0, atol=1e-12)


def test_a_first_stamp_that_jitters_does_not_shift_all_others():
    stamps = np.arange(100) / 10.0
    stamps[0] += 0.02
    stamps[50] -= 0.02
    rows, grid, _, _ = time_grid(100, 10.0, time=stamps)
    np.testing.assert_array_equal(rows, np.arange(100))
    np.testing.assert_allclose(grid, np.arange(100) / 10.0, rtol=0, atol=1e-12)


@given(
    st.lists(st.integers(1, 5), min_size=1, max_size=60),
    st.sampled_from(RATES),
    st.floats(0, 1e5),
    st.integers(0, 2**32 - 1),
)
def test_any_jitter_below_a_quarter_of_a_step_is_snapped(
    steps: list[int], rate: float, start: float, seed: int
):
    truth = np.concatenate([[0], np.cumsum(steps)])
    # A grid placed at the median of the stamps is itself off by up to their jitter.
    jitter = np.random.default_rng(seed).uniform(-0.12, 0.12, truth.size)
    rows, _, _, fps = time_grid(truth.size, rate, time=start + (truth + jitter) / rate)
    np.testing.assert_array_equal(rows, truth)
    assert fps == rate


@pytest.mark.parametrize("start", [0.0, 7.3, 12345.678, 1.7e9 + 0.1])
@pytest.mark.parametrize("rate", [30.0, 29.97])
def test_exact_stamps_are_kept_to_the_last_digit(start: float, rate: float):
    stamps = start + np.arange(50) / rate
    _, grid, _, _ = time_grid(50, rate, time=stamps)
    np.testing.assert_array_equal(grid, stamps)
    # Stamps that err in their last digit do not move the first of them.
    _, grid, _, _ = time_grid(50, rate, time=start + np.arange(50) * (1 / rate))
    assert grid[0] == start


def test_frame_numbers_define_the_grid():
    rows, stamps, frames, fps = time_grid(3, 20.0, frames=[10, 11, 14])
    np.testing.assert_array_equal(rows, [0, 1, 4])
    np.testing.assert_array_equal(frames, [10, 11, 12, 13, 14])
    np.testing.assert_allclose(stamps, [0.5, 0.55, 0.6, 0.65, 0.7], rtol=0, atol=1e-15)
    assert fps == 20.0
    # With times instead of fps, the rate is that of frames on times, holes or not.
    frames_and_times = time_grid(3, frames=[0, 10, 20], time=[0.0, 0.5, 1.0])
    assert frames_and_times[3] == 20.0
    np.testing.assert_array_equal(frames_and_times[0], [0, 10, 20])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({}, "fps: frames per second are not known; give fps."),
        ({"frames": [0, 1, 2]}, "fps: frames per second are not known; give fps."),
        ({"fps": 0.0}, "fps: frames per second must lie between 0 and 1e+06, not 0.0."),
        ({"fps": -5}, "fps: frames per second must lie between 0 and 1e+06, not -5."),
        ({"fps": np.nan}, "fps: frames per second must lie between 0 and 1e+06, not nan."),
        ({"fps": np.inf}, "fps: frames per second must lie between 0 and 1e+06, not inf."),
        ({"fps": "fast"}, "fps: frames per second must lie between 0 and 1e+06, not fast."),
        ({"time": [0, 1, 1]}, "time: row 2 (1) repeats the row before it (1); it must increase."),
        (
            {"time": [0, 2, 1]},
            "time: row 2 (1) falls below the row before it (2); it must increase.",
        ),
        ({"time": [0, np.nan, 1]}, "time: row 1 is not a finite number."),
        ({"time": ["a", "b", "c"]}, "time: it must be a number for each row."),
        ({"time": [0, 1]}, "time: 2 are given for 3 rows of position."),
        ({"fps": 1, "frames": [0, 1, 2, 3]}, "frames: 4 are given for 3 rows of position."),
        (
            {"fps": 1, "frames": [0, 1.5, 2]},
            "frames: row 1 (1.5) is not a whole number. Give frame numbers, or seconds as time.",
        ),
        ({"fps": 1, "frames": [0, 1, np.inf]}, "frames: row 2 is not a finite number."),
        (
            {"fps": 1, "frames": [3, 4, 2]},
            "frames: row 2 (2) falls below the row before it (4); it must increase.",
        ),
        (
            {"fps": 1, "frames": [0, 1, 1e17]},
            "frames: row 2 (1e+17) is not a whole number. Give frame numbers, or seconds as time.",
        ),
        (
            {"fps": 1, "frames": [0, 1, 10_000]},
            "frames: 3 rows span 10001 frames at 1 frames per second; nearly all would be missing. "
            "Give the right fps.",
        ),
        (
            {"fps": 1e6, "time": [0, 1, 2]},
            "time: 3 rows span 2000001 frames at 1e+06 frames per second; nearly all would be "
            "missing. Give the right fps.",
        ),
        (
            {"fps": 10, "time": [0, 0.06, 0.12]},
            "time: row 1 (0.06 s) does not lie on a grid of 10 frames per second. Give "
            "the right fps, or frame numbers.",
        ),
        (
            {"fps": 1, "time": [0, 1.0, 1.2]},
            "time: row 2 (1.2 s) does not lie on a grid of 1 frames per second. Give the right "
            "fps, or frame numbers.",
        ),
        ({"time": [0, 1e-320, 1]}, "fps: frames per second must lie between 0 and 1e+06, not inf."),
    ],
)
def test_each_refusal_names_the_argument_the_place_and_the_mend(
    arguments: dict[str, object], sentence: str
):
    with pytest.raises(InputError) as caught:
        time_grid(3, **arguments)
    assert str(caught.value) == sentence


def test_a_rate_that_drifts_off_the_stamps_is_refused():
    # At 25 frames per second the stamps of 30 lose a sixth of a step with each row.
    with pytest.raises(InputError, match=r"^time: row \d+ .* does not lie on a grid of 25 frames"):
        time_grid(5, 25.0, time=np.arange(5) / 30.0)
    # A hundredth of a percent is off by a quarter of a step after 2500 rows.
    assert time_grid(2000, 30.0, time=np.arange(2000) / 30.003)[0][-1] == 1999
    with pytest.raises(InputError, match="does not lie on a grid of 30 frames"):
        time_grid(10_000, 30.0, time=np.arange(10_000) / 30.003)


def test_times_beyond_any_recording_are_refused():
    with pytest.raises(InputError, match=r"^time: the rows span 1e\+300 frames at fps = 1\. Mend"):
        grid_rows(np.array([0.0, 1.0, 1e300]), 1.0, "time", "Mend.")
    with pytest.raises(InputError, match=r"^time: the rows span"):
        time_grid(3, time=[0.0, 1.0, 1e300])


def test_a_rate_from_a_file_may_be_any_kind_of_number():
    for value in (30, 30.0, np.int64(30), np.float32(30), np.array(30.0), np.array([30]), "30"):
        assert check_fps(value, "fps") == 30.0
    assert check_fps(MAX_FPS, "fps") == MAX_FPS
    for wrong in (None, [30, 30], MAX_FPS * 1.01, "", np.array([])):
        with pytest.raises(InputError, match=r"^a.nc: fps: frames per second must lie between"):
            check_fps(wrong, "a.nc: fps")


def test_the_first_place_that_does_not_increase_is_named():
    check_increasing(np.array([1, 2, 3]), "frames")
    with pytest.raises(InputError, match=r"^frames: row 3 \(2\) falls below the row before it \(3"):
        check_increasing(np.array([1, 2, 3, 2, 1]), "frames")
