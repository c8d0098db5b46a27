"""What a file says beside its arrays, in forms that NetCDF has."""

from pathlib import PurePosixPath

import numpy as np
import pytest

from swarmssm.io.attributes import plain_attribute


@pytest.mark.parametrize(
    ("value", "plain"),
    [
        (3, 3),
        (True, 1),
        (2.5, 2.5),
        ("é", "é"),
        (b"abc", "abc"),
        (np.float32(0.5), 0.5),
        (np.array("a"), "a"),
        (np.array(7), 7),
        (PurePosixPath("/a/b"), "/a/b"),
        (2**70, 2.0**70),
        ({"a": {1, 2}, "b": np.arange(2)}, '{"a": [1, 2], "b": [0, 1]}'),
        (["a", 1], '["a", 1]'),
        ([[1, 2], [3, 4]], "[[1, 2], [3, 4]]"),
        ([PurePosixPath("/a")], '["/a"]'),
        (None, None),
        ([], None),
        ("a" * 60_001, None),
        ([0.5] * 8_000, None),
        (list("ab") * 10_000, None),
        (object(), None),
        ({(1, 2): 3}, None),
    ],
)
def test_forms(value, plain):
    found = plain_attribute(value)
    assert found == plain
    assert type(found) is type(plain)


def test_numbers_in_a_row_are_an_array():
    np.testing.assert_array_equal(plain_attribute([1, 2, 3]), [1, 2, 3])
    np.testing.assert_array_equal(plain_attribute(np.array([0.5, np.nan])), [0.5, np.nan])
