"""A user's mistake gets one or two sentences and status 2, and nothing that existed is lost."""

import json
import shutil

import pytest

MISTAKES = {
    "no such file": (["info", "absent.nc"], "absent.nc"),
    "no such run": (["evaluate", "absent", "{flock}"], "absent"),
    "unknown model": (["fit", "{flock}", "--out", "r", "--model", "grph-vae"], "graph-vae"),
    "unknown guide": (["fit", "{flock}", "--out", "r", "--guide", "coder"], "encoder"),
    "no such module": (["fit", "{flock}", "--out", "r", "--model", "mine:Model"], "mine"),
    "bad graph": (["fit", "{flock}", "--out", "r", "--graph", "radius:far"], "radius"),
    "bad setting": (["fit", "{flock}", "--out", "r", "--set", "colour=red"], "colour"),
    "bad seed": (["fit", "{flock}", "--out", "r", "--seed", "-1"], "seed"),
    "bad rate": (["fit", "{flock}", "--out", "r", "--lr", "0"], "lr"),
    "bad steps": (["fit", "{flock}", "--out", "r", "--steps", "0"], "steps"),
    "bad option": (["fit", "{flock}", "--out", "r", "--model-option", "depth=3"], "depth"),
    "no folder": (["fit", "{flock}", "--out", "no/r"], "no"),
    "unknown part": (["evaluate", "{run}", "{flock}", "--part", "last"], "part"),
    "bad horizon": (["evaluate", "{run}", "{flock}", "--horizons", "1,x"], "--horizons"),
    "horizon 0": (["evaluate", "{run}", "{flock}", "--horizons", "0"], "--horizons"),
    "until too early": (
        ["forecast", "{run}", "{flock}", "--until", "0", "--out", "f.nc"],
        "--until",
    ),
    "no horizon": (["forecast", "{run}", "{flock}", "--horizon", "0", "--out", "f.nc"], "horizon"),
    "bad draws": (["rollout", "{run}", "{flock}", "--draws", "-1", "--out", "f.nc"], "draws"),
    "no steps": (["rollout", "{run}", "{flock}", "--steps", "0", "--out", "f.nc"], "steps"),
    "bad edges": (["rollout", "{run}", "{flock}", "--edges", "some", "--out", "f.nc"], "edges"),
    "not a run": (["report", ".", "--out", "r.html"], "provenance.json"),
    "unknown simulator": (["simulate", "bees", "--out", "b.nc"], "bees"),
    "bad individuals": (["simulate", "boids", "--individuals", "0", "--out", "b.nc"], "individual"),
    "bad parameter": (["simulate", "boids", "--set", "speed=1", "--out", "b.nc"], "speed"),
    "no equals": (["simulate", "boids", "--set", "speed", "--out", "b.nc"], "name=value"),
    "bad format": (["import", "{flock}", "--format", "dlc"], "dlc"),
    "bad fps": (["import", "{flock}", "--fps", "-3"], "frames per second"),
    "unknown command": (["frobnicate"], "frobnicate"),
    "missing option": (["simulate", "boids"], "--out"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_explained(swarmssm, flock_file, run_folder, tmp_path, name):
    arguments, fragment = MISTAKES[name]
    filled = [a.format(flock=flock_file, run=run_folder) for a in arguments]
    result = swarmssm(*filled)
    assert result.status == 2, result
    assert fragment in result.err
    assert "Traceback" not in result.err
    assert not list(tmp_path.iterdir()), "something was left behind"


@pytest.mark.parametrize(
    "arguments",
    [
        ["import", "{flock}", "--out", "kept"],
        ["simulate", "boids", "--out", "kept"],
        ["fit", "{flock}", "--out", "kept"],
        ["evaluate", "{run}", "{flock}", "--out", "kept"],
        ["forecast", "{run}", "{flock}", "--out", "kept"],
        ["rollout", "{run}", "{flock}", "--out", "kept"],
        ["report", "{run}", "--out", "kept"],
        ["demo", "--out", "kept"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_an_output_that_exists_is_left_alone(swarmssm, flock_file, run_folder, tmp_path, arguments):
    (tmp_path / "kept").write_text("precious")
    result = swarmssm(*[a.format(flock=flock_file, run=run_folder) for a in arguments])
    assert result.status == 2
    assert "kept" in result.err
    assert (tmp_path / "kept").read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


@pytest.mark.parametrize("arguments", [["fit", "{flock}"], ["demo"]], ids=["fit", "demo"])
@pytest.mark.parametrize("option", [["--overwrite"], ["--resume", "--overwrite"]], ids=" ".join)
def test_overwriting_spares_a_folder_of_something_else(
    swarmssm, flock_file, tmp_path, arguments, option
):
    if arguments == ["demo"] and "--resume" in option:
        option = ["--overwrite", "--epochs", "1"]
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("cat")
    filled = [a.format(flock=flock_file) for a in arguments]
    result = swarmssm(*filled, "--out", "photos", *option)
    assert result.status == 2
    assert (tmp_path / "photos" / "cat.jpg").read_text() == "cat"


@pytest.mark.parametrize("name", ["config.json", "weights.safetensors", "history.csv"])
@pytest.mark.parametrize("harm", ["missing", "altered"])
def test_a_harmed_run_is_refused_by_name(swarmssm, run_folder, flock_file, tmp_path, name, harm):
    shutil.copytree(run_folder, tmp_path / "run")
    path = tmp_path / "run" / name
    if harm == "missing":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-3] + b"xyz")
    result = swarmssm("rollout", "run", flock_file, "--out", "r.nc")
    assert result.status == 2
    assert name in result.err
    assert not (tmp_path / "r.nc").exists()


def test_a_run_that_names_code_is_not_trusted(swarmssm, run_folder, flock_file, tmp_path):
    from swarmssm.files import file_digest

    shutil.copytree(run_folder, tmp_path / "run")
    config = tmp_path / "run" / "config.json"
    values = json.loads(config.read_text())
    values["settings"]["model"] = "evil:Model"
    config.write_text(json.dumps(values))
    provenance = tmp_path / "run" / "provenance.json"
    facts = json.loads(provenance.read_text())
    facts["files"]["config.json"] = file_digest(config)
    provenance.write_text(json.dumps(facts))
    (tmp_path / "evil.py").write_text("open('harm', 'w').close()\n")
    result = swarmssm("rollout", "run", flock_file, "--out", "r.nc")
    assert result.status == 2
    assert "--trust-code" in result.err
    assert not (tmp_path / "harm").exists()


def test_an_exploding_loss_is_a_failure_that_leaves_no_run(swarmssm, flock_file, tmp_path):
    result = swarmssm(
        *("fit", flock_file, "--model", "graph-vae", "--out", "run", "--lr", "1e9"),
        *("--epochs", 5, "--set", "clip=null"),
    )
    assert result.status == 1
    assert "step" in result.err
    assert "learning rate" in result.err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["import", "{flock}", "--out", "small/o.nc"],
        ["simulate", "boids", "--steps", "400", "--out", "small/o.nc"],
        ["forecast", "{run}", "{flock}", "--out", "small/o.nc"],
        ["rollout", "{run}", "{flock}", "--steps", "3000", "--out", "small/o.nc"],
        pytest.param(
            ["report", "{run}", "--out", "small/o.html", "--checks", "0"],
            marks=pytest.mark.slow,
        ),
        ["fit", "{flock}", "--model", "graph-vae", "--epochs", "1", "--out", "small/o"],
        ["demo", "--epochs", "1", "--out", "small/o"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_full_disk_is_a_failure_in_a_sentence(
    swarmssm, flock_file, run_folder, full_disk, arguments
):
    (full_disk / "filler").write_bytes(bytes(240 * 1024))
    result = swarmssm(*[a.format(flock=flock_file, run=run_folder) for a in arguments])
    assert result.status == 1, result
    assert "No space left" in result.err
    assert "Traceback" not in result.err
    left = [path.name for path in full_disk.rglob("*") if path.is_file()]
    assert [name for name in left if name.startswith("o") or ".part" in name] == []


def test_debug_shows_the_traceback_before_the_sentence(swarmssm):
    told = swarmssm("--debug", "info", "absent.nc")
    assert told.status == 2
    assert "Traceback" in told.err
    assert told.err.splitlines()[-1].startswith("swarmssm: absent.nc")
    assert "Traceback" not in swarmssm("info", "absent.nc").err
