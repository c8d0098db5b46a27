"""Tracks by name."""

import numpy as np
import pytest

from swarmssm.datasets import DATASETS, benchmark_boids, load_dataset
from swarmssm.errors import InputError
from swarmssm.simulate import add_truth, dynamics_of, simulate_boids

ORDER = ("trial", "time", "individual", "space")


def test_names_are_their_own():
    assert all(name == entry.name for name, entry in DATASETS.items())


@pytest.mark.parametrize("name", ["boids", "boids-free"])
def test_the_benchmark_moves_by_the_rule_that_is_told_of_it(shared_data, name):
    tracks = load_dataset(name, shared_data)
    velocity = tracks["velocity"].transpose(*ORDER).to_numpy()
    expected = tracks["next_velocity"].transpose(*ORDER).to_numpy()
    # Noise is in proportion to the speed before the step.
    speed = np.linalg.norm(velocity[:, :-1], axis=-1, keepdims=True)
    errors = ((velocity[:, 1:] - expected[:, :-1]) / speed).ravel()
    # Noise of 0.02 |v|, less where speeds are clamped: there a quarter of the states are.
    assert 0.015 < np.sqrt((errors**2).mean()) < 0.02
    assert (np.abs(errors) < 0.06).mean() > 0.997
    assert abs(errors.mean()) < 6 * 0.02 / np.sqrt(errors.size)


def test_without_the_files_the_same_rule_is_simulated(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark_boids, "FRAMES", 20)
    monkeypatch.setattr(benchmark_boids, "FREE_FRAMES", 20)
    law, free = (dynamics_of(load_dataset(name, tmp_path)) for name in ("boids", "boids-free"))
    assert (law.cohesion_gain, law.wall_gain, law.graph.radius) == (0.5, 1.0, 2.5)
    assert (free.cohesion_gain, free.alignment_gain, free.wall_gain) == (1.0, 0.3, 0.0)
    assert free.graph.radius == 3.0


@pytest.mark.parametrize("name", [n for n, d in DATASETS.items() if d.recorded])
def test_recordings_are_tracks(shared_data, name):
    tracks = load_dataset(name, shared_data)
    assert tracks.sizes["space"] == 2
    assert tracks.attrs["fps"] > 0
    assert bool(np.isfinite(tracks["position"]).any())


def test_the_dog_is_not_among_the_sheep(shared_data):
    tracks = load_dataset("sheep", shared_data)
    assert tracks.sizes["individual"] == 14
    assert tracks.sizes["trial"] == 20
    # Drives differ in length: after its end a drive is unknown.
    known = np.isfinite(tracks["position"]).all(("space", "individual")).sum("time").to_numpy()
    assert known.sum() == 4179


@pytest.mark.parametrize("name", ["vicsek", "couzin", "springs", "charged"])
def test_simulated_sets_know_their_rule(name):
    tracks = load_dataset(name)
    # What joins particles differs between trials.
    assert dynamics_of(tracks.isel(trial=slice(1))).name in name
    assert bool(np.isfinite(tracks["position"]).all())


def test_truth_that_is_added_is_what_a_simulator_writes():
    tracks = simulate_boids(4, 30, 2, seed=1)
    bare = tracks[["position", "velocity"]]
    again = add_truth(bare, dynamics_of(tracks))
    for name in ("next_position", "next_velocity", "adjacency"):
        np.testing.assert_allclose(again[name], tracks[name].transpose(*again[name].dims))
    assert dynamics_of(again) == dynamics_of(tracks)


def test_mistakes_are_told(tmp_path):
    with pytest.raises(InputError, match="'bees' is unknown; choose one of boids"):
        load_dataset("bees")
    with pytest.raises(InputError, match="the recording guppies is not there"):
        load_dataset("guppies", tmp_path)
    tracks = simulate_boids(4, 30, 2, seed=1)
    law = dynamics_of(tracks)
    with pytest.raises(InputError, match="they have no velocity"):
        add_truth(tracks[["position"]], law)
    tracks["position"][0, 3] = np.nan
    with pytest.raises(InputError, match="a state is unknown"):
        add_truth(tracks, law)
