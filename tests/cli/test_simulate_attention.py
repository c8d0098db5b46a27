"""Plant a leader or an isolated individual from the command line."""

import json

import pytest

from swarmssm import io
from swarmssm.simulate.attention import planted_attention


def test_a_leader_and_an_isolated_one_are_planted(swarmssm, tmp_path):
    options = ("--individuals", 4, "--steps", 5, "--out", "l.nc", "--seed", 1)
    result = swarmssm(
        "simulate", "boids", *options, "--leader", 1, "--leader-strength", 2, "--isolated", 3
    )
    assert result.status == 0, result.err
    told = json.loads(io.read(tmp_path / "l.nc").attrs["simulation"])
    expected = planted_attention(4, leader=1, strength=2.0, isolated=3)
    assert told["attention"] == expected.tolist()
    table = json.dumps(expected.tolist())
    result = swarmssm("simulate", "boids", *options, "--overwrite", "--set", f"attention={table}")
    assert result.status == 0, result.err
    assert json.loads(io.read(tmp_path / "l.nc").attrs["simulation"]) == told


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--leader", 4), "leader: the places are from 0 to 3"),
        (("--leader", 1, "--set", "attention=[[1]]"), "leave out --leader"),
        (("--set", "attention=[[1]]"), "a row and a column for each individual, 4"),
    ],
)
def test_mistakes_are_explained(swarmssm, tmp_path, options, word):
    result = swarmssm("simulate", "boids", "--individuals", 4, "--out", "l.nc", *options)
    assert result.status == 2
    assert word in " ".join(result.err.split())
    assert not (tmp_path / "l.nc").exists()
