"""Each subcommand does its work: files appear, and hold what was asked for."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from swarmssm import io

#: A report of forecasts alone.
BRIEF = ("--checks", 0, "--no-forces", "--no-player")


def test_simulate_writes_the_same_tracks_for_the_same_seed(swarmssm, tmp_path):
    options = ("--individuals", 4, "--steps", 30, "--trials", 2, "--seed", 5)
    assert swarmssm("simulate", "boids", *options, "--out", "a.nc").status == 0
    assert swarmssm("simulate", "boids", *options, "--out", "b.nc").status == 0
    first, second = (io.read(tmp_path / name) for name in ("a.nc", "b.nc"))
    assert first["position"].shape == (2, 30, 2, 4)
    np.testing.assert_array_equal(first["position"], second["position"])
    assert {"force", "next_position", "next_velocity", "adjacency"} <= set(first)


def test_simulate_passes_every_option_on(swarmssm, tmp_path):
    result = swarmssm(
        "simulate",
        "boids",
        "--out",
        "n.nc",
        "--steps",
        20,
        "--observation-noise",
        0.25,
        "--process-noise",
        0,
        "--radius",
        2,
        "--dt",
        0.5,
        "--set",
        "wall_gain=0",
        "--set",
        "noise=additive",
    )
    assert result.status == 0, result.err
    tracks = io.read(tmp_path / "n.nc")
    told = json.loads(tracks.attrs["simulation"])
    assert tracks.attrs["fps"] == 2.0
    assert "velocity" not in tracks
    error = (tracks["position"] - tracks["true_position"]).to_numpy()
    # 400 draws of a normal: their sd lies within 6 standard errors of 0.25.
    assert abs(error.std() - 0.25) < 6 * 0.25 / np.sqrt(2 * error.size)
    assert told["wall_gain"] == 0


@pytest.mark.parametrize("model", ["vicsek", "couzin"])
def test_the_other_simulators(swarmssm, tmp_path, model):
    options = ("--individuals", 6, "--steps", 15, "--trials", 2)
    result = swarmssm("simulate", model, *options, "--out", "v.nc")
    assert result.status == 0, result.err
    assert io.read(tmp_path / "v.nc").sizes["individual"] == 6


def test_import_names_the_file_after_its_source(swarmssm, tmp_path):
    rows = [["frame", "x1", "y1", "x2", "y2"], *([t, t, 0, 0, 2 * t] for t in range(5))]
    with (tmp_path / "fish.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    result = swarmssm("import", "fish.csv", "--fps", 4, "--unit", "cm")
    assert result.status == 0, result.err
    tracks = io.read(tmp_path / "fish.nc")
    assert tracks.attrs["unit"] == "cm"
    np.testing.assert_array_equal(tracks["time"], np.arange(5) / 4)
    np.testing.assert_array_equal(tracks["position"][3], [[3, 0], [0, 6]])


def test_import_explains_a_csv_without_y(swarmssm, shared_data):
    result = swarmssm("import", shared_data / "guppies_trex8" / "trex_csv")
    assert result.status == 2
    assert "test_fish0.csv" in result.err
    assert "no Y" in result.err
    assert "output_fields" in result.err


def test_info_tells_what_is_known(swarmssm, flock_file):
    text = swarmssm("info", flock_file)
    assert text.status == 0
    assert "60 at 10 per second" in text.out
    table = json.loads(swarmssm("info", flock_file, "--format", "json").out)
    assert table["individuals"] == 5
    assert table["trials"] == 3
    assert table["observed"] == 1.0
    assert table["gaps"] == 0
    assert table["truth"] == ["force", "next_position", "next_velocity"]


def test_fit_writes_a_run_that_holds_its_settings(swarmssm, flock_file, tmp_path):
    result = swarmssm(
        "fit",
        flock_file,
        "--out",
        "run",
        "--model",
        "graph-vae",
        "--steps",
        5,
        "--seed",
        3,
        "--graph",
        "k-nearest:2",
        "--batch-windows",
        0,
        "--window",
        0,
        "--guide-option",
        "rounds=2",
        "--model-option",
        "decoder_widths=[8]",
        "--set",
        "gap=1",
        "--split-by",
        "time",
    )
    assert result.status == 0, result.err
    settings = json.loads((tmp_path / "run" / "config.json").read_text())["settings"]
    expected = {
        "steps": 5,
        "seed": 3,
        "graph": "k-nearest:2",
        "batch_windows": None,
        "window": None,
        "guide_options": {"rounds": 2},
        "model_options": {"decoder_widths": [8]},
        "gap": 1,
    }
    assert {name: settings[name] for name in expected} == expected
    names = sorted(path.name for path in (tmp_path / "run").iterdir())
    assert names == ["config.json", "history.csv", "provenance.json", "weights.safetensors"]


def test_evaluate_writes_scores_of_all_methods(swarmssm, run_folder, flock_file, tmp_path):
    result = swarmssm(
        "evaluate", run_folder, flock_file, "--horizons", "1,3", "--out", "scores.json"
    )
    assert result.status == 0, result.err
    scores = json.loads((tmp_path / "scores.json").read_text())
    text = json.dumps(scores)
    assert "constant velocity" in text.lower().replace("_", " ").replace("-", " ")
    assert "NaN" not in text
    printed = swarmssm("evaluate", run_folder, flock_file, "--horizons", "1,3", "--format", "json")
    assert json.loads(printed.out) == scores


def test_forecast_uses_nothing_after_until(swarmssm, run_folder, flock_file, tmp_path):
    changed = io.read(flock_file)
    position = changed["position"].copy()
    position[{"time": slice(40, None)}] += 1.0
    io.write(changed.assign(position=position), tmp_path / "changed.nc")
    for name, file in (("a", flock_file), ("b", tmp_path / "changed.nc")):
        result = swarmssm(
            "forecast",
            run_folder,
            file,
            "--until",
            3.9,
            "--horizon",
            4,
            "--draws",
            3,
            "--out",
            f"{name}.nc",
        )
        assert result.status == 0, result.err
    with xr.open_dataset(tmp_path / "a.nc") as first, xr.open_dataset(tmp_path / "b.nc") as second:
        assert first["position"].dims == ("draw", "trial", "time", "space", "individual")
        assert first["position"].shape == (3, 3, 4, 2, 5)
        np.testing.assert_allclose(first["time"], [4.0, 4.1, 4.2, 4.3])
        np.testing.assert_array_equal(first["position"], second["position"])


def test_rollout_writes_tracks_that_start_where_it_was_told(
    swarmssm, run_folder, flock_file, tmp_path
):
    result = swarmssm(
        "rollout",
        run_folder,
        flock_file,
        "--steps",
        12,
        "--draws",
        2,
        "--until",
        2,
        "--out",
        "r.nc",
    )
    assert result.status == 0, result.err
    free, source = io.read(tmp_path / "r.nc"), io.read(flock_file)
    assert free.sizes["time"] == 13
    assert free.sizes["trial"] == 6
    start = source["position"].isel(time=20).to_numpy()
    np.testing.assert_allclose(free["position"].isel(time=0)[:3], start, rtol=1e-12)
    assert swarmssm("info", "r.nc").status == 0


def test_report_finds_its_data_and_refuses_other(swarmssm, run_folder, flock_file, tmp_path):
    few = ("--checks", 10, "--no-forces", "--no-player")
    result = swarmssm("report", run_folder, "--out", "r.html", *few)
    assert result.status == 0, result.err
    page = (tmp_path / "r.html").read_text()
    assert page.lstrip().lower().startswith("<!doctype html>")
    assert "graph-vae" in page
    assert swarmssm("simulate", "boids", "--steps", 30, "--out", "other.nc").status == 0
    refused = swarmssm("report", run_folder, "--data", "other.nc", "--out", "s.html")
    assert refused.status == 2
    assert "not the tracks" in refused.err


def test_report_asks_for_data_that_have_gone(swarmssm, run_folder, flock_file, tmp_path):
    shutil.copy(flock_file, tmp_path / "moved.nc")
    assert (
        swarmssm("fit", "moved.nc", "--model", "graph-vae", "--out", "run", "--epochs", 2).status
        == 0
    )
    Path("moved.nc").rename("elsewhere.nc")
    refused = swarmssm("report", "run", "--out", "r.html")
    assert refused.status == 2
    assert "--data" in refused.err
    assert (
        swarmssm("report", "run", "--data", "elsewhere.nc", "--out", "r.html", *BRIEF).status == 0
    )


def test_help_and_version_name_every_command(swarmssm):
    page = swarmssm("--help")
    assert page.status == 0
    for name in ("demo", "simulate", "import", "info", "fit", "evaluate", "forecast", "rollout"):
        assert name in page.out
    assert swarmssm("--version").out.startswith("swarmssm ")


@pytest.mark.slow
def test_the_demo_ends_in_a_report(swarmssm, tmp_path):
    result = swarmssm("demo", "--epochs", 2)
    assert result.status == 0, result.err
    assert (tmp_path / "demo" / "report.html").stat().st_size > 100_000
    assert swarmssm("demo", "--epochs", 2).status == 2
    assert swarmssm("demo", "--epochs", 2, "--overwrite").status == 0
