"""``swarmssm check``: a file, pictures, a table and a sentence; mistakes leave nothing behind."""

import json

import pytest
import xarray as xr

QUICK = ("--draws", 10, "--steps", 5)


def test_it_writes_data_and_pictures_and_says_what_it_found(
    swarmssm, flock_file, run_folder, tmp_path
):
    result = swarmssm(
        *("check", run_folder, flock_file, "--out", "c.nc", *QUICK),
        *("--statistics", "amd,speed", "--figure", "o.png", "--sheet", "s.pdf"),
    )
    assert result.status == 0, result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.nc", "o.png", "s.pdf"]
    assert (tmp_path / "o.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "s.pdf").read_bytes().startswith(b"%PDF")
    for text in (
        "amd",
        "speed",
        "p, adjusted",
        "in 2 statistics",
        "10 swarms simulated",
        "c.nc: written",
    ):
        assert text in result.out
    assert "simulating: 10 of 10" in result.err
    with xr.open_dataset(tmp_path / "c.nc") as found:
        assert found["statistic"].values.tolist() == ["amd", "speed"]
        assert found.sizes["draw"] == 10
        assert found.attrs["steps"] == 5


def test_json_and_a_function_of_ones_own(swarmssm, flock_file, run_folder, tmp_path):
    (tmp_path / "mine.py").write_text("def fastest(swarm):\n    return swarm.speed.max()\n")
    result = swarmssm(
        *("check", run_folder, flock_file, "--out", "c.nc", *QUICK, "--seed", 4),
        *("--statistics", "mine:fastest, amd", "--format", "json", "--part", "train"),
    )
    assert result.status == 0, result.err
    told = json.loads(result.out)
    assert {row["statistic"] for row in told["statistics"]} == {"fastest", "amd"}
    assert all(row["verdict"] for row in told["statistics"])
    assert (told["settings"]["part"], told["settings"]["seed"]) == ("train", 4)
    assert any("trained on" in note for note in told["notes"])


MISTAKES = {
    "no run": (["absent", "{flock}"], "absent"),
    "no tracks": (["{run}", "absent.nc"], "absent.nc"),
    "unknown statistic": (["{run}", "{flock}", "--statistics", "amd,souls"], "souls"),
    "no such module": (["{run}", "{flock}", "--statistics", "nobody:home"], "nobody"),
    "too few draws": (["{run}", "{flock}", "--draws", "3"], "draws"),
    "too many steps": (["{run}", "{flock}", "--steps", "9999"], "steps"),
    "unknown part": (["{run}", "{flock}", "--part", "last"], "part"),
    "no walls": (["{run}", "{flock}", "--statistics", "wall_angle"], "no walls are known"),
    "unknown walls": (["{run}", "{flock}", "--walls", "brick"], "walls"),
    "no picture": (["{run}", "{flock}", "--figure", "o.doc"], ".png"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_and_leaves_nothing(swarmssm, flock_file, run_folder, tmp_path, name):
    arguments, fragment = MISTAKES[name]
    filled = [a.format(run=run_folder, flock=flock_file) for a in arguments]
    result = swarmssm("check", *filled, "--out", "c.nc")
    assert result.status == 2, result
    assert fragment in result.err
    assert "Traceback" not in result.err
    assert not list(tmp_path.iterdir())
