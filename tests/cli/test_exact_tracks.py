"""Who fits a law with tracking noise to tracks without any is told so."""

from pathlib import Path

import pytest

from swarmssm.cli.fitting import _warn_of_exact_tracks
from swarmssm.simulate import simulate_boids


@pytest.mark.parametrize(
    ("noise", "model", "options", "told"),
    [
        (0.0, "boids", {}, True),
        (0.0, "kernel", {"limits": False}, True),
        (0.0, "boids", {"observed": "states"}, False),
        (0.0, "graph-vae", {}, False),
        (0.05, "boids", {}, False),
    ],
)
def test_tracks_without_tracking_noise(capsys, noise, model, options, told):
    tracks = simulate_boids(3, 5, observation_noise=noise, seed=0)
    _warn_of_exact_tracks(Path("flock.nc"), tracks, model, options)
    said = capsys.readouterr().out
    assert said.startswith(f"flock.nc: it was simulated without tracking noise, which {model}") == (
        told
    )
    assert ("observed=states" in said) == told


def test_recordings_are_no_simulations(capsys):
    tracks = simulate_boids(3, 5, seed=0)
    del tracks.attrs["simulation"]
    _warn_of_exact_tracks(Path("fish.nc"), tracks, "boids", {})
    assert not capsys.readouterr().out
