"""Log-likelihoods with the latent states summed out, by the model and by hand."""

import numpy as np
import pytest
import torch
from scipy.stats import norm

from swarmssm.analysis.posterior import log_likelihood as module
from swarmssm.analysis.posterior import pointwise_log_likelihood, window_log_likelihood
from swarmssm.analysis.posterior.foresight import has_parameter_draws
from swarmssm.analysis.posterior.log_likelihood import Window, windows_over
from swarmssm.errors import InputError
from swarmssm.inference import fit
from swarmssm.inference.filtering import collapsed_evidence
from swarmssm.models.pyro_modules import own_parameters
from swarmssm.tracks import make_tracks
from swarmssm.tracks.splits import Segment

DRAWS = 4


def test_whole_trials_are_their_evidence(springs_fit, gappy):
    found = window_log_likelihood(springs_fit, gappy, DRAWS, seed=5)
    assert found.dims == ("draw", "window")
    assert list(found["trial"].values) == [str(n) for n in gappy["trial"].values]
    drawn = springs_fit.parameters(DRAWS, 5)
    batch = springs_fit.prepare(gappy).batch()
    for draw in range(DRAWS):
        values = {str(n): torch.tensor(drawn[n].to_numpy()[draw]) for n in drawn.data_vars}
        with own_parameters(springs_fit.model), torch.no_grad():
            evidence = collapsed_evidence(springs_fit.model, batch, values, method="extended")
        # The model is of single precision, in which the law's own numbers are rounded.
        np.testing.assert_allclose(found[draw], evidence, rtol=1e-4)


def test_windows_add_up_to_the_trial(springs_fit, ten_trials):
    whole = window_log_likelihood(springs_fit, ten_trials, DRAWS)
    parts = window_log_likelihood(springs_fit, ten_trials, DRAWS, window=4)
    # 14 frames: 4, 4 and the rest.
    assert list(parts["stop"].values - parts["start"].values)[:3] == [4, 4, 6]
    np.testing.assert_allclose(parts.groupby("trial").sum().sel(trial="3"), whole[:, 3])
    assert int(parts["positions"].sum()) == 10 * 14 * 3


def test_margins_are_nan_where_nobody_was_seen(springs_fit, gappy):
    found = pointwise_log_likelihood(springs_fit, gappy, DRAWS)
    assert found.dims == ("draw", "trial", "time", "individual")
    seen = np.isfinite(gappy["position"].transpose(*found.dims[1:], "space")).all("space")
    np.testing.assert_array_equal(np.isfinite(found), np.broadcast_to(seen, found.shape))
    assert found.attrs["units"] == "nat"
    assert "Kalman" in found.attrs["how"]


def test_a_single_body_has_one_margin(springs_fit, swarms):
    alone = swarms(2, 8, 1, seed=3)
    margins = pointwise_log_likelihood(springs_fit, alone, DRAWS).sum(("time", "individual"))
    np.testing.assert_allclose(margins, window_log_likelihood(springs_fit, alone, DRAWS))


def test_draws_follow_the_seed(springs_fit, ten_trials):
    one, same, other = (
        pointwise_log_likelihood(springs_fit, ten_trials.isel(trial=[0]), DRAWS, seed)
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.allclose(one, other)
    assert has_parameter_draws(springs_fit)


@pytest.fixture(scope="module")
def exact_fit(ten_trials):
    """States observed exactly, the velocities being differences."""
    return fit(
        "linear",
        make_tracks(
            ten_trials["position"].transpose("trial", "time", "individual", "space").to_numpy(),
            fps=5.0,
            adjacency=ten_trials["adjacency"].to_numpy(),
        ),
        guide="parameters",
        model_options={"observed": "states"},
        epochs=2,
        seed=0,
    )


def test_exact_states_are_a_step_by_hand(exact_fit, ten_trials):
    tracks = make_tracks(
        ten_trials["position"].transpose("trial", "time", "individual", "space").to_numpy(),
        fps=5.0,
        adjacency=ten_trials["adjacency"].to_numpy(),
    )
    found = pointwise_log_likelihood(exact_fit, tracks, DRAWS, seed=1)
    # Nothing is known of a velocity in the first frame, nor of a step from there.
    assert np.isnan(found[:, :, :2]).all()
    drawn = exact_fit.parameters(DRAWS, 1)
    law = {str(n).rpartition(".")[2]: drawn[n].to_numpy() for n in drawn.data_vars}
    home = exact_fit.model.transition.home.numpy()
    place = tracks["position"].transpose("trial", "time", "individual", "space").to_numpy()
    p, v = place[0, 4], (place[0, 4] - place[0, 3]) * 5.0
    others = (1.0 - np.eye(3)) / 2.0
    for draw in range(DRAWS):
        k = {name: float(value[draw]) for name, value in law.items()}
        force = k["cohesion_gain"] * (others @ p - p) + k["alignment_gain"] * (others @ v - v)
        force += k["homing_gain"] * (home - p) - k["damping"] * v
        moved = p + 0.2 * (v + 0.2 * force)
        density = norm.logpdf(place[0, 5], moved, 0.2 * k["process_noise"] * np.sqrt(0.2)).sum(-1)
        np.testing.assert_allclose(found[draw, 0, 5], density, rtol=1e-3, atol=1e-3)


def test_points_for_weights_give_one_value(quick_fit, boids):
    part = boids.isel(trial=[0], time=slice(0, 12))
    found = pointwise_log_likelihood(quick_fit, part, 3)
    np.testing.assert_array_equal(found[0], found[2])
    assert "sampled from the guide" in found.attrs["how"]
    assert not has_parameter_draws(quick_fit)
    # A density of positions in the tracks' own unit: ten times as long, a hundred times less dense.
    from dataclasses import replace

    scaler = quick_fit.preparation.scaler
    wide = replace(scaler, scale=tuple(10.0 * s for s in scaler.scale))
    wide = replace(wide, offset=tuple(10.0 * o for o in scaler.offset))
    own = replace(quick_fit, preparation=replace(quick_fit.preparation, scaler=wide))
    longer = part.copy()
    for name in ("position", "velocity"):
        longer[name] = 10.0 * part[name]
    stretched = pointwise_log_likelihood(own, longer, 3)
    np.testing.assert_allclose(stretched, found - 2 * np.log(10.0), atol=2e-3)


def test_windows_skip_what_cannot_be_scored():
    scored = np.zeros((2, 12), dtype=bool)
    scored[0, 2:11] = True
    scored[0, 5:8] = False
    assert windows_over(scored, ["a", "b"], None, 3) == [Window(0, 2, 5), Window(0, 8, 11)]
    assert windows_over(scored, ["a", "b"], (Segment("a", 0, 4),), None) == [Window(0, 2, 4)]
    with pytest.raises(InputError, match="foresees no position"):
        windows_over(scored, ["a", "b"], (Segment("b", 0, 4),), None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"draws": 0}, "draws: it must be at least 1"),
        ({"window": 0}, "window: it must be at least 1 frame"),
        ({"part": "middle"}, "part: 'middle' is unknown"),
        ({"part": "test"}, "the test part is empty"),
    ],
)
def test_wrong_input(springs_fit, ten_trials, options, words):
    with pytest.raises(InputError, match=words):
        window_log_likelihood(springs_fit, ten_trials, **options)


def test_a_part_is_of_the_own_tracks(springs_fit, gappy):
    with pytest.raises(InputError, match="not the tracks that the model was fitted on"):
        window_log_likelihood(springs_fit, gappy, DRAWS, part="train")
    assert module.rows_of(["a"], 3, (Segment("a", 1, 3),)).tolist() == [[False, True, True]]
