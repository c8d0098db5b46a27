import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from swarmssm.errors import InputError
from swarmssm.tracks import Array, make_tracks, states_of, validate_tracks
from swarmssm.tracks.kinematics import add_velocity
from swarmssm.tracks.scaling import fit_scaler
from swarmssm.tracks.splits import PARTS, Segment, Split, split, take

NAN = np.nan


def numbered(*lengths: int, members: int = 3, fps: float = 10.0, **more: Any) -> xr.Dataset:
    """Trials of the given lengths; x is the frame and y is 1000 times the trial plus the member."""
    trials = []
    for b, length in enumerate(lengths):
        x = np.broadcast_to(np.arange(length, dtype=np.float64)[:, None], (length, members))
        y = np.broadcast_to(1000.0 * b + np.arange(members), (length, members))
        trials.append(np.stack([x, y], -1))
    return make_tracks(trials if len(trials) > 1 else trials[0], fps=fps, **more)


def frames_of(divided: Split) -> Iterator[tuple[str, str, int]]:
    for part in PARTS:
        for segment in divided.part(part):
            for frame in range(segment.start, segment.stop):
                yield part, segment.trial, frame


# --- where the cuts lie ------------------------------------------------------------------------


def test_blocks_of_time_worked_by_hand():
    divided = split(numbered(100))
    assert divided.train == (Segment("0", 0, 70),)
    assert divided.validation == (Segment("0", 70, 85),)
    assert divided.test == (Segment("0", 85, 100),)
    apart = split(numbered(100), "time", (0.5, 0.25, 0.25), gap=5)
    assert apart.train == (Segment("0", 0, 50),)
    assert apart.validation == (Segment("0", 55, 75),)
    assert apart.test == (Segment("0", 80, 100),)
    no_validation = split(numbered(100), "time", (0.8, 0.0, 0.2), gap=3)
    assert no_validation.validation == ()
    assert no_validation.test == (Segment("0", 83, 100),)
    assert split(numbered(100), fractions=(1, 0, 0)) == Split((Segment("0", 0, 100),), (), ())


def test_whole_trials_worked_by_hand():
    tracks = numbered(*[10] * 20, trials=[f"t{k}" for k in range(20)])
    divided = split(tracks)
    assert [s.trial for s in divided.train] == [f"t{k}" for k in range(14)]
    assert [s.trial for s in divided.validation] == ["t14", "t15", "t16"]
    assert [s.trial for s in divided.test] == ["t17", "t18", "t19"]
    assert all((s.start, s.stop) == (0, 10) for s in divided.train)
    assert split(tracks, "trial") == divided
    three = split(numbered(10, 10, 10))
    assert [len(three.part(part)) for part in PARTS] == [1, 1, 1]
    assert split(numbered(10, 10), "trial", (0.5, 0, 0.5)).test == (Segment("1", 0, 10),)


def test_trials_keep_their_own_order_not_that_of_the_alphabet():
    tracks = numbered(*[10] * 4, trials=["10", "9", "b", "a"])
    divided = split(tracks, fractions=(0.5, 0.25, 0.25))
    assert [s.trial for s in divided.train + divided.validation + divided.test] == [
        "10",
        "9",
        "b",
        "a",
    ]


def test_auto_splits_by_time_below_three_trials():
    assert split(numbered(100, 100)) == split(numbered(100, 100), "time")
    assert split(numbered(40, 40, 40)) == split(numbered(40, 40, 40), "trial")
    # A trial in which nobody was seen is none.
    position = np.zeros((3, 40, 2, 2))
    position[1] = NAN
    tracks = make_tracks(position, fps=1)
    assert {s.trial for s in split(tracks).train} == {"0", "2"}
    assert split(tracks) == split(tracks, "time")


def test_each_trial_is_cut_by_its_own_extent():
    position = np.zeros((2, 100, 2, 2))
    position[1, :20] = NAN
    position[1, 60:] = NAN
    position[1, 30:35] = NAN  # a gap inside belongs to the trial
    position[0, :, 1] = NAN
    divided = split(make_tracks(position, fps=1), "time", (0.5, 0.25, 0.25))
    assert divided.train == (Segment("0", 0, 50), Segment("1", 20, 40))
    assert divided.validation == (Segment("0", 50, 75), Segment("1", 40, 50))
    assert divided.test == (Segment("0", 75, 100), Segment("1", 50, 60))
    ragged = split(numbered(100, 40), "time", (0.5, 0.25, 0.25))
    assert ragged.test == (Segment("0", 75, 100), Segment("1", 30, 40))


@settings(max_examples=40)
@given(
    lengths=st.lists(st.integers(1, 60), min_size=1, max_size=6),
    by=st.sampled_from(["auto", "trial", "time"]),
    shares=st.tuples(st.integers(1, 10), st.integers(0, 10), st.integers(0, 10)),
    gap=st.integers(0, 4),
)
def test_no_frame_is_in_two_parts_and_each_has_its_share(
    lengths: list[int], by: str, shares: tuple[int, int, int], gap: int
):
    assume(max(lengths) >= 2)
    tracks = numbered(*lengths, members=1)
    fractions = tuple(share / sum(shares) for share in shares)
    try:
        divided = split(tracks, by, fractions, gap)
    except InputError as error:
        assert "too few" in str(error) or "split by time" in str(error)  # noqa: PT017
        return
    seen: dict[tuple[str, int], str] = {}
    for part, trial, frame in frames_of(divided):
        assert (trial, frame) not in seen
        assert 0 <= frame < lengths[int(trial)]
        seen[trial, frame] = part
    for part, share in zip(PARTS, fractions, strict=True):
        assert bool(divided.part(part)) == (share > 0)
    wanted = sum(share > 0 for share in fractions)
    whole = by == "trial" or (by == "auto" and len(lengths) >= 3)
    if whole:
        assert len(seen) == sum(lengths)
        assert sum(len(divided.part(part)) for part in PARTS) == len(lengths)
    else:
        assert len(seen) == sum(lengths) - gap * (wanted - 1) * len(lengths)
        for trial, length in enumerate(lengths):
            order = [seen.get((str(trial), frame)) for frame in range(length)]
            parts = [part for part in order if part is not None]
            assert parts == sorted(parts, key=PARTS.index)
            assert order[0] == "train"
            for share, part in zip(fractions, PARTS, strict=True):
                # Each end of a block is rounded by half a frame at most.
                block = parts.count(part) + (gap if part != "train" and share else 0)
                assert abs(block - share * length) <= 1 + 1e-9


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"by": "day"}, "by: 'day' is unknown; choose trial, time or auto."),
        ({"gap": -1}, "gap: it must not be negative, and it is -1."),
        (
            {"fractions": (0.5, 0.5, 0.5)},
            "fractions: three shares that sum to 1 are needed, the first of them positive, not "
            "(0.5, 0.5, 0.5).",
        ),
        ({"fractions": (0.5, 0.5)}, "fractions: three shares that sum to 1"),
        ({"fractions": (1.5, -0.5, 0.0)}, "fractions: three shares that sum to 1"),
        ({"fractions": (0.0, 0.5, 0.5)}, "fractions: three shares that sum to 1"),
        ({"fractions": (NAN, 0.5, 0.5)}, "fractions: three shares that sum to 1"),
        ({"fractions": "most"}, "fractions: three shares that sum to 1"),
        (
            {"by": "trial"},
            "by: 1 trials cannot be split into 3 parts; split by time.",
        ),
        (
            {"by": "time", "gap": 8},
            "tracks: trial 0 has 50 frames, too few to split by time into shares (0.7, 0.15, "
            "0.15) with a gap of 8.",
        ),
    ],
)
def test_a_split_that_cannot_be_is_refused(arguments: dict[str, Any], sentence: str):
    with pytest.raises(InputError) as caught:
        split(numbered(50), **arguments)
    assert sentence in str(caught.value)


def test_a_part_that_would_be_empty_is_refused_not_left_out():
    # 0.15 of four frames rounds to none.
    with pytest.raises(InputError, match="trial 0 has 4 frames, too few to split by time"):
        split(numbered(4), "time")
    # Of seven it is one, from the fifth to the sixth: too short for a velocity.
    with pytest.raises(InputError, match="trial 0 has 7 frames, too few to split by time"):
        split(numbered(7), "time")
    with pytest.raises(InputError, match="trial 1 has 4 frames, too few"):
        split(numbered(100, 4), "time")
    with pytest.raises(InputError, match="the test part would be trial 2 alone, which has 1 frame"):
        split(numbered(10, 10, 1))


# --- the split itself --------------------------------------------------------------------------


def test_a_split_goes_through_json_and_back():
    divided = split(numbered(100, 40), "time", gap=1)
    text = json.dumps(divided.to_dict())
    assert Split.from_dict(json.loads(text)) == divided
    assert json.loads(text)["train"] == [["0", 0, 70], ["1", 0, 28]]
    assert divided.part("test") is divided.test
    with pytest.raises(InputError) as caught:
        divided.part("rest")
    assert str(caught.value) == "part: 'rest' is unknown; choose one of train, validation, test."


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"train": [["0", 0, 5]], "validation": []},
        {"train": [["0", 0]], "validation": [], "test": []},
        {"train": [["0", "a", "b"]], "validation": [], "test": []},
        {"train": 3, "validation": [], "test": []},
    ],
)
def test_a_split_from_a_broken_file_is_refused(values: Any):
    with pytest.raises(InputError, match=r"^split: each of train, validation and test must be"):
        Split.from_dict(values)


def test_parts_that_share_a_frame_are_refused():
    with pytest.raises(InputError) as caught:
        Split((Segment("a", 0, 10),), (), (Segment("b", 0, 5), Segment("a", 9, 12)))
    assert str(caught.value) == (
        "split: frame 9 of trial a is in train and in test. Give each frame to one part."
    )
    # Neighbours are no overlap, and one part may hold a frame twice.
    Split((Segment("a", 0, 10), Segment("a", 5, 10)), (Segment("a", 10, 12),), ())


# --- taking segments ---------------------------------------------------------------------------


def rich(trials: int = 2, length: int = 12, fps: float = 4.0) -> xr.Dataset:
    """Tracks with everything that tracks can hold, all of it random."""
    generator = np.random.default_rng(0)
    shape = (trials, length, 3, 2)
    position = generator.normal(size=shape)
    position[0, 4, 1] = NAN
    edges = generator.random((trials, length, 3, 3)) < 0.5
    edges[..., range(3), range(3)] = False
    return make_tracks(
        position,
        fps=fps,
        frames=np.arange(20, 20 + length),
        individuals=["a", "b", "c"],
        trials=[f"t{k}" for k in range(trials)],
        velocity=generator.normal(size=shape),
        adjacency=edges,
        unit="cm",
        attrs={"note": "mine"},
        variables={
            "force": (
                ("trial", "time", "term", "space", "individual"),
                generator.normal(size=(trials, length, 4, 2, 3)),
            ),
            "term": (("term",), ["c", "s", "a", "w"]),
            "light": (("time",), generator.normal(size=length)),
            "count": (
                ("individual", "time", "trial"),
                generator.integers(9, size=(3, length, trials)),
            ),
            "dark": (("trial", "time"), generator.random((trials, length)) < 0.5),
            "length": (("individual",), [1.0, 2.0, 3.0]),
            "gains": (("trial", "term"), generator.normal(size=(trials, 4))),
            "room": ((), 21.5),
        },
    ).assign_coords(sex=("individual", ["f", "m", "f"]), day=("trial", list(range(trials))))


def row(dataset: xr.Dataset, trial: int, time: int) -> dict[str, Any]:
    """Return all values of one row of one trial, each in its own order of dimensions."""
    found = {}
    for name, array in dataset.data_vars.items():
        picked = array.isel(
            {d: k for d, k in {"trial": trial, "time": time}.items() if d in array.dims}
        )
        found[str(name)] = picked.transpose(*sorted(map(str, picked.dims))).values
    return found


def test_taking_every_frame_gives_the_tracks_again():
    tracks = rich()
    taken = take(tracks, [Segment("t0", 0, 12), Segment("t1", 0, 12)])
    assert taken["start_time"].values.tolist() == [5.0, 5.0]
    # Only a variable of time that all trials shared differs: it has trials now.
    assert taken["light"].dims == ("trial", "time")
    for trial in range(2):
        np.testing.assert_array_equal(taken["light"][trial], tracks["light"])
    again = taken.drop_vars(["start_time", "light"])
    wanted = tracks.drop_vars("light")
    assert again["count"].dims == ("trial", "time", "individual")
    xr.testing.assert_identical(again.transpose(*wanted.dims), wanted.transpose(*wanted.dims))
    for name in ("position", "velocity", "adjacency", "force"):
        assert again[name].dims == tracks[name].dims
        assert again[name].dtype == tracks[name].dtype
    xr.testing.assert_identical(validate_tracks(taken), taken)


def test_taken_segments_hold_the_values_of_their_own_frames():
    tracks = rich()
    segments = [Segment("t1", 3, 8), Segment("t0", 7, 9), Segment("t1", 10, 12)]
    taken = take(tracks, segments)
    assert taken["trial"].values.tolist() == ["t1[3:8]", "t0[7:9]", "t1[10:12]"]
    assert taken.sizes["time"] == 5
    np.testing.assert_array_equal(taken["time"], np.arange(5) / 4)
    np.testing.assert_array_equal(taken["start_time"], [5 + 3 / 4, 5 + 7 / 4, 5 + 10 / 4])
    assert "frame" not in taken.coords
    assert taken.attrs == tracks.attrs
    assert taken["position"].attrs == {"units": "cm"}
    assert taken["sex"].values.tolist() == ["f", "m", "f"]
    assert taken["day"].values.tolist() == [1, 0, 1]
    np.testing.assert_array_equal(taken["gains"], tracks["gains"].isel(trial=[1, 0, 1]))
    assert taken["room"] == 21.5
    assert taken["adjacency"].dtype == np.uint8
    assert taken["count"].dtype == tracks["count"].dtype
    assert taken["dark"].dtype == bool
    for trial, segment in enumerate(segments):
        source = ["t0", "t1"].index(segment.trial)
        length = segment.stop - segment.start
        for time in range(length):
            np.testing.assert_equal(
                row(taken, trial, time), row(tracks, source, segment.start + time)
            )
        for time in range(length, 5):
            padding = row(taken, trial, time)
            for name in ("position", "velocity", "force", "light"):
                assert np.isnan(padding[name]).all(), name
            for name in ("adjacency", "count", "dark"):
                assert (padding[name] == 0).all(), name
    xr.testing.assert_identical(validate_tracks(taken), taken)


def test_segments_that_start_together_keep_their_time_and_frames():
    tracks = rich()
    taken = take(tracks, [Segment("t0", 2, 5), Segment("t1", 2, 9)])
    np.testing.assert_array_equal(taken["time"], tracks["time"][2:9])
    assert taken["frame"].values.tolist() == [22, 23, 24, 25, 26, 27, 28]
    assert taken["start_time"].values.tolist() == [5.5, 5.5]
    assert taken["trial"].values.tolist() == ["t0", "t1"]


def test_tracks_without_trials_can_be_cut_too():
    tracks = rich(trials=1).isel(trial=0, drop=True)
    taken = take(tracks, [Segment("0", 4, 9)])
    assert taken["position"].dims == ("trial", "time", "space", "individual")
    for name in ("position", "velocity", "adjacency", "force", "dark"):
        wanted = tracks[name].isel(time=slice(4, 9)).transpose(*taken[name].dims[1:])
        np.testing.assert_array_equal(taken[name][0], wanted)
    assert taken["frame"].values.tolist() == [24, 25, 26, 27, 28]
    assert taken["sex"].values.tolist() == ["f", "m", "f"]
    assert taken["start_time"].values.tolist() == [6.0]


def test_a_part_of_a_part_knows_when_it_started():
    tracks = rich()
    apart = take(tracks, [Segment("t0", 2, 12), Segment("t1", 5, 12)])
    both = take(apart, [Segment("t0", 1, 6), Segment("t1", 1, 6)])
    np.testing.assert_array_equal(both["start_time"], [5 + 3 / 4, 5 + 6 / 4])
    np.testing.assert_array_equal(both["position"][0], tracks["position"][0, 3:8])
    np.testing.assert_array_equal(both["position"][1], tracks["position"][1, 6:11])
    # As if they had been taken at once.
    at_once = take(tracks, [Segment("t0", 3, 8), Segment("t1", 6, 11)])
    xr.testing.assert_identical(both, at_once)
    together = take(take(tracks, [Segment("t0", 2, 12)]), [Segment("t0", 3, 5)])
    xr.testing.assert_identical(together, take(tracks, [Segment("t0", 5, 7)]))
    picked = apart.isel(trial=1)
    np.testing.assert_array_equal(take(picked, [Segment("t1", 1, 3)])["start_time"], [5 + 6 / 4])


def test_taken_tracks_are_copies():
    tracks = rich()
    before = tracks.copy(deep=True)
    taken = take(tracks, [Segment("t0", 0, 12), Segment("t1", 0, 12)])
    for name in ("position", "velocity", "adjacency", "force", "light"):
        taken[name].values[...] = 1
        taken[name].attrs["mine"] = 1
    taken.attrs["mine"] = 1
    xr.testing.assert_identical(tracks, before)


@pytest.mark.parametrize(
    ("segments", "sentence"),
    [
        ([], "segments: at least one is needed."),
        ([Segment("t0", 0, 5)] * 2, "segments: one of them stands there twice."),
        ([Segment("t7", 0, 5)], "tracks: there is no trial t7."),
        (
            [Segment("t0", 0, 13)],
            "tracks: trial t0 has 12 frames, and frames 0 to 13 are asked for.",
        ),
        (
            [Segment("t0", -3, 5)],
            "tracks: trial t0 has 12 frames, and frames -3 to 5 are asked for.",
        ),
        ([Segment("t0", 5, 5)], "tracks: trial t0 has 12 frames, and frames 5 to 5 are asked for."),
    ],
)
def test_segments_that_are_not_there_are_refused(segments: list[Segment], sentence: str):
    with pytest.raises(InputError) as caught:
        take(rich(), segments)
    assert str(caught.value) == sentence


# --- leakage -----------------------------------------------------------------------------------


def derived(tracks: xr.Dataset) -> dict[str, Array]:
    """Return all that is computed from the training part before a model sees it."""
    kalman = add_velocity(tracks, "kalman")
    found = {
        "states": states_of(tracks),
        "difference": states_of(add_velocity(tracks, "difference")),
        "kalman": states_of(kalman),
    }
    for kind in ("minmax", "isotropic"):
        scaler = fit_scaler(states_of(kalman), kind)
        found[kind] = np.array([scaler.offset, scaler.scale])
    return found


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["trial", "time"]), st.sampled_from([0, 3]))
def test_nothing_of_the_test_part_reaches_the_training_part(seed: int, by: str, gap: int):
    generator = np.random.default_rng(seed)
    position = np.cumsum(generator.normal(size=(4, 40, 3, 2)), axis=1)
    position[generator.random((4, 40, 3)) < 0.05] = NAN
    position[:, [0, -1]] = 0.0  # whoever is seen first and last decides where the cuts lie
    tracks = make_tracks(position, fps=10)
    divided = split(tracks, by, gap=gap)
    before = derived(take(tracks, divided.train))
    disturbed = tracks.copy(deep=True)
    for part, trial, frame in frames_of(divided):
        if part != "train":
            place = disturbed["position"].values[int(trial), frame]
            place[...] = generator.normal(0, 1e4, place.shape)
    assert split(disturbed, by, gap=gap) == divided
    after = derived(take(disturbed, divided.train))
    for name, values in before.items():
        np.testing.assert_array_equal(after[name], values, err_msg=name)
    # The check can fail: smoothing before the cut does carry the test part over.
    if by == "time":
        early = take(add_velocity(disturbed, "kalman"), divided.train)
        assert not np.array_equal(states_of(early), before["kalman"], equal_nan=True)
