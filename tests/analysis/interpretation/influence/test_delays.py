"""Hold delays to followers whose delay is known, and to sums made one by one."""

import numpy as np
import pytest

from swarmssm.analysis.interpretation.influence.delays import first_to_turn, leadership_delays
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks

FPS = 20.0


def followers(delays, times=600, seed=0, noise=0.0, trials=1):
    """Return individuals who take the direction of a wandering one, each so many frames later."""
    rng = np.random.default_rng(seed)
    most = max(delays)
    turns = 0.2 * rng.standard_normal((trials, times + most))
    angle = np.cumsum(turns, -1)
    angles = np.stack([angle[:, most - d : most - d + times] for d in delays], -1)
    angles = angles + noise * rng.standard_normal(angles.shape)
    velocity = np.stack([np.cos(angles), np.sin(angles)], -1)
    return make_tracks(np.cumsum(velocity, 1) / FPS, velocity=velocity, fps=FPS)


def test_followers_have_the_delay_they_were_made_with():
    """0, 3 and 7 frames of 0.05 s behind; the agreement is then perfect."""
    found = leadership_delays(followers([0, 3, 7]), 1.0)
    lags = np.array([0, 3, 7]) / FPS
    expected = lags[:, None] - lags[None, :]
    np.fill_diagonal(expected, np.nan)
    np.testing.assert_allclose(found["delay_of_pair"], expected, atol=1e-12)
    agreement = found["agreement"].to_numpy()
    np.testing.assert_allclose(agreement[~np.eye(3, dtype=bool)], 1.0)
    np.testing.assert_allclose(found["lead"], [0.25, 0.025, -0.275], atol=1e-12)
    # Every resampled recording says the same.
    np.testing.assert_allclose(
        found["lead_interval"], np.tile([0.25, 0.025, -0.275], (3, 1)), atol=1e-12
    )
    assert float(found["follows_probability"][1, 0]) == 1.0
    assert float(found["follows_probability"][0, 1]) == 0.0
    # A delay is known to one frame.
    first = first_to_turn(found)
    half = 0.5 / FPS
    assert first.name == "0"
    np.testing.assert_allclose(
        [first.low, first.lead, first.high], 0.25 + np.array([-half, 0, half])
    )


def test_correlations_are_the_mean_over_pairs_of_frames():
    """By a loop over frames, with some missing, in two trials."""
    tracks = followers([0, 2, 5], 40, noise=0.5, trials=2)
    for name in ("position", "velocity"):
        tracks[name].loc[{"time": tracks["time"][5:9], "individual": "1", "trial": "0"}] = np.nan
    found = leadership_delays(tracks, 0.3)
    velocity = tracks["velocity"].transpose("trial", "time", "individual", "space").to_numpy()
    heading = velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
    for i, j, delay in [(0, 1, 3), (1, 0, 3), (2, 1, -6), (1, 2, 6), (0, 2, 0)]:
        products = [
            heading[trial, t, i] @ heading[trial, t - delay, j]
            for trial in range(2)
            for t in range(40)
            if 0 <= t - delay < 40
        ]
        value = found["correlation"].isel(individual=i, neighbor=j).sel(
            delay=delay / FPS, method="nearest"
        )  # fmt: skip
        np.testing.assert_allclose(value, np.nanmean(products), rtol=1e-12)


def test_noise_leaves_the_delay_and_mirror_images_are_opposite():
    found = leadership_delays(followers([0, 4], 2000, noise=0.3), 1.0)
    delay = found["delay_of_pair"].to_numpy()
    assert delay[1, 0] == pytest.approx(4 / FPS, abs=1.01 / FPS)
    assert delay[0, 1] == -delay[1, 0]
    interval = found["delay_interval"].to_numpy()
    np.testing.assert_allclose(interval[:, 0, 1], -interval[::-1, 1, 0], atol=1e-12)
    assert interval[0, 1, 0] > 0


def test_who_turn_together_follow_nobody():
    found = leadership_delays(followers([0, 0], 400), 0.5)
    np.testing.assert_array_equal(found["lead"], 0.0)
    assert not first_to_turn(found).low > 0


def test_strangers_follow_nobody():
    """Directions that agree no better than 0.5 anywhere."""
    rng = np.random.default_rng(1)
    velocity = rng.standard_normal((500, 3, 2))
    tracks = make_tracks(np.cumsum(velocity, 0) / FPS, velocity=velocity, fps=FPS)
    found = leadership_delays(tracks, 0.5)
    assert found["delay_of_pair"].isnull().all()
    assert found["lead"].isnull().all()
    assert first_to_turn(found) is None


def test_those_far_apart_are_not_counted():
    tracks = followers([0, 3], 200)
    position = tracks["position"].copy()
    position.loc[{"individual": "1"}] += 100.0
    apart = tracks.assign(position=position)
    assert leadership_delays(apart, 0.5, max_distance=50.0)["correlation"].isnull().isel(
        individual=0, neighbor=1
    ).all()  # fmt: skip
    near = leadership_delays(tracks, 0.5, max_distance=1e6)
    np.testing.assert_array_equal(near["delay_of_pair"], leadership_delays(tracks, 0.5)
                                  ["delay_of_pair"])  # fmt: skip


def test_a_short_recording_has_no_intervals():
    found = leadership_delays(followers([0, 3], 60), 1.0)
    assert found.attrs["blocks"] < 5
    assert found["lead_interval"].isnull().all()


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"max_delay": 0.0}, "max_delay"),
        ({"max_delay": 100.0}, "longest trial"),
        ({"least_correlation": 2.0}, "least_correlation"),
        ({"max_distance": -1.0}, "max_distance"),
    ],
)
def test_mistakes(options, word):
    with pytest.raises(InputError, match=word):
        leadership_delays(followers([0, 3], 100), **options)


def test_one_alone_follows_nobody():
    with pytest.raises(InputError, match="one individual"):
        leadership_delays(followers([0], 100))
