"""``swarmssm analyze``: a file, a page, a table; mistakes leave nothing behind."""

import html
import json

import pytest
import xarray as xr

from swarmssm.analysis.interpretation.result import Analysis

QUICK = ("--draws", 2, "--only", "forces,kernels,influence", "--no-scores")


def test_it_writes_data_and_page_and_prints_the_main_numbers(
    swarmssm, flock_file, run_folder, tmp_path
):
    result = swarmssm("analyze", run_folder, flock_file, "--out", "a.nc", *QUICK)
    assert result.status == 0, result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "a.nc"]
    for words in (
        "Neighbours make up",
        "share of cohesion",
        "neighbours",
        "influence",
        "interval",
        "a.html",
    ):
        assert words in result.out
    assert "analysing forces" in result.err
    found = Analysis.read(tmp_path / "a.nc")
    assert set(found.datasets) == {"forces", "kernels", "influence"}
    assert found.settings["draws"] == 2
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "Analysis: graph-vae on" in page
    assert found.verdict() in html.unescape(page)


def test_json_and_options_and_the_name_of_the_page(swarmssm, flock_file, run_folder, tmp_path):
    result = swarmssm(
        *("analyze", run_folder, flock_file, "--out", "a.nc", "--report", "other.html"),
        *("--only", "force_maps", "--set", "force_maps.bins=5", "--draws", 1, "--format", "json"),
        *("--part", "train", "--seed", 3, "--no-scores"),
    )
    assert result.status == 0, result.err
    told = json.loads(result.out)
    assert told["settings"]["options"] == {"force_maps": {"bins": 5}}
    assert told["settings"]["part"] == "train"
    assert told["settings"]["seed"] == 3
    assert {row["analysis"] for row in told["summary"]} == {"force maps"}
    assert "Forecasts were not scored" in told["verdict"]
    assert (tmp_path / "other.html").exists()
    assert not (tmp_path / "a.html").exists()
    with xr.open_dataset(tmp_path / "a.nc", group="force_maps") as maps:
        assert maps.sizes["front_back"] == 5


def test_figures_for_a_paper_are_written(swarmssm, flock_file, run_folder, tmp_path):
    result = swarmssm(
        *("analyze", run_folder, flock_file, "--out", "a.nc", "--only", "forces", "--draws", 1),
        *("--no-scores", "--figures", "paper", "--figure-format", "svg", "--width", "8.5cm"),
    )
    assert result.status == 0, result.err
    names = {path.name for path in (tmp_path / "paper").iterdir()}
    assert {"forces.csv", "methods.md"} <= names
    drawn = next(name for name in names if name.endswith(".svg"))
    # 85 mm are 240.9 points.
    assert 'width="240.9' in (tmp_path / "paper" / drawn).read_text()


MISTAKES = {
    "no width": (["{run}", "{flock}", "--figures", "d", "--width", "wide"], "85mm"),
    "width alone": (["{run}", "{flock}", "--width", "85mm"], "--figures"),
    "no run": (["absent", "{flock}"], "absent"),
    "no tracks": (["{run}", "absent.nc"], "absent.nc"),
    "unknown part": (["{run}", "{flock}", "--part", "last"], "part"),
    "unknown format": (["{run}", "{flock}", "--format", "xml"], "xml"),
    "zero draws": (["{run}", "{flock}", "--draws", "0"], "draws"),
    "bad seed": (["{run}", "{flock}", "--seed", "-1"], "seed"),
    "unknown analysis": (["{run}", "{flock}", "--only", "forces,souls"], "souls"),
    "no point": (["{run}", "{flock}", "--set", "bins=3"], "ANALYSIS.OPTION"),
    "no value": (["{run}", "{flock}", "--set", "force_maps.bins"], "name=value"),
    "unknown option": (["{run}", "{flock}", "--set", "force_maps.bin=3"], "bins"),
    "bad value": (
        ["{run}", "{flock}", "--only", "force_maps,forces", "--set", "force_maps.bins=abc"],
        "bins",
    ),
    "one file": (["{run}", "{flock}", "--report", "a.nc"], "cannot be one file"),
    "no folder": (["{run}", "{flock}", "--report", "none/a.html"], "none"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_and_leaves_nothing(swarmssm, flock_file, run_folder, tmp_path, name):
    arguments, fragment = MISTAKES[name]
    filled = [a.format(run=run_folder, flock=flock_file) for a in arguments]
    result = swarmssm("analyze", *filled, "--out", "a.nc")
    assert result.status == 2, result
    assert fragment in result.err
    assert "Traceback" not in result.err
    assert not list(tmp_path.iterdir())


def test_tracks_of_another_dimension_are_refused(swarmssm, run_folder, flock_file, tmp_path):
    from swarmssm import io

    tracks = io.read(flock_file)
    flat = tracks["position"]
    deep = xr.concat([flat, flat.isel(space=[0]).assign_coords(space=["z"])], "space")
    keep = {key: tracks.attrs[key] for key in ("fps", "time_unit")}
    io.write(
        xr.Dataset({"position": deep}, attrs=keep).drop_vars("neighbor", errors="ignore"),
        tmp_path / "deep.nc",
    )
    result = swarmssm("analyze", run_folder, "deep.nc", "--out", "a.nc")
    assert result.status == 2, result
    assert "Traceback" not in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["deep.nc"]


@pytest.mark.parametrize("kept", ["a.nc", "a.html"])
def test_what_exists_is_left_alone(swarmssm, flock_file, run_folder, tmp_path, kept):
    (tmp_path / kept).write_text("precious")
    result = swarmssm("analyze", run_folder, flock_file, "--out", "a.nc", *QUICK)
    assert result.status == 2
    assert kept in result.err
    assert (tmp_path / kept).read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == [kept]


def test_what_exists_is_replaced_when_asked(swarmssm, flock_file, run_folder, tmp_path):
    for kept in ("a.nc", "a.html"):
        (tmp_path / kept).write_text("precious")
    short = ("--draws", 1, "--only", "forces", "--overwrite", "--no-scores")
    result = swarmssm("analyze", run_folder, flock_file, "--out", "a.nc", *short)
    assert result.status == 0, result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "a.nc"]
    assert (tmp_path / "a.html").read_text(encoding="utf-8").startswith("<!")
    assert set(Analysis.read(tmp_path / "a.nc").datasets) == {"forces"}
