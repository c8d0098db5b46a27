"""``fit --edges``: runs whose edges are inferred, and what the other commands make of them."""

import json

import pytest

from swarmssm.analysis import Analysis


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


def fit_of(swarmssm, flock_file, *options):
    how = ("--model-option", "observed=states", "--steps", 3, "--window", 10)
    return swarmssm("fit", flock_file, *how, *options)


def test_edges_are_learned_under_a_law_that_is_held(swarmssm, flock_file):
    law = ("--model", "boids", "--graph", "radius:3", "--out", "law")
    assert fit_of(swarmssm, flock_file, *law).status == 0
    with open("law/config.json") as file:
        options = json.load(file)["settings"]["model_options"]
    done = swarmssm(
        "fit", flock_file, "--model", "boids", "--transition-from", "law",
        "--prior", "wall_gain=0.5",
        "--edges", "dynamic-relational", "--edge-option", "hidden=4", "--steps", 2,
        "--window", 10, "--out", "edges",
    )  # fmt: skip
    assert done.status == 0, done.err
    with open("edges/config.json") as file:
        settings = json.load(file)["settings"]
    assert settings["model_options"] == options
    assert settings["priors"]["wall_gain"] == "0.5"
    assert "transition.wall_gain" not in settings["priors"]
    assert isinstance(settings["priors"]["transition.cohesion_gain"], float)
    done = swarmssm("analyze", "edges", flock_file, "--draws", 2, "--out", "found.nc",
                    "--only", "influence")  # fmt: skip
    assert done.status == 0, done.err
    found = Analysis.read("found.nc")
    assert found.edges["edge_probability"].sizes["edge_type"] == 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--model", "boids"), "add --edges relational or dynamic-relational"),
        (("--model", "linear", "--edges", "relational"), "law is a run of boids; choose --model"),
        (("--model", "boids", "--edges", "relational", "--transition-from", "nowhere"), "nowhere"),
    ],
)
def test_a_law_that_cannot_be_held_is_told(swarmssm, flock_file, options, said):
    law = ("--model", "boids", "--graph", "radius:3", "--out", "law")
    assert fit_of(swarmssm, flock_file, *law).status == 0
    done = fit_of(swarmssm, flock_file, "--transition-from", "law", *options, "--out", "run")
    assert done.status == 2
    assert said in " ".join(done.err.split())
