"""Typical sizes of tracks, by hand and on made-up noise."""

import json
import math

import numpy as np
import pytest

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.models import Scales, scales_of
from swarmssm.tracks import make_tracks

FPS = 10.0


def test_sizes_by_hand():
    # Three on a line at 0, 1 and 4 for three frames; the second has jumped by (0, 0.1).
    position = np.zeros((3, 3, 2))
    position[:, 1, 0], position[:, 2, 0] = 1.0, 4.0
    position[1:, 1, 1] = 0.1
    scales = scales_of(make_tracks(position, fps=FPS))
    assert (scales.space, scales.individuals, scales.state_dim) == (2, 3, 4)
    assert scales.dt == pytest.approx(0.1)
    assert scales.centre == pytest.approx((5 / 3, 0.2 / 9))
    assert scales.low == (0.0, 0.0)
    assert scales.high == (4.0, 0.1)
    # Deviations on x are -5/3, -2/3, 7/3: squares sum to 78/9 a frame; on y 0.02 - (0.2)^2 / 9.
    squares = 3 * 78 / 9 + 0.02 - 0.04 / 9
    assert scales.length == pytest.approx(math.sqrt(squares / 18))
    # Velocities by backward difference: one of the six known has speed 1.
    assert scales.speed == pytest.approx(math.sqrt(1 / 6))
    assert scales.slow == 0.0
    assert scales.fast == pytest.approx(0.9)
    # The velocity of the second changes from (0, 1) to 0: 1 of 6 coordinates.
    assert scales.step == pytest.approx(math.sqrt(1 / 6))
    nearest = [1.0, 1.0, 3.0, *[math.hypot(1, 0.1)] * 4, *[math.hypot(3, 0.1)] * 2]
    assert scales.spacing == pytest.approx(np.median(nearest))


def test_trials_and_gaps_count_what_is_there():
    generator = np.random.default_rng(0)
    walk = generator.normal(size=(2, 50, 4, 2)).cumsum(1)
    walk[0, 10:20, 1] = np.nan
    walk[1, :, 3] = np.nan
    scales = scales_of(make_tracks(walk, fps=FPS))
    known = walk[np.isfinite(walk).all(-1)]
    assert scales.centre == pytest.approx(known.mean(0))
    assert scales.length == pytest.approx(np.sqrt(((known - known.mean(0)) ** 2).mean()))
    steps = np.diff(walk, axis=1) * FPS
    speed = np.sqrt((steps**2).sum(-1))
    assert scales.speed == pytest.approx(np.sqrt(np.nanmean(speed**2)))
    assert (scales.slow, scales.fast) == pytest.approx(tuple(np.nanpercentile(speed, [2, 98])))
    assert scales.step == pytest.approx(np.sqrt(np.nanmean(np.diff(steps, axis=1) ** 2)))


def test_tracking_noise_is_told_from_motion():
    generator = np.random.default_rng(0)
    steps = 2000
    velocity = 1.0 + 0.01 * generator.normal(size=(steps, 5, 2)).cumsum(0)
    clean = velocity.cumsum(0) / FPS
    noisy = clean + 0.05 * generator.normal(size=clean.shape)
    found = scales_of(make_tracks(noisy, fps=FPS)).noise
    # 20000 second differences, correlated over two frames: within about 6 / sqrt(2 * 20000 / 6).
    assert abs(found / 0.05 - 1) < 0.075
    straight = np.arange(30.0)[:, None, None] * np.ones((1, 2, 2))
    assert scales_of(make_tracks(straight, fps=FPS)).noise == 0.0


@pytest.mark.parametrize("space", [2, 3])
def test_one_individual_has_a_spacing(space):
    position = np.random.default_rng(0).normal(size=(20, 1, space))
    scales = scales_of(make_tracks(position, fps=FPS))
    assert scales.spacing == scales.length > 0
    assert len(scales.centre) == space


def test_two_frames_are_enough_and_one_is_not():
    position = np.random.default_rng(0).normal(size=(2, 3, 2))
    scales = scales_of(make_tracks(position, fps=FPS))
    assert scales.step == 0.0
    assert all(math.isfinite(v) for v in scales.to_dict().values() if isinstance(v, float))
    every_other = np.random.default_rng(0).normal(size=(9, 3, 2))
    every_other[1::2] = np.nan
    with pytest.raises(InputError, match="no individual is seen in two consecutive frames"):
        scales_of(make_tracks(every_other, fps=FPS))
    with pytest.raises(InputError, match="it has 1 frame; motion needs at least 2"):
        scales_of(make_tracks(position[:1], fps=FPS))


def test_they_go_through_json():
    position = np.random.default_rng(0).normal(size=(20, 3, 2))
    scales = scales_of(make_tracks(position, fps=FPS))
    assert Scales.from_dict(json.loads(json.dumps(scales.to_dict()))) == scales


def test_the_farthest_neighbours_are_those_of_the_graph():
    """Three on a line at 0, 1 and 3: by all pairs, by a rule, by the adjacency that they carry."""
    position = np.zeros((4, 3, 2))
    position[..., 0] = [0.0, 1.0, 3.0]
    position += 0.1 * np.arange(4)[:, None, None]
    tracks = make_tracks(position, fps=FPS)
    # The 98th percentile of [1, 2, 3] and of [1, 2], each distance twice a frame, interpolated.
    assert scales_of(tracks).apart == pytest.approx(3.0)
    within = scales_of(tracks, GraphRule("radius", radius=2.5)).apart
    assert within == pytest.approx(2.0)
    own = np.zeros((4, 3, 3))
    own[:, 0, 1] = 1
    assert scales_of(make_tracks(position, fps=FPS, adjacency=own)).apart == pytest.approx(1.0)
    alone = scales_of(tracks, GraphRule("radius", radius=0.5))
    assert alone.apart == pytest.approx(2.0 * alone.length)
