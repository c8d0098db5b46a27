import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmssm.errors import InputError
from swarmssm.tracks import (
    Array,
    has_trials,
    make_tracks,
    num_individuals,
    observed,
    states_of,
    stepwise_velocity,
    validate_tracks,
    with_trials,
)

NAN = np.nan


def walk(*shape: int) -> Array:
    """Numbers of which no two are alike: each names its own place."""
    return np.arange(np.prod(shape), dtype=np.float64).reshape(shape) + 0.5


# --- the constructor ---------------------------------------------------------------------------


@pytest.mark.parametrize("space", [2, 3])
def test_one_recording_becomes_a_dataset_of_the_schema(space: int):
    position = walk(5, 4, space)
    tracks = make_tracks(
        position, fps=10, unit="cm", source_software="TRex", source_file="a.npz", attrs={"note": 1}
    )
    assert tracks["position"].dims == ("time", "space", "individual")
    for t, i, s in np.ndindex(5, 4, space):
        assert tracks["position"][t, s, i] == position[t, i, s]
    np.testing.assert_allclose(tracks["time"], [0, 0.1, 0.2, 0.3, 0.4], rtol=0, atol=1e-15)
    assert tracks["time"].dtype == np.float64
    assert tracks["space"].values.tolist() == list("xyz")[:space]
    assert tracks["individual"].values.tolist() == ["0", "1", "2", "3"]
    assert tracks.attrs == {
        "fps": 10.0,
        "time_unit": "seconds",
        "unit": "cm",
        "source_software": "TRex",
        "source_file": "a.npz",
        "note": 1,
    }
    assert tracks["position"].attrs == {"units": "cm"}
    assert tracks["time"].attrs == {"units": "s"}
    assert set(tracks.variables) == {"position", "time", "space", "individual"}
    assert num_individuals(tracks) == 4
    assert not has_trials(tracks)


def test_trials_velocity_adjacency_and_labels_stand_where_they_belong():
    position, velocity = walk(2, 3, 4, 2), -walk(2, 3, 4, 2)
    edges = np.random.default_rng(0).random((2, 3, 4, 4)) < 0.5
    edges[..., range(4), range(4)] = False
    tracks = make_tracks(
        position,
        fps=1,
        velocity=velocity,
        adjacency=edges,
        individuals=["a", "b", 7, b"d"],
        trials=["left", "right"],
        unit="m",
    )
    assert tracks["position"].dims == ("trial", "time", "space", "individual")
    assert tracks["velocity"].dims == ("trial", "time", "space", "individual")
    assert tracks["adjacency"].dims == ("trial", "time", "individual", "neighbor")
    assert tracks["adjacency"].dtype == np.uint8
    assert tracks["velocity"].attrs == {"units": "m/s"}
    one = tracks.sel(trial="right", individual="7").isel(time=2)
    assert one["position"].values.tolist() == position[1, 2, 2].tolist()
    assert one["velocity"].values.tolist() == velocity[1, 2, 2].tolist()
    assert one["adjacency"].values.tolist() == edges[1, 2, 2].tolist()
    assert tracks["neighbor"].values.tolist() == ["a", "b", "7", "d"]
    # Directed: i sees j stands in row i and column j.
    for i, j in np.ndindex(4, 4):
        seen = tracks["adjacency"].sel(trial="left", individual="ab7d"[i], neighbor="ab7d"[j])
        assert seen[0] == edges[0, 0, i, j]


def test_ragged_trials_are_padded_and_nothing_is_cut():
    long, short = walk(5, 2, 2), -walk(3, 4, 2)
    edges = [np.ones((5, 2, 2)) - np.eye(2), np.ones((3, 4, 4)) - np.eye(4)]
    tracks = make_tracks([long, short], fps=1, velocity=[2 * long, 2 * short], adjacency=edges)
    states = states_of(tracks)
    assert states.shape == (2, 5, 4, 4)
    np.testing.assert_array_equal(states[0, :, :2], np.concatenate([long, 2 * long], -1))
    np.testing.assert_array_equal(states[1, :3], np.concatenate([short, 2 * short], -1))
    assert np.isnan(states[0, :, 2:]).all()
    assert np.isnan(states[1, 3:]).all()
    assert tracks["trial"].values.tolist() == ["0", "1"]
    assert tracks["adjacency"].sum() == 5 * 2 + 3 * 12
    assert (tracks["adjacency"][0, :, 2:] == 0).all()
    assert (tracks["adjacency"][1, 3:] == 0).all()


def test_a_list_of_equal_trials_is_the_same_as_their_stack():
    stacked = walk(3, 4, 2, 2)
    xr.testing.assert_identical(make_tracks(list(stacked), fps=1), make_tracks(stacked, fps=1))
    xr.testing.assert_identical(make_tracks(stacked.tolist(), fps=1), make_tracks(stacked, fps=1))


@pytest.mark.parametrize(
    "kind",
    [
        lambda x: x.astype(int),
        lambda x: x.astype(np.float32),
        lambda x: x.astype(np.uint8),
        lambda x: x.tolist(),
        torch.as_tensor,
        lambda x: np.asfortranarray(x),
        lambda x: x.astype(object),
    ],
)
def test_positions_may_be_any_numbers(kind: Callable[[Array], Any]):
    position = np.arange(24.0).reshape(3, 4, 2)
    tracks = make_tracks(kind(position), fps=1)
    assert tracks["position"].dtype == np.float64
    assert tracks["position"].values.flags.c_contiguous
    np.testing.assert_array_equal(tracks["position"].transpose(..., "space"), position)


def test_what_is_masked_or_none_was_not_seen():
    position = walk(3, 2, 2)
    masked = np.ma.masked_array(position, mask=np.zeros(position.shape, bool))
    masked[1, 0] = np.ma.masked
    expected = position.copy()
    expected[1, 0] = NAN
    nones = expected.astype(object)
    nones[1, 0] = None
    for given_position in (masked, nones, nones.tolist(), [masked]):
        values = states_of(make_tracks(given_position, fps=1))[0, ..., :2]
        np.testing.assert_array_equal(values, expected)


def test_the_given_arrays_are_neither_changed_nor_shared():
    position, velocity = walk(3, 2, 2), walk(3, 2, 2)
    position[1, 0, 1] = NAN  # known in part: blank in the tracks
    force = walk(3, 2, 2)
    edges = np.zeros((3, 2, 2), np.uint8)
    kept = [a.copy() for a in (position, velocity, force, edges)]
    variables = {"force": (("time", "space", "individual"), force)}
    attrs = {"note": "mine"}
    tracks = make_tracks(
        position, fps=1, velocity=velocity, adjacency=edges, variables=variables, attrs=attrs
    )
    assert np.isnan(tracks["position"][1, :, 0]).all()
    for name in ("position", "velocity", "force", "adjacency"):
        tracks[name].values[...] = 1
    for array, copy in zip((position, velocity, force, edges), kept, strict=True):
        np.testing.assert_array_equal(array, copy)
    assert attrs == {"note": "mine"}


def test_holes_in_frames_become_rows_of_nothing():
    position, velocity = walk(3, 2, 2), -walk(3, 2, 2)
    edges = np.zeros((3, 2, 2))
    edges[:, 0, 1] = 1
    tracks = make_tracks(
        position,
        fps=2,
        frames=[10, 11, 14],
        velocity=velocity,
        adjacency=edges,
        variables={
            "light": (("time",), [0.1, 0.2, 0.3]),
            "count": (("time",), [7, 8, 9]),
            "mood": (("individual", "time"), [["a", "bb", "c"], ["d", "e", "f"]]),
            "length": (("individual",), [3.0, 4.0]),
        },
    )
    assert tracks["frame"].values.tolist() == [10, 11, 12, 13, 14]
    assert tracks["frame"].dims == ("time",)
    np.testing.assert_array_equal(tracks["time"], np.array([10, 11, 12, 13, 14]) / 2)
    states = states_of(tracks)[0]
    np.testing.assert_array_equal(states[[0, 1, 4], :, :2], position)
    np.testing.assert_array_equal(states[[0, 1, 4], :, 2:], velocity)
    assert np.isnan(states[2:4]).all()
    assert tracks["adjacency"].values[:, 0, 1].tolist() == [1, 1, 0, 0, 1]
    np.testing.assert_array_equal(tracks["light"], [0.1, 0.2, NAN, NAN, 0.3])
    assert tracks["count"].values.tolist() == [7, 8, 0, 0, 9]
    assert tracks["mood"].values.tolist() == [["a", "bb", "", "", "c"], ["d", "e", "", "", "f"]]
    assert tracks["length"].values.tolist() == [3, 4]


def test_holes_in_time_become_rows_of_nothing_in_every_trial():
    first, second = walk(3, 2, 2), -walk(2, 3, 2)
    tracks = make_tracks([first, second], time=[0.0, 0.1, 0.3])
    assert tracks.attrs["fps"] == 10.0
    assert "frame" not in tracks.coords
    np.testing.assert_allclose(tracks["time"], [0, 0.1, 0.2, 0.3], rtol=0, atol=1e-15)
    states = states_of(tracks)
    np.testing.assert_array_equal(states[0, [0, 1, 3], :2, :2], first)
    np.testing.assert_array_equal(states[1, [0, 1], :, :2], second)
    assert np.isnan(states[:, 2]).all()
    assert np.isnan(states[1, 3]).all()


def test_stamps_that_jitter_are_snapped():
    tracks = make_tracks(walk(4, 1, 2), fps=10, time=[5.0, 5.12, 5.29, 5.4])
    np.testing.assert_allclose(tracks["time"], [5, 5.1, 5.2, 5.3, 5.4], rtol=0, atol=1e-12)
    assert np.isnan(tracks["position"][2]).all()
    np.testing.assert_array_equal(tracks["position"][3, :, 0], walk(4, 1, 2)[2, 0])


def test_an_individual_known_in_part_is_not_known():
    position = walk(3, 2, 2)
    position[1, 0, 1] = NAN
    tracks = make_tracks(position, fps=1, velocity=np.where(walk(3, 2, 2) == 8.5, NAN, 1.0))
    assert np.isnan(tracks["position"].values[1, :, 0]).all()
    assert observed(tracks).values.tolist() == [[True, True], [False, True], [True, True]]
    # 8.5 is the x of individual 0 in frame 2.
    assert np.isnan(tracks["velocity"].values[2, :, 0]).all()
    assert np.isfinite(tracks["velocity"].values[2, :, 1]).all()


def test_further_variables_may_bring_their_own_dimensions():
    force = walk(2, 3, 4, 2, 5)
    tracks = make_tracks(
        np.zeros((2, 3, 5, 2)),
        fps=1,
        variables={
            "force": (("trial", "time", "term", "space", "individual"), force),
            "term": (("term",), ["cohesion", "separation", "alignment", "wall"]),
            "seen": (("individual", "neighbor"), np.eye(5)),
        },
    )
    assert tracks["force"].dims == ("trial", "time", "term", "space", "individual")
    np.testing.assert_array_equal(tracks["force"].sel(term="wall"), force[:, :, 3])
    assert tracks["neighbor"].values.tolist() == list("01234")


def test_attributes_given_apart_are_not_lost():
    tracks = make_tracks(walk(2, 1, 2), fps=1, attrs={"unit": "mm", "source_file": "b.csv"})
    assert tracks.attrs["unit"] == "mm"
    assert tracks.attrs["source_file"] == "b.csv"
    assert tracks["position"].attrs["units"] == "mm"
    told_twice = make_tracks(walk(2, 1, 2), fps=1, unit="cm", attrs={"unit": "mm", "fps": 3})
    assert told_twice.attrs["unit"] == "cm"
    assert told_twice.attrs["fps"] == 1.0


GOOD = np.zeros((3, 2, 2))
REFUSALS: list[tuple[dict[str, Any], str]] = [
    (
        {"position": np.zeros((3, 2))},
        "position: its shape must be (time, individual, space) or (trial, time, individual, "
        "space) with 2 or 3 coordinates, and it is (3, 2).",
    ),
    ({"position": np.zeros((3, 2, 4))}, "position: its shape must be"),
    ({"position": np.zeros((3, 2, 1))}, "position: its shape must be"),
    ({"position": np.zeros((1, 1, 3, 2, 2))}, "position: its shape must be"),
    ({"position": None}, "position: its shape must be"),
    ({"position": []}, "position: its shape must be"),
    (
        {"position": "abc"},
        "position: it must be an array of numbers, or a list of one such array a trial.",
    ),
    ({"position": GOOD.astype(complex)}, "position: it must be an array of numbers"),
    ({"position": [[[1, 2], [3]], [[1, 2], [3, 4]]]}, "position: it must be an array of numbers"),
    ({"position": [GOOD, "x"]}, "position: it must be an array of numbers"),
    (
        {"position": [GOOD, np.zeros((3, 2))]},
        "position: the arrays of a list must have three dimensions each, and their shapes are "
        "(3, 2, 2), (3, 2).",
    ),
    (
        {"position": [GOOD, np.zeros((3, 2, 3))]},
        "position: trial 1 has 3 coordinates, and trial 0 has 2. Give all trials the same.",
    ),
    ({"position": np.zeros((1, 2, 2))}, "tracks: it has 1 frame; motion needs at least 2."),
    ({"position": np.zeros((0, 2, 2))}, "tracks: it has no frame; motion needs at least 2."),
    ({"position": np.zeros((3, 0, 2))}, "tracks: it has no individual."),
    ({"position": np.zeros((0, 3, 2, 2))}, "tracks: it has no trial."),
    (
        {"position": np.full((3, 2, 2), NAN)},
        "tracks: no individual has a position in any frame.",
    ),
    (
        {"position": np.where(walk(3, 2, 2) == 10.5, np.inf, 0), "individuals": ["a", "b"]},
        "tracks: position of individual b in time row 2 is inf; use NaN for what was not seen.",
    ),
    (
        {"position": np.where(walk(2, 3, 2, 2) == 12.5, -np.inf, 0), "trials": ["u", "v"]},
        "tracks: position of individual 0 in trial v in time row 0 is -inf; use NaN for what was "
        "not seen.",
    ),
    ({"position": GOOD - 2e12}, "tracks: position of individual 0 in time row 0 is -2e+12; use"),
    (
        {"velocity": np.where(walk(3, 2, 2) == 4.5, np.inf, 0)},
        "tracks: velocity of individual 0 in time row 1 is inf; use NaN for what was not seen.",
    ),
    ({"fps": None}, "fps: frames per second are not known; give fps."),
    ({"time": [0, 1, 1]}, "time: row 2 (1) repeats the row before it (1); it must increase."),
    ({"frames": [0, 1]}, "frames: 2 are given for 3 rows of position."),
    ({"individuals": ["a"]}, "individuals: 1 labels are given for 2 individuals."),
    ({"individuals": ["a", "a"]}, "tracks: the individual a stands there more than once."),
    ({"individuals": [1, "1"]}, "tracks: the individual 1 stands there more than once."),
    (
        {"trials": ["a"]},
        "trials: labels are given, and position has no trial dimension. Leave them out, or give "
        "position the shape (trial, time, individual, space).",
    ),
    ({"position": [GOOD, GOOD], "trials": ["a"]}, "trials: 1 labels are given for 2 trials."),
    (
        {"position": [GOOD, GOOD], "trials": ["a", "a"]},
        "tracks: the trial a stands there more than once.",
    ),
    (
        {"velocity": np.zeros((3, 2, 3))},
        "velocity: its shape is (3, 2, 3), and for this position it must be (3, 2, 2).",
    ),
    ({"velocity": "fast"}, "velocity: it must be an array of numbers"),
    (
        {
            "position": [np.zeros((3, 2, 2)), np.zeros((2, 2, 2))],
            "velocity": [np.zeros((2, 2, 2)), np.zeros((3, 2, 2))],
        },
        "velocity: its shape in trial 0 is (2, 2, 2), and for this position it must be (3, 2, 2).",
    ),
    (
        {
            "position": [np.zeros((3, 2, 2)), np.zeros((2, 1, 2))],
            "adjacency": [np.zeros((3, 2, 2)), np.zeros((2, 2, 2))],
        },
        "adjacency: its shape in trial 1 is (2, 2, 2), and for this position it must be (2, 1, 1).",
    ),
    (
        {"adjacency": np.zeros((3, 2, 3))},
        "adjacency: its shape is (3, 2, 3), and for this position it must be (3, 2, 2).",
    ),
    (
        {"adjacency": np.where(walk(3, 2, 2) == 9.5, 0.5, 0), "individuals": ["a", "b"]},
        "tracks: adjacency of individual a to neighbor b in time row 2 is 0.5; it must be 0 or 1.",
    ),
    ({"adjacency": np.where(walk(3, 2, 2) == 9.5, NAN, 0)}, "is nan; it must be 0 or 1."),
    ({"adjacency": np.where(walk(3, 2, 2) == 9.5, -1, 0)}, "is -1; it must be 0 or 1."),
    ({"adjacency": np.where(walk(3, 2, 2) == 9.5, 256, 0)}, "is 256; it must be 0 or 1."),
    (
        {"adjacency": np.broadcast_to(np.diag([0, 1]), (3, 2, 2))},
        "tracks: adjacency of individual 1 in time row 0 says that the individual sees itself; "
        "set it to 0.",
    ),
    (
        {"variables": {"velocity": (("time",), [1, 2, 3])}},
        "variables: the name velocity is taken. Choose another.",
    ),
    ({"variables": {"time": (("time",), [1, 2, 3])}}, "variables: the name time is taken."),
    (
        {"variables": {"light": (("time",), [1, 2])}},
        "variables: light has 2 along time, where 3 are needed.",
    ),
    (
        {"variables": {"a": (("k",), [1, 2]), "b": (("k",), [1, 2, 3])}},
        "variables: b has 3 along k, where 2 are needed.",
    ),
    (
        {"variables": {"light": (("time", "space"), [1, 2, 3])}},
        "variables: light has the dimensions ('time', 'space') and an array of shape (3,); name "
        "each axis once.",
    ),
    ({"variables": {"a": (("k", "k"), np.eye(2))}}, "variables: a has the dimensions ('k', 'k')"),
    ({"variables": {"a": (("k", "m"), [[1], [1, 2]])}}, "variables: a must be an array."),
    (
        {"variables": {"a": (("trial",), [1])}},
        "variables: a has the dimension trial, and position has none.",
    ),
]


@pytest.mark.parametrize(("arguments", "sentence"), REFUSALS)
def test_each_refusal_names_the_argument_and_the_place(arguments: dict[str, Any], sentence: str):
    call: dict[str, Any] = {"position": GOOD, "fps": 1.0, **arguments}
    with pytest.raises(InputError) as caught:
        make_tracks(**call)
    told = str(caught.value)
    assert sentence in told
    assert "\n" not in told
    assert told.endswith(".")
    assert told.count(". ") <= 1


# --- states and velocities ---------------------------------------------------------------------


def test_velocity_is_the_backward_difference_worked_by_hand():
    position = np.array([[0.0, 0.0], [1.0, 2.0], [1.5, 1.0], [3.0, 1.0]])[:, None]
    velocity = stepwise_velocity(position, 10.0)
    np.testing.assert_array_equal(
        velocity[:, 0], [[NAN, NAN], [10.0, 20.0], [5.0, -10.0], [15.0, 0.0]]
    )


def test_velocity_never_crosses_a_gap_nor_a_trial():
    position = np.zeros((2, 6, 1, 2))
    position[0, :, 0, 0] = [0, 1, NAN, 9, 11, 14]
    position[1, :, 0, 0] = 1000 + np.arange(6)
    states = states_of(make_tracks(position, fps=1))
    np.testing.assert_array_equal(states[0, :, 0, 2], [NAN, 1, NAN, NAN, 2, 3])
    np.testing.assert_array_equal(states[1, :, 0, 2], [NAN, 1, 1, 1, 1, 1])
    np.testing.assert_array_equal(np.isnan(states[..., 2]), np.isnan(states[..., 3]))


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(2, 3), st.integers(1, 3))
def test_velocity_is_known_exactly_where_two_frames_in_a_row_are(
    seed: int, space: int, trials: int
):
    generator = np.random.default_rng(seed)
    position = generator.normal(size=(trials, 8, 3, space))
    seen = generator.random((trials, 8, 3)) < 0.7
    seen[0, 0, 0] = True
    position[~seen] = NAN
    states = states_of(make_tracks(position, fps=25))
    assert states.shape == (trials, 8, 3, 2 * space)
    np.testing.assert_array_equal(states[..., :space], position)
    for b, t, i in np.ndindex(seen.shape):
        known = t > 0 and seen[b, t, i] and seen[b, t - 1, i]
        expected = (position[b, t, i] - position[b, t - 1, i]) * 25 if known else [NAN] * space
        np.testing.assert_allclose(states[b, t, i, space:], expected, rtol=1e-15)


@pytest.mark.parametrize("space", [2, 3])
def test_states_are_ordered_places_then_velocities(space: int):
    position = walk(2, 3, 4, space)
    states = states_of(make_tracks(position, fps=1, velocity=-position))
    np.testing.assert_array_equal(states, np.concatenate([position, -position], -1))
    assert states.flags.c_contiguous
    assert states.flags.writeable
    one = states_of(make_tracks(position[0], fps=1, velocity=-position[0]))
    np.testing.assert_array_equal(one, states[:1])


def test_states_do_not_share_memory_with_the_tracks():
    tracks = make_tracks(walk(3, 2, 2), fps=1, velocity=walk(3, 2, 2))
    before = tracks.copy(deep=True)
    states_of(tracks)[...] = 0
    xr.testing.assert_identical(tracks, before)


# --- trials ------------------------------------------------------------------------------------


def test_one_recording_gets_one_trial_and_keeps_all_else():
    tracks = make_tracks(
        walk(3, 2, 2),
        fps=2,
        frames=[5, 6, 7],
        adjacency=np.zeros((3, 2, 2)),
        attrs={"note": "mine"},
        variables={
            "length": (("individual",), [3.0, 4.0]),
            "room": ((), 21.5),
            "light": (("time",), [0, 1, 0]),
        },
    ).assign_coords(sex=("individual", ["f", "m"]), phase=("time", [1.0, 2.0, 3.0]))
    several = with_trials(tracks)
    assert has_trials(several)
    assert several["trial"].values.tolist() == ["0"]
    assert several["position"].dims == ("trial", "time", "space", "individual")
    assert several["adjacency"].dims == ("trial", "time", "individual", "neighbor")
    assert several["light"].dims == ("trial", "time")
    assert several["length"].dims == ("individual",)
    assert several["room"].dims == ()
    assert several["frame"].dims == ("time",)
    assert several["sex"].dims == ("individual",)
    assert several.attrs == tracks.attrs
    assert several["position"].attrs == tracks["position"].attrs
    assert not has_trials(tracks)
    xr.testing.assert_identical(several.isel(trial=0, drop=True), tracks)
    assert with_trials(several) is several


def test_a_trial_that_was_picked_out_keeps_its_label():
    tracks = make_tracks(walk(2, 3, 2, 2), fps=1, trials=["left", "right"])
    picked = tracks.isel(trial=1)
    assert with_trials(picked)["trial"].values.tolist() == ["right"]
    xr.testing.assert_equal(with_trials(picked), tracks.isel(trial=[1]))
    np.testing.assert_array_equal(states_of(picked), states_of(tracks)[1:])
    xr.testing.assert_identical(validate_tracks(picked), picked)


# --- size --------------------------------------------------------------------------------------


def test_large_tracks_are_made_and_checked_in_little_memory():
    position = np.random.default_rng(0).normal(size=(3000, 200, 2))
    kept = np.delete(np.arange(3001), 1500)

    def peak(work: Callable[[], object]) -> float:
        """Return the most memory that was held beside the input, as a multiple of it."""
        tracemalloc.start()
        try:
            work()
            return tracemalloc.get_traced_memory()[1] / position.nbytes
        finally:
            tracemalloc.stop()

    tracks = make_tracks(position, fps=30)
    # The result itself is 1 (2 for states), holes and differences need 1 more, and the mask of what
    # is known 1/8.
    assert peak(lambda: make_tracks(position, fps=30)) < 1.5
    assert peak(lambda: make_tracks(position, fps=30, frames=kept)) < 2.5
    assert peak(lambda: validate_tracks(tracks)) < 1.5
    assert peak(lambda: states_of(tracks)) < 3.2


def test_netcdf_gives_the_same_tracks_again(tmp_path: Path):
    tracks = make_tracks(
        [walk(4, 3, 2), walk(2, 2, 2)],
        fps=29.97,
        adjacency=[np.zeros((4, 3, 3)), np.ones((2, 2, 2)) - np.eye(2)],
        unit="cm",
        trials=["a", "b"],
        source_software="TRex",
    )
    tracks.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as opened:
        again = validate_tracks(opened.load())
    xr.testing.assert_identical(again, tracks)
    assert type(again.attrs["fps"]) is float
    assert again["adjacency"].dtype == np.uint8
    assert all(not variable.encoding for variable in again.variables.values())
