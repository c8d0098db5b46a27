"""``fit --edges``: runs whose edges are inferred, and what the other commands make of them."""

import json

import pytest


@pytest.fixture
def relational(swarmssm, flock_file):
    done = swarmssm(
        "fit", flock_file, "--model", "linear", "--model-option", "observed=states",
        "--edges", "relational", "--edge-types", 3, "--edge-option", "sparsity=0.8",
        "--edge-option", "hidden=4", "--steps", 3, "--window", 10, "--out", "run",
    )  # fmt: skip
    assert done.status == 0, done.err
    return done


def test_a_run_with_inferred_edges_forecasts_and_is_scored(swarmssm, relational, flock_file):
    with open("run/config.json") as file:
        settings = json.load(file)["settings"]
    assert settings["edges"] == "relational"
    assert settings["edge_types"] == 3
    assert settings["edge_options"] == {"sparsity": 0.8, "hidden": 4}
    for call in (
        ("forecast", "run", flock_file, "--horizon", 3, "--draws", 2, "--out", "f.nc"),
        ("rollout", "run", flock_file, "--steps", 3, "--out", "r.nc"),
    ):
        done = swarmssm(*call)
        assert done.status == 0, done.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--edges", "rational"), "'rational'"),
        (("--edges", "relational", "--edge-option", "sparse=1"), "sparse is no option"),
        (("--edge-types", "3"), "choose relational"),
        (("--edges", "relational", "--edge-option", "sparsity"), "--edge-option"),
        (("--edges", "relational", "--edge-option", "gradient=none"), "gradient"),
    ],
)
def test_mistakes_are_told_in_one_sentence(swarmssm, flock_file, options, words):
    done = swarmssm("fit", flock_file, "--model", "linear", *options, "--out", "run")
    assert done.status == 2
    assert words in done.err
    assert "Traceback" not in done.err
