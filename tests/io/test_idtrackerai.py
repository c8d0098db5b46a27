"""idtracker.ai in all its formats, and the classic idTracker."""

import numpy as np
import pytest
from io_samples import (
    MOTION,
    idtrackerai_dict,
    positions,
    wide_text,
    write_idtracker,
    write_idtrackerai_csv,
    write_idtrackerai_h5,
    write_idtrackerai_parquet,
    write_idtrackerai_tidy,
)

from swarmssm.errors import InputError
from swarmssm.io import read, read_idtrackerai


def write_form(folder, form, said):
    if form == "csv":
        return write_idtrackerai_csv(folder / "trajectories_csv", said)
    if form == "tidy":
        return write_idtrackerai_tidy(folder, said)
    if form == "parquet":
        return write_idtrackerai_parquet(folder / "trajectories.parquet", said)
    if form == "npy":
        np.save(folder / "trajectories.npy", said)
        return folder / "trajectories.npy"
    return write_idtrackerai_h5(folder / f"trajectories.{form}", said)


FORMS = ["h5", "hdf5", "csv", "tidy", "parquet", "npy"]


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_tracks(tmp_path, form):
    said = idtrackerai_dict()
    path = write_form(tmp_path, form, said)
    options = {"allow_pickle": True} if form == "npy" else {}
    tracks = read(path, **options)
    # Text has three decimals; the motion has one.
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["fps"] == 28
    assert tracks.attrs["fps_source"] == "file"
    assert tracks.attrs["unit"] == "px"
    assert tracks.attrs["source_software"] == "idtracker.ai"
    assert tracks.attrs["body_length"] == 58.5
    assert tracks.attrs["video_paths"] == '["/videos/a.avi", "/videos/b.avi"]'
    assert "length_unit" not in tracks.attrs
    assert list(tracks["individual"].values) == ["fish 0", "fish 1", "fish 2"]
    np.testing.assert_array_equal(tracks["id_probability"], said["id_probabilities"][..., 0])
    np.testing.assert_array_equal(tracks["area_mean"], [300, 301, 302])
    np.testing.assert_allclose(tracks["time"], np.arange(6) / 28)


@pytest.mark.parametrize("form", FORMS)
def test_a_single_animal(tmp_path, form):
    said = idtrackerai_dict(MOTION[:, :1], identities_labels=["1"])
    path = write_form(tmp_path, form, said)
    options = {"allow_pickle": True} if form == "npy" else {}
    np.testing.assert_array_equal(positions(read(path, **options)), MOTION[:, :1])


def test_a_rate_above_the_resolution_of_the_times(tmp_path):
    """At 3000 frames per second three decimals of a second repeat; the rows are what counts."""
    said = idtrackerai_dict(frames_per_second=3000)
    assert read(write_form(tmp_path, "csv", said)).attrs["fps"] == 3000


@pytest.mark.parametrize("inner", ["", "trajectories"])
def test_session_folders(tmp_path, inner):
    session = tmp_path / "session_test"
    folder = session / inner
    folder.mkdir(parents=True)
    write_form(folder, "tidy", idtrackerai_dict())
    write_form(folder, "npy", idtrackerai_dict(MOTION + 1))
    np.testing.assert_array_equal(positions(read(session)), MOTION)
    # The form that holds everything comes before text, and text before pickles.
    write_form(folder, "h5", idtrackerai_dict(MOTION + 2))
    np.testing.assert_array_equal(positions(read(session)), MOTION + 2)
    np.testing.assert_array_equal(positions(read(folder)), MOTION + 2)


def test_stems_in_the_order_of_idtrackerai(tmp_path):
    write_idtrackerai_h5(tmp_path / "without_gaps.h5", idtrackerai_dict(MOTION + 1))
    write_idtrackerai_h5(tmp_path / "validated.h5", idtrackerai_dict(MOTION + 2))
    np.testing.assert_array_equal(positions(read(tmp_path)), MOTION + 2)


def test_length_unit_is_kept_and_nothing_is_converted(tmp_path):
    tracks = read(write_form(tmp_path, "h5", idtrackerai_dict(length_unit=12.5)))
    assert tracks.attrs["length_unit"] == 12.5
    np.testing.assert_array_equal(positions(tracks), MOTION)


def test_old_versions(tmp_path):
    said = {
        "trajectories": MOTION,
        "id_probabilities": None,
        "git_commit": "abc",
        "video_path": "/videos/a.avi",
        "frames_per_second": np.float64(30),
        "body_length": 40.0,
        "areas": np.full((6, 3), 12.0),
    }
    np.save(tmp_path / "trajectories.npy", said)
    tracks = read(tmp_path, allow_pickle=True)
    assert list(tracks["individual"].values) == ["1", "2", "3"]
    assert "id_probability" not in tracks
    assert tracks["area"].dims == ("time", "individual")
    assert tracks.attrs["fps"] == 30


def test_a_pickle_is_refused_unless_allowed(tmp_path):
    path = write_form(tmp_path, "npy", idtrackerai_dict())
    for named in (path, tmp_path):
        with pytest.raises(InputError, match=r"this is a pickle.*h5 or csv.*allow_pickle=True"):
            read(named)


def test_without_a_rate(tmp_path):
    path = write_form(tmp_path, "h5", idtrackerai_dict(frames_per_second=None))
    with pytest.raises(InputError, match=r"Add fps="):
        read(path)
    assert read(path, fps=10).attrs["fps"] == 10


def test_a_csv_folder_without_attributes_takes_its_rate_from_the_times(tmp_path):
    said = idtrackerai_dict(np.tile(MOTION, (20, 1, 1)), frames_per_second=28)
    folder = write_form(tmp_path, "csv", said)
    (folder / "attributes.json").unlink()
    tracks = read_idtrackerai(folder)
    # Times are rounded to 0.001 s, the typical step to 0.036: it is 1 / 28 = 0.0357 all the same.
    assert tracks.attrs["fps"] == 28
    assert tracks.attrs["fps_source"] == "time"


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ({"trajectories": MOTION[..., 0]}, r"trajectories have the shape \(6, 3\)"),
        ({"frames_per_second": -28}, "frames per second must lie between"),
        ({"id_probabilities": np.ones((5, 3))}, "id_probabilities do not fit"),
        ({"trajectories": np.where(MOTION > 20, np.inf, MOTION)}, "is x = inf|is y = inf"),
    ],
)
def test_damage_is_named(tmp_path, more, sentence):
    path = write_form(tmp_path, "h5", idtrackerai_dict(**more))
    with pytest.raises(InputError, match=sentence):
        read(path)


def test_a_csv_folder_with_the_positions_alone(tmp_path):
    folder = write_form(tmp_path, "csv", idtrackerai_dict())
    for name in ("areas.csv", "id_probabilities.csv", "attributes.json"):
        (folder / name).unlink()
    tracks = read_idtrackerai(folder, fps=28)
    np.testing.assert_array_equal(positions(tracks), MOTION)
    # Rounded to a millisecond, the times are not quite those of the grid.
    assert list(tracks.data_vars) == ["position", "recorded_time"]


def test_what_holds_no_numbers(tmp_path):
    for more in ({"trajectories": "none"}, {"frames_per_second": {"a": 1}}):
        np.save(tmp_path / "trajectories.npy", idtrackerai_dict(**more))
        with pytest.raises(InputError, match=f"{next(iter(more))} holds no numbers"):
            read(tmp_path, allow_pickle=True)


def test_broken_attributes(tmp_path):
    folder = write_form(tmp_path, "csv", idtrackerai_dict())
    (folder / "attributes.json").write_text('{"frames_per_second": ')
    with pytest.raises(InputError, match=r"attributes.json: this is not a whole json text"):
        read(folder)
    (folder / "attributes.json").write_text("[1, 2]")
    with pytest.raises(InputError, match=r"attributes.json: this is not a whole json text"):
        read(folder)


def test_no_trajectories(tmp_path):
    (tmp_path / "trajectories").mkdir()
    with pytest.raises(InputError, match="no tracks were found in this folder"):
        read(tmp_path)
    with pytest.raises(InputError, match=r"no trajectories of idtracker.ai"):
        read(tmp_path, "idtrackerai")


def test_real_file(shared_data):
    path = shared_data / "zebrafish_idtracker8" / "idtrackerai_dict_trajectories.npy"
    with pytest.raises(InputError, match="this is a pickle"):
        read(path)
    tracks = read(path, allow_pickle=True)
    assert dict(tracks.sizes) == {"time": 508, "space": 2, "individual": 8}
    assert tracks.attrs["fps"] == 28
    assert tracks.attrs["body_length"] == pytest.approx(58, abs=0.5)
    with np.load(path.with_name("zebrafish_idtracker8.npz")) as stacked:
        np.testing.assert_array_equal(positions(tracks).astype(np.float32), stacked["xy"])
        np.testing.assert_array_equal(
            tracks["id_probability"].to_numpy().astype(np.float32), stacked["id_probability"]
        )


def test_classic_idtracker(tmp_path):
    path = write_idtracker(tmp_path / "trajectories.txt")
    with pytest.raises(InputError, match=r"does not tell its frames per second. Add fps="):
        read(path)
    for named in (path, tmp_path):
        tracks = read(named, fps=32)
        np.testing.assert_array_equal(positions(tracks), MOTION)
        assert tracks.attrs["source_software"] == "idTracker"
        assert tracks.attrs["unit"] == "px"
        assert list(tracks["individual"].values) == ["1", "2", "3"]
        probability = tracks["id_probability"].to_numpy()
        assert (probability == 0.5).sum() == 17
        assert np.isnan(probability[2, 1])


def test_classic_idtracker_cut_short(tmp_path):
    path = write_idtracker(tmp_path / "trajectories_nogaps.txt")
    path.write_text(path.read_text()[:-30])
    with pytest.raises(InputError, match=r"line 7 has \d cells? and the header 9"):
        read(path, fps=32)
    path.write_text(wide_text(head="time"))
    with pytest.raises(InputError, match="its header is not X1, Y1, ProbId1"):
        read(path, "idtracker", fps=32)
