"""A free run begins where the tracks are, stands at their times, and knows no later frame."""

import numpy as np
import pytest

from swarmssm.analysis.plots.scenes import free_run, scenes_of, with_free_run
from swarmssm.errors import InputError


def test_it_goes_on_from_a_frame_at_the_times_of_the_tracks(quick_fit, boids):
    run = free_run(quick_fit, boids, trial="1", start=2.0, steps=12, seed=3)
    assert run["trial"].values.tolist() == ["1"]
    np.testing.assert_allclose(run["time"], 2.0 + 0.1 * np.arange(13))
    own = boids.sel(trial="1").sel(time=2.0, method="nearest")
    np.testing.assert_allclose(run["position"][0, 0], own["position"])
    np.testing.assert_array_equal(run["adjacency"][0, 0], own["adjacency"])
    assert run.attrs["free_run_of"] == "graph-vae"
    assert run.attrs["free_run_start"] == pytest.approx(2.0)
    # It is what the fit forecasts from the frames up to there.
    history = boids.sel(trial=["1"]).isel(time=slice(0, 21))
    forecast = quick_fit.forecast(history, 12, draws=1, seed=3)
    np.testing.assert_array_equal(run["position"][:, 1:], forecast["position"][0])
    np.testing.assert_array_equal(run["adjacency"][:, 1:], forecast["edge_probability"][0] >= 0.5)


def test_what_came_later_changes_nothing(quick_fit, boids):
    changed = boids.copy(deep=True)
    changed["position"][:, 21:] += 100.0
    runs = [free_run(quick_fit, one, start=2.0, steps=5) for one in (boids, changed)]
    np.testing.assert_array_equal(runs[0]["position"], runs[1]["position"])


def test_noise_can_be_left_out(quick_fit, boids):
    runs = [
        free_run(quick_fit, boids, start=2.0, steps=5, noise=noise, seed=seed)["position"]
        for noise, seed in ((False, 0), (False, 1), (True, 0), (True, 1))
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[2], runs[3])


def test_by_default_it_begins_with_the_test_part_and_ends_with_the_tracks(quick_fit, boids):
    first = quick_fit.split.test[0]
    run = free_run(quick_fit, boids)
    assert run["trial"].values.tolist() == [first.trial]
    row = max(first.start, 10)
    assert run.attrs["free_run_start"] == pytest.approx(row / 10)
    assert run.sizes["time"] == 60 - row
    # Of other tracks it is the middle of what is seen.
    other = boids.isel(time=slice(0, 40)).copy(deep=True)
    other["position"][:, 21:] = np.nan
    assert free_run(quick_fit, other, steps=2).attrs["free_run_start"] == pytest.approx(1.0)


def test_the_tracks_beside_it_have_the_graph_that_the_fit_saw(quick_fit, boids):
    bare = boids.drop_vars(["adjacency", "neighbor"])
    own, run = with_free_run(quick_fit, boids, start=2.0, steps=8)
    observed, predicted = scenes_of(own, run, start=run.attrs["free_run_start"])
    assert len(observed.time) == 9
    np.testing.assert_allclose(observed.position[0], predicted.position[0])
    np.testing.assert_array_equal(observed.adjacency[0], predicted.adjacency[0])
    rule = quick_fit.preparation.rule
    assert rule is not None
    made, _ = with_free_run(quick_fit, bare, start=2.0, steps=8)
    np.testing.assert_array_equal(made["adjacency"], own["adjacency"])


def test_who_was_out_of_sight_for_long_stays_away(quick_fit, boids):
    gone = boids.copy(deep=True)
    gone["position"][:, 5:, :, 0] = np.nan
    run = free_run(quick_fit, gone, start=3.0, steps=4)
    assert np.isnan(run["position"][..., 0]).all()
    assert np.isfinite(run["position"][..., 1:]).all()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"start": 0.0}, r"needs two frames to go on from, and 0 s is the first. Start at 0.1 s"),
        ({"start": 77.0}, "start: 77 s lies outside of the tracks"),
        ({"start": 5.9}, r"nobody is tracked after 5.9 s. Start before, or give steps"),
        ({"start": 2.0, "steps": 0}, "steps: it must be at least 1, and it is 0"),
        ({"trial": "z"}, "there is no trial 'z'"),
        ({"start": 2.0, "edges": "magic"}, "edges: 'magic' is unknown"),
    ],
)
def test_mistakes_are_told(quick_fit, boids, options, sentence):
    with pytest.raises(InputError, match=sentence):
        free_run(quick_fit, boids, **options)


def test_it_cannot_begin_where_nobody_is(quick_fit, boids):
    empty = boids.copy(deep=True)
    empty["position"][:, 15:25] = np.nan
    with pytest.raises(InputError, match=r"nobody is tracked at 2 s. Start at 1.4 s"):
        free_run(quick_fit, empty, start=2.0, steps=3)
