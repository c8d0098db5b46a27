"""What comes after an origin changes nothing of what was forecast at it."""

import numpy as np
import pytest

from swarmssm import inference, simulate
from swarmssm.analysis.posterior.subject import subject_of
from swarmssm.analysis.scoring.forecasters import (
    FitForecaster,
    LawForecaster,
    baseline_forecaster,
    law_forecaster,
)
from swarmssm.analysis.scoring.references import REFERENCES

ORIGIN, STEPS = 25, 6


@pytest.fixture(scope="module", params=["difference", "kalman", "auto"])
def fit(request):
    tracks = simulate.simulate_boids(individuals=4, steps=45, trials=3, seed=1)
    return inference.fit("graph-vae", tracks, epochs=1, velocity=request.param, graph="radius:2.5")


def scored_tracks(shift=0.0):
    """Tracks that are not those of the fit, moved apart after the origin."""
    tracks = simulate.simulate_boids(individuals=4, steps=45, trials=2, seed=2)
    later = {"time": slice(ORIGIN + 1, None)}
    generator = np.random.default_rng(0)
    for name in ("position", "velocity", "next_position", "next_velocity"):
        tracks[name] = tracks[name].copy()
        noise = generator.normal(size=tracks[name][later].shape)
        tracks[name][later] = tracks[name][later] + shift * noise
    return tracks


def forecasters(fit, tracks):
    subject = subject_of(fit, tracks)
    found = [FitForecaster(subject, "decoder"), FitForecaster(subject, "rule")]
    found += [baseline_forecaster(kind(), subject, None) for kind in REFERENCES.values()]
    law, _ = law_forecaster(subject)
    return [*found, law] if law else found


def test_nothing_after_the_origin_is_known_at_it(fit):
    trials, rows = np.array([0, 1]), np.array([ORIGIN, ORIGIN])
    before = forecasters(fit, scored_tracks())
    after = forecasters(fit, scored_tracks(shift=3.0))
    assert len(before) == len(after)
    for one, other in zip(before, after, strict=True):
        for name in ("expected", "simulate"):
            options = (2, 0) if name == "simulate" else ()
            first = getattr(one, name)(trials, rows, STEPS, *options)
            second = getattr(other, name)(trials, rows, STEPS, *options)
            assert np.isfinite(first).all()
            np.testing.assert_array_equal(first, second, err_msg=f"{one.name} {name}")
        states, edges = one.one_step()
        changed_states, changed_edges = other.one_step()
        known = slice(0, ORIGIN + 2)
        np.testing.assert_array_equal(states[:, known], changed_states[:, known], one.name)
        np.testing.assert_array_equal(edges[:, known], changed_edges[:, known], one.name)
        if not isinstance(one, LawForecaster):
            assert not np.array_equal(states[:, ORIGIN + 2 :], changed_states[:, ORIGIN + 2 :])


def test_what_is_known_at_the_origin_does_change_it(fit):
    trials, rows = np.array([0, 1]), np.array([ORIGIN + 10, ORIGIN + 10])
    before = forecasters(fit, scored_tracks())
    after = forecasters(fit, scored_tracks(shift=3.0))
    for one, other in zip(before, after, strict=True):
        first, second = (f.expected(trials, rows, STEPS) for f in (one, other))
        assert not np.allclose(first, second), one.name


@pytest.mark.parametrize("fit", ["kalman"], indirect=True)
def test_smoothed_velocities_are_those_of_the_filter(fit):
    """The last smoothed velocity of a history is what the forecast of it starts from."""
    tracks = scored_tracks()
    subject = subject_of(fit, tracks)
    history = tracks.isel(time=slice(0, ORIGIN + 1))
    expected = fit.prepare(history).states[:, -1]
    np.testing.assert_allclose(subject.inputs.states[:, ORIGIN], expected, rtol=1e-9)
