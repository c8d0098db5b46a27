"""``swarmssm compare`` as a user calls it."""

import json

import pytest

from swarmssm import inference, io


@pytest.fixture(scope="module")
def rival_folder(flock_file, tmp_path_factory):
    """A run of one epoch on the same file."""
    folder = tmp_path_factory.mktemp("runs") / "rival"
    tracks = io.read(flock_file)
    inference.fit(
        "graph-vae", tracks, guide="encoder", source=flock_file, out=folder, epochs=1, seed=1
    )
    return folder


def test_a_table_a_sentence_and_a_file(swarmssm, run_folder, rival_folder, flock_file, tmp_path):
    options = ["--horizons", "1,3", "--origins", 8, "--draws", 12]
    told = swarmssm(
        "compare", run_folder, rival_folder, flock_file, *options, "--out", tmp_path / "t.json"
    )
    assert told.status == 0, told.err
    for word in ("rank", "run", "rival", "constant-velocity", "is first with"):
        assert word in told.out
    assert "forecasting" in told.err
    written = json.loads((tmp_path / "t.json").read_text())
    assert [row["rank"] for row in written["models"] if row["rank"]] == [1, 2, 3, 4]
    assert written["settings"]["horizons"] == [1, 3]
    assert written["settings"]["part"] == "test"
    again = swarmssm("compare", run_folder, rival_folder, flock_file, *options, "--format", "json")
    assert json.loads(again.out) == written


def test_leave_future_out(swarmssm, run_folder, rival_folder, flock_file):
    told = swarmssm(
        "compare", run_folder, rival_folder, flock_file, "--method", "lfo", "--window", 3,
        "--draws", 100, "--format", "json",
    )  # fmt: skip
    assert told.status == 0, told.err
    found = json.loads(told.out)
    assert {"run", "rival"} == {row["model"] for row in found["models"]}
    assert len(found["windows"]) == len(found["models"][0]["elpd"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("RUN", "FILE"), "name at least two run folders"),
        (("FILE",), "name at least two run folders"),
        (("RUN", "RIVAL"), "name at least two"),
        (("RUN", "RIVAL", "RUN"), "this is a run folder. The last argument must be the tracks"),
        (("RUN", "FILE", "FILE"), "this is a file. Run folders come first"),
        (("RUN", "RUN", "FILE"), "this run is given twice"),
        (("RUN", "nowhere", "FILE"), "there is no such run folder"),
        (("RUN", "RIVAL", "FILE", "--method", "waic"), "'waic' is unknown"),
        (("RUN", "RIVAL", "FILE", "--method", "loo"), "without a posterior"),
        (("RUN", "RIVAL", "FILE", "--part", "train"), "--allow-seen"),
        (("RUN", "RIVAL", "FILE", "--horizons", "1;2"), "not of the form 1,5,10"),
        (("RUN", "RIVAL", "FILE", "--method", "lfo", "--horizons", "1"), "one step at a time"),
    ],
)
def test_mistakes(swarmssm, run_folder, rival_folder, flock_file, arguments, words):
    paths = {"RUN": run_folder, "RIVAL": rival_folder, "FILE": flock_file}
    told = swarmssm("compare", *(paths.get(word, word) for word in arguments))
    assert told.status == 2
    assert words in told.err
    assert len(told.err.strip().splitlines()) <= 2
    assert "Traceback" not in told.err


def test_an_existing_file_is_left_as_it_is(
    swarmssm, run_folder, rival_folder, flock_file, tmp_path
):
    target = tmp_path / "t.json"
    target.write_text("mine")
    told = swarmssm("compare", run_folder, rival_folder, flock_file, "--out", target)
    assert told.status == 2
    assert "--overwrite" in told.err
    assert target.read_text() == "mine"
