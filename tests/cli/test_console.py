"""Tables as people read them."""

import pytest

from swarmssm.cli.console import print_table


def printed(capsys, *table):
    print_table(*table)
    return capsys.readouterr().out.splitlines()


def test_words_stand_to_the_left_and_numbers_to_the_right(capsys):
    rows = [["a", "long words", 1.5, None], ["b", "few", 12.25, "infinite"]]
    lines = printed(capsys, "title", ["name", "what", "x", "y"], rows)
    assert lines[0].strip() == "title"
    assert "│ a    │ long words │  1.5 │        - │" in lines
    assert "│ b    │ few        │ 12.2 │ infinite │" in lines


@pytest.mark.parametrize("name", ["constant-velocity", "a-very-long-name-of-a-model-indeed-it-is"])
def test_a_name_is_not_broken_where_there_is_room(capsys, name):
    columns = ["rank", "model", "log score", "behind the best", "in standard errors"]
    columns += [f"{steps} ahead" for steps in (1, 2, 5, 10, 20)]
    lines = printed(capsys, "", columns, [[1, name, *["-0.12"] * 8]])
    assert all(len(line) <= 120 for line in lines)
    (row,) = [line for line in lines if name in line]
    assert row.count("-0.12") == 8


def test_without_room_nothing_is_lost(capsys):
    words = [letter * 40 for letter in "abcd"]
    lines = printed(capsys, "", words, [words])
    assert all(len(line) <= 120 for line in lines)
    for letter in "abcd":
        assert sum(line.count(letter) for line in lines) == 80
