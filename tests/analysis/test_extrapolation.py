"""What is told of animals that leave the region that a model was trained in."""

import numpy as np
import pytest

from swarmssm import inference
from swarmssm.analysis.interpretation.analyze import analyze
from swarmssm.analysis.interpretation.extrapolation import beyond_training
from swarmssm.tracks import make_tracks


@pytest.fixture(scope="module")
def square():
    """Two animals that fill the square from 0 to 10, and a fit to them."""
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0.0, 0.3, (200, 2, 2)), axis=0)
    path = 10.0 * (path - path.min((0, 1))) / np.ptp(path, axis=(0, 1))
    tracks = make_tracks(path, fps=10.0, individuals=["ann", "bob"], unit="cm")
    return tracks, inference.fit(
        "graph-vae", tracks, guide="encoder", epochs=1, fractions=(1, 0, 0)
    )


def moved(tracks, individual, **by):
    """Return the tracks with one individual moved."""
    position = tracks["position"].copy(deep=True)
    for axis, length in by.items():
        position.loc[{"individual": individual, "space": axis}] += length
    return tracks.assign(position=position).drop_vars("velocity", errors="ignore")


def test_nothing_is_said_of_tracks_within_the_region(square):
    tracks, fit = square
    found = beyond_training(fit, tracks)
    assert (found.share, found.depth, found.individuals, found.note) == (0.0, 0.0, (), "")


def test_share_depth_and_names_are_those_of_who_was_moved(square):
    tracks, fit = square
    found = beyond_training(fit, moved(tracks, "bob", x=20.0))
    assert found.share == 0.5
    right = float(tracks["position"].sel(individual="bob", space="x").max())
    assert found.depth == pytest.approx((right + 20.0 - 10.0) / 10.0)
    assert found.individuals == ("bob",)
    assert found.note.startswith("50 % of the positions lie outside the rectangle")
    assert "most of those of bob among them" in found.note


def test_who_is_not_seen_does_not_count(square):
    tracks, fit = square
    away = moved(tracks, "bob", x=20.0)
    position = away["position"].copy(deep=True)
    position.loc[{"individual": "bob"}] = np.nan
    found = beyond_training(fit, away.assign(position=position))
    assert (found.share, found.depth, found.individuals) == (0.0, 0.0, ())


def test_a_small_way_beyond_is_not_worth_a_word(square):
    tracks, fit = square
    found = beyond_training(fit, tracks.assign(position=tracks["position"] * 1.001))
    assert 0.0 < found.share < 0.02
    assert found.note == ""


def test_walls_are_named_where_they_were_learned(square):
    tracks, _ = square
    few = tracks.isel(time=slice(0, 40))
    away = moved(few, "bob", y=-30.0)
    for walls in (True, False):
        options = {"limits": False, "walls": walls}
        how = {"model_options": options, "fractions": (1, 0, 0), "steps": 2}
        how["guide_options"] = {"globals": "multivariate"}
        fit = inference.fit("boids", few, guide="linearized", **how)
        assert ("walls=false" in beyond_training(fit, away).note) is walls


def test_an_analysis_passes_it_on(square):
    tracks, fit = square
    notes = analyze(fit, moved(tracks, "bob", x=20.0), draws=1, only=["forces"]).notes
    assert any("outside the rectangle" in note for note in notes)
