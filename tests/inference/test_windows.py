"""Tracks become tensors and windows without losing a step or inventing one."""

from collections import Counter

import numpy as np
import pytest
import torch
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule, add_adjacency
from swarmssm.inference.data import Prepared, frames_of, preparation_for, prepare, windows_of
from swarmssm.tracks import make_tracks
from swarmssm.tracks.scaling import Scaler

SETTINGS = {"scaler": "minmax", "graph": "auto", "velocity": "auto"}


def numbered(mask):
    """Return prepared tracks whose every observed state says where it stands."""
    individuals = mask.shape[-1]
    places = torch.arange(mask.numel(), dtype=torch.float64).reshape(mask.shape) + 1
    observations = (places * mask).unsqueeze(-1).expand(*mask.shape, 4).to(torch.float32)
    # An edge says where it stands too, by a pattern of places modulo 2.
    adjacency = (places.unsqueeze(-1) + torch.arange(individuals)) % 2 == 0
    adjacency &= mask.unsqueeze(-1) & mask.unsqueeze(-2)
    return Prepared(xr.Dataset(), np.empty(0), mask, observations, mask, adjacency)


def steps_of(mask):
    """Return all steps ``(trial, time, individual)`` observed at both ends."""
    return {tuple(s) for s in (mask[:, 1:] & mask[:, :-1]).nonzero().tolist()}


@st.composite
def masks(draw):
    """Return who is observed, ``(trial, time, individual)``, in trials of unequal length."""
    trials, times = draw(st.integers(1, 3)), draw(st.integers(2, 13))
    individuals = draw(st.integers(1, 3))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 10**6)))
    share = draw(st.sampled_from([0.3, 0.8, 1.0]))
    mask = torch.rand(trials, times, individuals, generator=generator) < share
    for trial in range(trials):
        mask[trial, times - trial :] = False
    return mask


@given(mask=masks(), window=st.none() | st.integers(2, 16))
def test_windows_hold_each_step_once(mask, window):
    _, times, individuals = mask.shape
    prepared = numbered(mask)
    wanted = steps_of(mask)
    if not wanted:
        with pytest.raises(InputError, match="no step to learn"):
            windows_of(prepared, window)
        return
    batch = windows_of(prepared, window)
    assert batch.num_times == min(window or times, times)
    assert (batch.window_weight == 1).all()
    assert batch.population == len(batch)
    assert batch.observations.isfinite().all()
    found = Counter()
    for observations, seen, adjacency in zip(
        batch.observations, batch.mask, batch.adjacency, strict=True
    ):
        assert (seen[1:] & seen[:-1]).any()
        # Where nobody is seen, padding included, nothing stands.
        assert (observations[~seen] == 0).all()
        assert (adjacency[~(seen.unsqueeze(-1) & seen.unsqueeze(-2))] == 0).all()
        for t, i in (seen[1:] & seen[:-1]).nonzero().tolist():
            place = int(observations[t, i, 0]) - 1
            trial, time, individual = np.unravel_index(place, mask.shape)
            assert individual == i
            assert int(observations[t + 1, i, 0]) - 1 == place + individuals
            found[int(trial), int(time), i] += 1
            assert torch.equal(adjacency[t].bool(), prepared.adjacency[trial, time])
            assert torch.equal(adjacency[t + 1].bool(), prepared.adjacency[trial, time + 1])
    assert found == Counter(wanted)


@given(mask=masks(), window=st.none() | st.integers(2, 16))
def test_windows_that_share_no_border_hold_each_frame_once(mask, window):
    """Left out are only the windows in which nobody is seen twice: they tell of no motion."""
    trials, times, _ = mask.shape
    length = min(window or times, times)
    prepared = numbered(mask)
    wanted = Counter()
    windows = 0
    for trial in range(trials):
        for start in range(0, times, length):
            part = mask[trial, start : start + length]
            if int(part.sum(0).max()) > 1:
                windows += 1
                rows = [(trial, start + t, i) for t, i in part.nonzero().tolist()]
                wanted.update(rows)
    if not wanted:
        with pytest.raises(InputError, match="tracks: nobody is seen in two frames"):
            windows_of(prepared, window, share_border=False)
        return
    batch = windows_of(prepared, window, share_border=False)
    assert (len(batch), batch.num_times, batch.population) == (windows, length, windows)
    assert (batch.window_weight == 1).all()
    found = Counter()
    for observations, seen, adjacency in zip(
        batch.observations, batch.mask, batch.adjacency, strict=True
    ):
        assert (observations[~seen] == 0).all()
        assert (adjacency[~(seen.unsqueeze(-1) & seen.unsqueeze(-2))] == 0).all()
        places = set()
        for t, i in seen.nonzero().tolist():
            place = np.unravel_index(int(observations[t, i, 0]) - 1, mask.shape)
            trial, time, individual = map(int, place)
            assert individual == i
            places.add((trial, time - t))
            found[trial, time, i] += 1
            assert torch.equal(adjacency[t].bool(), prepared.adjacency[trial, time])
        # All frames of a window follow on each other, and it starts where none before it ends.
        ((_, start),) = places
        assert start % length == 0
    assert found == wanted
    # From its first sighting in a window to the last, an individual is there.
    assert (batch.present >= batch.mask).all()
    assert torch.equal(batch.present.any(1), batch.mask.any(1))


def test_windows_that_share_no_border_by_hand():
    """Eight frames in windows of three: 0-2, 3-5 and 6-7, the last padded by one."""
    mask = torch.ones(1, 8, 1, dtype=torch.bool)
    batch = windows_of(numbered(mask), 3, share_border=False)
    assert batch.observations[..., 0, 0].tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 0]]
    assert batch.present[..., 0].tolist() == [[True] * 3, [True] * 3, [True, True, False]]
    # One frame that is left over is a sighting of nothing that moves.
    assert len(windows_of(numbered(mask[:, :7]), 3, share_border=False)) == 2
    # Seen in the first frame and the last: two sightings of a motion, though no step.
    mask[0, 1] = False
    batch = windows_of(numbered(mask[:, :3]), 3, share_border=False)
    assert batch.mask[..., 0].tolist() == [[True, False, True]]
    assert batch.present[..., 0].tolist() == [[True, True, True]]
    with pytest.raises(InputError, match="in two consecutive frames"):
        windows_of(numbered(mask[:, :3]), 3)


@given(mask=masks(), start=st.integers(-6, 16), length=st.integers(1, 9), data=st.data())
def test_any_frames_can_be_taken(mask, start, length, data):
    """What lies before the first frame or after the last is a frame without anybody."""
    trials, times, _ = mask.shape
    prepared = numbered(mask)
    chosen = data.draw(st.lists(st.integers(0, trials - 1), min_size=1, max_size=4))
    starts = [start + k for k in range(len(chosen))]
    batch = frames_of(prepared, torch.tensor(chosen), torch.tensor(starts), length)
    assert (len(batch), batch.num_times, batch.population) == (len(chosen), length, len(chosen))
    assert batch.observations.isfinite().all()
    for window, (trial, first) in enumerate(zip(chosen, starts, strict=True)):
        for t in range(length):
            row = first + t
            parts = (batch.observations, batch.mask, batch.adjacency)
            frame = [part[window, t] for part in parts]
            if 0 <= row < times:
                wholes = (prepared.observations, prepared.mask, prepared.adjacency)
                for part, whole in zip(frame, wholes, strict=True):
                    assert torch.equal(part, whole[trial, row].to(part.dtype))
            else:
                assert all(int(part.sum()) == 0 for part in frame)


def test_frames_before_the_first_and_after_the_last():
    prepared = numbered(torch.ones(2, 4, 1, dtype=torch.bool))
    rows = torch.tensor([0, 1, 0, 1]), torch.tensor([-2, 2, -5, 9])
    batch = frames_of(prepared, *rows, 3)
    found = batch.observations[..., 0, 0].tolist()
    assert found == [[0, 0, 1], [7, 8, 0], [0, 0, 0], [0, 0, 0]]
    assert torch.equal(batch.mask[..., 0], batch.observations[..., 0, 0] > 0)
    assert batch.adjacency.dtype == torch.float32


def test_windows_share_their_border_frames():
    """Eight frames in windows of four: frames 0-3, 3-6 and 6-7, the last padded by two."""
    batch = windows_of(numbered(torch.ones(1, 8, 2, dtype=torch.bool)), 4)
    first = batch.observations[:, :, 0, 0]
    assert first.tolist() == [[1, 3, 5, 7], [7, 9, 11, 13], [13, 15, 0, 0]]
    assert batch.mask[:, :, 0].tolist() == [[True] * 4, [True] * 4, [True, True, False, False]]
    assert batch.adjacency.dtype == torch.float32
    # Seven frames fill two windows of four; there is no third of a single frame.
    assert len(windows_of(numbered(torch.ones(1, 7, 2, dtype=torch.bool)), 4)) == 2
    # A window longer than the recording is the recording.
    whole = windows_of(numbered(torch.ones(2, 8, 2, dtype=torch.bool)), 99)
    assert (len(whole), whole.num_times) == (2, 8)


def test_windows_without_a_step_are_left_out():
    mask = torch.ones(1, 9, 1, dtype=torch.bool)
    mask[0, 2:6] = False
    mask[0, 4] = True  # alone between two gaps
    batch = windows_of(numbered(mask), 3)
    assert batch.observations[:, 0, 0, 0].tolist() == [1, 7]
    assert batch.population == 2


@pytest.mark.parametrize("window", [1, 0, -5])
def test_a_window_without_a_step_is_refused(window):
    with pytest.raises(
        InputError, match=f"window: it must be at least 2 frames, and it is {window}"
    ):
        windows_of(numbered(torch.ones(1, 8, 2, dtype=torch.bool)), window)


def test_prepared_by_hand():
    """Two individuals, 1 frame per second; the second is out of sight in frame 2."""
    nan = np.nan
    one = [[0.0, 0.0], [1.0, 2.0], [3.0, 2.0], [4.0, 6.0], [6.0, 6.0]]
    two = [[9.0, 1.0], [8.0, 1.0], [nan, nan], [6.0, 3.0], [5.0, 5.0]]
    tracks = make_tracks(np.stack([one, two], axis=1), fps=1.0)
    scaler = Scaler("minmax", (0.0, 0.0, -1.0, 0.0), (10.0, 5.0, 4.0, 4.0))
    preparation, _ = preparation_for(tracks, **SETTINGS | {"graph": "complete"})
    assert preparation.rule == GraphRule("complete")
    prepared = prepare(tracks, type(preparation)(scaler, "auto", preparation.rule, False))
    # Known are frames with position and backward difference.
    known = [[False, False], [True, True], [True, False], [True, False], [True, True]]
    assert prepared.mask.tolist() == [known]
    expected = [
        [[0, 0, 0, 0], [0, 0, 0, 0]],
        [[0.1, 0.4, 0.5, 0.5], [0.8, 0.2, 0.0, 0.0]],
        [[0.3, 0.4, 0.75, 0.0], [0, 0, 0, 0]],
        [[0.4, 1.2, 0.5, 1.0], [0, 0, 0, 0]],
        [[0.6, 1.2, 0.75, 0.0], [0.5, 1.0, 0.0, 0.5]],
    ]
    torch.testing.assert_close(prepared.observations, torch.tensor([expected]))
    # The graph is complete among those who are known.
    together = [False, True, False, False, True]
    pair = [[[False, both], [both, False]] for both in together]
    assert prepared.adjacency.tolist() == [pair]
    batch = prepared.batch()
    assert (len(batch), batch.num_times, batch.population) == (1, 5, 1)


def test_scaler_and_rule_come_from_the_given_part_alone(with_gaps):
    part, rest = with_gaps.isel(time=slice(0, 30)), with_gaps.isel(time=slice(30, None))
    preparation, training = preparation_for(part, **SETTINGS)
    assert "velocity" in training
    far = rest.assign(position=rest["position"] * 1000)
    whole = xr.concat([part, far], "time").assign_attrs(part.attrs)
    again, _ = preparation_for(whole.isel(time=slice(0, 30)), **SETTINGS)
    assert again == preparation
    states = prepare(part, preparation).observations[prepare(part, preparation).mask]
    torch.testing.assert_close(states.amin(0), torch.zeros(4), atol=1e-6, rtol=0)
    torch.testing.assert_close(states.amax(0), torch.ones(4), atol=1e-6, rtol=0)


def test_which_graph_is_taken(swarm):
    """The tracks' own where it is wanted and there, else that of the rule."""
    own, _ = preparation_for(swarm, **SETTINGS)
    assert own.own_graph
    assert own.rule == GraphRule("radius", radius=2.5)
    truth = torch.from_numpy(swarm["adjacency"].to_numpy() != 0)
    assert torch.equal(prepare(swarm, own).adjacency, truth)
    bare = swarm.drop_vars(["adjacency", "neighbor"])
    assert torch.equal(prepare(bare, own).adjacency, truth)
    # A rule that is named takes the place of what the tracks carry.
    named, _ = preparation_for(swarm, **SETTINGS | {"graph": "k-nearest:1"})
    assert not named.own_graph
    nearest = add_adjacency(swarm, GraphRule("k-nearest", k=1), overwrite=True)["adjacency"]
    assert not torch.equal(prepare(swarm, named).adjacency, truth)
    assert torch.equal(prepare(swarm, named).adjacency, torch.from_numpy(nearest.to_numpy() != 0))
    with pytest.raises(InputError, match=r"graph: the tracks carry no adjacency\. Name a rule"):
        preparation_for(bare, **SETTINGS | {"graph": "data"})
    given = swarm.assign(adjacency=swarm["adjacency"].drop_attrs())
    unknown, _ = preparation_for(given, **SETTINGS | {"graph": "data"})
    assert unknown.rule is None
    with pytest.raises(InputError, match="they carry no adjacency, and the model was fitted on"):
        prepare(bare, unknown)


def test_velocities_are_made_as_asked_for(swarm):
    """Boids carry the velocity with which they go on, differences are of the step before."""
    kept = prepare(swarm, preparation_for(swarm, **SETTINGS)[0])
    made = prepare(swarm, preparation_for(swarm, **SETTINGS | {"velocity": "difference"})[0])
    order = ("trial", "time", "individual", "space")
    own = swarm["velocity"].transpose(*order).to_numpy()
    np.testing.assert_array_equal(kept.states[..., 2:], own)
    position = swarm["position"].transpose(*order).to_numpy()
    steps = np.diff(position, axis=1) * swarm.attrs["fps"]
    np.testing.assert_allclose(made.states[:, 1:, :, 2:], steps, rtol=1e-12)
    assert kept.mask.all()
    assert not made.mask[:, 0].any()
    assert made.mask[:, 1:].all()


@pytest.mark.parametrize("method", ["auto", "difference"])
def test_nothing_known_before_t_depends_on_what_comes_after(with_gaps, method):
    """States and graph of the first frames are those of a recording that ends there."""
    for graph in ("visual", "k-nearest:2", "radius:2"):
        preparation, _ = preparation_for(
            with_gaps, **SETTINGS | {"velocity": method, "graph": graph}
        )
        whole = prepare(with_gaps, preparation)
        cut = prepare(with_gaps.isel(time=slice(0, 40)), preparation)
        assert torch.equal(cut.mask, whole.mask[:, :40])
        assert torch.equal(cut.observations, whole.observations[:, :40])
        assert torch.equal(cut.adjacency, whole.adjacency[:, :40])


def test_tracks_that_do_not_fit_are_refused(swarm):
    preparation, _ = preparation_for(swarm, **SETTINGS)
    deep = make_tracks(np.random.default_rng(0).random((5, 2, 3)), fps=1.0)
    with pytest.raises(InputError, match="they have 3 coordinates, and the model was fitted on 2"):
        prepare(deep, preparation)
    with pytest.raises(InputError, match="no variable called position"):
        prepare(xr.Dataset(), preparation)
    # What movement writes is taken as it is.
    plural = swarm.rename(individual="individuals").transpose("individuals", ...)
    theirs = prepare(plural, preparation)
    torch.testing.assert_close(theirs.observations, prepare(swarm, preparation).observations)
