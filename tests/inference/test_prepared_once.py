"""Tracks are prepared once, as long as they are not changed."""

import gc

import numpy as np

from swarmssm.inference import data
from swarmssm.inference.data import Preparation, prepare
from swarmssm.simulate import simulate_boids
from swarmssm.tracks.scaling import Scaler

PREPARATION = Preparation(Scaler("none", (0.0,) * 4, (1.0,) * 4), "auto", None, True, "positions")


def flock():
    return simulate_boids(individuals=3, steps=20, observation_noise=0.02, seed=1)


def test_equal_preparations_of_the_same_tracks_share_a_result():
    tracks = flock()
    again = Preparation(Scaler("none", (0.0,) * 4, (1.0,) * 4), "auto", None, True, "positions")
    other = Preparation(Scaler("none", (0.0,) * 4, (2.0,) * 4), "auto", None, True, "positions")
    found = prepare(tracks, PREPARATION)
    assert prepare(tracks, again) is found
    assert prepare(tracks, other) is not found


def test_tracks_that_were_changed_in_place_are_prepared_anew():
    tracks = flock()
    before = prepare(tracks, PREPARATION).observations.clone()
    tracks["position"].to_numpy()[0, 5] += 1.0
    after = prepare(tracks, PREPARATION).observations
    np.testing.assert_allclose((after - before).abs().amax((-1, -2))[0, 5], 1.0, atol=1e-6)
    tracks.attrs["arena"] = "a tank"
    assert prepare(tracks, PREPARATION).tracks.attrs["arena"] == "a tank"


def test_nothing_is_remembered_of_tracks_that_are_gone():
    gc.collect()
    remembered = len(data._PREPARED)
    tracks = flock()
    found = prepare(tracks, PREPARATION)
    assert len(data._PREPARED) == remembered + 1
    del tracks
    gc.collect()
    assert len(data._PREPARED) == remembered
    assert found.observations.isfinite().all()
