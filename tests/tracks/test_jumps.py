"""Errors of tracking that were put in are found, and the starts of start-stop swimmers are not."""

import numpy as np
import pytest

from swarmssm import io
from swarmssm.tracks import make_tracks
from swarmssm.tracks.jumps import find_jumps
from swarmssm.tracks.summary import summarize


def burst_and_coast(frames=3000, members=4, decay=0.8, seed=0):
    """Return swimmers that rest, start within one frame about every 50th, and coast to rest."""
    generator = np.random.default_rng(seed)
    speed, velocity = np.zeros((frames, members)), np.zeros((frames, members, 2))
    heading = generator.uniform(0, 2 * np.pi, members)
    for frame in range(1, frames):
        speed[frame] = decay * speed[frame - 1]
        starts = generator.random(members) < 0.02
        speed[frame, starts] = generator.uniform(3, 10, starts.sum())
        heading[starts] += generator.normal(0, 1, starts.sum())
        velocity[frame] = speed[frame, :, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    velocity += generator.normal(0, 0.02, velocity.shape)
    return velocity.cumsum(0)


def steady(frames=3000, members=4, seed=0):
    """Return swimmers that turn at random at a speed of about 1."""
    generator = np.random.default_rng(seed)
    angle = generator.normal(0, 0.1, (frames, members)).cumsum(0)
    speed = generator.uniform(0.5, 1.5, (frames, members, 1))
    return (speed * np.stack([np.cos(angle), np.sin(angle)], -1)).cumsum(0)


@pytest.mark.parametrize("decay", [0.5, 0.8, 0.95])
def test_starts_are_no_jumps(decay):
    """Most starts are steps of more than ten times the median."""
    position = burst_and_coast(decay=decay)
    steps = np.linalg.norm(np.diff(position, axis=0), axis=-1)
    if decay < 0.9:
        assert (steps > 10 * np.median(steps)).sum() > 200
    assert not find_jumps(position).any()
    assert not find_jumps(steady()).any()


@pytest.mark.parametrize("swim", [steady, burst_and_coast])
@pytest.mark.parametrize("kind", ["away for a frame", "away for ten", "elsewhere for good"])
def test_errors_of_tracking_are_jumps(swim, kind):
    """Errors of 60 lengths, as those of an exchange with another animal."""
    position = swim()
    expected = np.zeros((len(position) - 1, 4), dtype=bool)
    for number, frame in enumerate(range(100, 2900, 100)):
        stop = {"away for a frame": frame + 1, "away for ten": frame + 10}.get(kind)
        angle = number
        position[frame:stop, number % 4] += 60 * np.array([np.cos(angle), np.sin(angle)])
        expected[frame - 1, number % 4] = True
        if stop is not None:
            expected[stop - 1, number % 4] = True
    np.testing.assert_array_equal(find_jumps(position), expected)


def test_small_errors_of_a_resting_animal_are_jumps():
    """Beyond the top speed by little, and seen by what surrounds them alone."""
    position = burst_and_coast(decay=0.5)
    still = burst_and_coast(seed=1)[:1] + np.random.default_rng(2).normal(0, 0.01, (3000, 1, 2))
    position = np.concatenate([position, still], axis=1)
    position[500, -1] += 12.0
    position[900:, -1] += 12.0
    jumps = find_jumps(position)
    assert jumps[:, -1].nonzero()[0].tolist() == [499, 500, 899]
    assert not jumps[:, :-1].any()


def test_gaps_and_short_tracks():
    position = steady(50)
    position[20:30] = np.nan
    position[40, 0] = np.nan
    assert not find_jumps(position).any()
    assert not find_jumps(np.full((10, 3, 2), np.nan)).any()
    assert find_jumps(position[:2]).shape == (1, 4)
    assert find_jumps(np.stack([position, position])).shape == (2, 49, 4)


def test_the_summary_counts_them():
    position = burst_and_coast()
    assert summarize(make_tracks(position, fps=30))["jumps"] == 0
    position[1000:, 2] += 80.0
    assert summarize(make_tracks(position, fps=30))["jumps"] == 1


@pytest.mark.parametrize("name", ["tadpoles4_apart", "termites8_idtracker"])
def test_real_start_stop_swimmers_have_none(shared_data, name):
    assert summarize(io.read(shared_data / name / f"{name}.npz"))["jumps"] == 0
