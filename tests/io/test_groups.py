"""Several datasets in one file."""

import numpy as np
import pytest
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io import read_groups, write_groups

FIRST = xr.Dataset(
    {"a": ("x", np.array([1.0, np.nan, -0.1])), "flag": ("x", np.array([True, False, True]))},
    {"x": ["p", "quite long", "µ"]},
    {"nested": {"b": [1, 2]}, "none": None, "word": "é"},
)
SECOND = xr.Dataset(
    {"b": (("x", "y"), np.arange(6, dtype=np.float32).reshape(2, 3))}, {"x": [4, 5]}
)


def test_groups_come_back_as_they_were(tmp_path):
    path = tmp_path / "g.nc"
    write_groups({"first": FIRST, "second": SECOND}, path, attrs={"note": ["a", None], "n": 3})
    groups, attrs = read_groups(path)
    assert attrs == {"note": ["a", None], "n": 3}
    assert list(groups) == ["first", "second"]
    xr.testing.assert_identical(groups["first"], FIRST)
    xr.testing.assert_identical(groups["second"], SECOND)
    assert groups["second"]["b"].dtype == np.float32
    with xr.open_dataset(path, group="second") as alone:
        np.testing.assert_array_equal(alone["b"], SECOND["b"])


def test_what_exists_is_kept(tmp_path):
    path = tmp_path / "g.nc"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        write_groups({"first": FIRST}, path)
    assert path.read_text() == "precious"
    write_groups({"second": SECOND}, path, overwrite=True)
    assert list(read_groups(path)[0]) == ["second"]


@pytest.mark.parametrize("name", ["", "a/b"])
def test_bad_names_are_refused(tmp_path, name):
    with pytest.raises(InputError, match="no name of a group"):
        write_groups({name: FIRST}, tmp_path / "g.nc")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("harm", ["absent", "empty", "cut", "other"])
def test_bad_files_are_told(tmp_path, harm):
    path = tmp_path / "g.nc"
    if harm != "absent":
        write_groups({"first": FIRST}, path)
        whole = path.read_bytes()
        path.write_bytes({"empty": b"", "cut": whole[: len(whole) // 2], "other": b"x"}[harm])
    with pytest.raises(InputError, match=r"g\.nc"):
        read_groups(path)
