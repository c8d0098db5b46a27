"""Tables from measurements that are made up."""

import math

import numpy as np
import pytest

from swarmssm.benchmark import (
    Job,
    Measured,
    benchmark_page,
    collect,
    make_task,
    markdown,
    write_results,
)
from swarmssm.benchmark.measurements import CachedResult
from swarmssm.benchmark.thesis_tables import thesis_table

from .conftest import straight


@pytest.fixture(scope="module")
def task():
    return make_task(straight(400), title="lines", origins=60, horizons=(1, 10))


def measured(task, error, *, oracle=False, crps=1.0, **more):
    trials, _ = task.forecast_origins
    shape = (len(trials), len(task.steps), 3)
    facts = {"title": "x", "knows_true_form": oracle, "parameters": 3, "mse": error, "mae": error}
    for k in task.steps:
        facts |= {f"roll_{k}": k * error, f"crps_{k}": crps, f"log_score_{k}": -crps}
        facts |= {f"coverage_{k}": 0.9}
    facts |= {"amd_true": 1.5, "avd_true": 0.25}
    facts |= {"unscored": 0.0, "train_s": 2.0, **more}
    noise = np.random.default_rng(0).normal(size=shape)
    return Measured(facts, crps + 0.01 * noise, -crps + 0.0 * noise, np.arange(1, 11) * error)


@pytest.fixture(scope="module")
def results(task):
    parts = {
        Job("lstm", 0): CachedResult(measured(task, 1.0, crps=4.0), ""),
        Job("lstm", 1): CachedResult(measured(task, 3.0, crps=6.0), ""),
        Job("graph-vae", 0): CachedResult(measured(task, 7.0, crps=8.0, amd=2.0, avd=0.5), ""),
        Job("stay-put", 0): CachedResult(measured(task, 5.0, crps=9.0), ""),
        Job("kernel", 0): CachedResult(measured(task, 1.5, crps=3.0), ""),
        Job("boids", 0): CachedResult(measured(task, 0.5, crps=0.5, oracle=True), ""),
        Job("sindy-pi", 0): CachedResult(None, "It | failed."),
        Job("noise-floor", 0): CachedResult(measured(task, 1.0, oracle=True), ""),
    }
    return collect(task, parts)


def test_seeds_become_a_mean_and_a_spread(results):
    row = results.rows["lstm"]
    assert row["mse"] == 2.0
    assert row["mse_sd"] == pytest.approx(math.sqrt(2.0))
    assert row["seeds"] == 2
    assert math.isnan(results.rows["kernel"]["mse_sd"])
    np.testing.assert_allclose(results.errors.sel(model="lstm"), 2.0 * np.arange(1, 11))


def test_the_floor_is_on_top_and_who_failed_at_the_bottom(results):
    names = list(results.rows)
    assert names == ["noise-floor", "boids", "kernel", "lstm", "stay-put", "graph-vae", "sindy-pi"]
    assert list(results.summary().index) == names
    assert results.summary().loc["sindy-pi", "failed"] == "It | failed."


def test_people_read_the_same(results):
    rows = {row["method"]: row for row in results.shown_rows()}
    assert rows["boids (oracle)"]["MSE (4.2)"] == "0.500"
    assert rows["lstm"]["MSE (4.2)"] == "2.00 ± 1.4"
    assert rows["lstm"]["training, CPU s"] == "2.00 ± 0"
    assert rows["sindy-pi"]["note"] == "It | failed."
    assert rows["sindy-pi"]["MSE (4.2)"] == "–"
    assert len({tuple(row) for row in results.shown_rows()}) == 1


def test_oracles_do_not_lead(results):
    text = markdown(results)
    assert "at 10 steps kernel leads lstm (+40 %, from +40 to +40 %)" in text
    assert "at one step kernel with 1.500 times its error" in text
    assert "boids leads" not in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    # Of all methods, and of the thesis's three.
    assert len({line.count("|") for line in lines}) == 2


def test_the_thesiss_table_is_done_again(results, task):
    caption, rows = thesis_table(results)
    assert "Table I (guppies)" in caption
    assert "AMD is 1.50 and AVD 0.250" in caption
    assert [row["method"] for row in rows] == ["graph-vae", "dygrencoder-direct", "dcrnn-direct"]
    assert rows[0]["MSE (4.2)"] == "7.00"
    assert rows[0]["AMD (4.4), printed"] == "0.960"
    assert rows[1]["MSE (4.2)"] == "–"
    assert caption in markdown(results)
    assert caption in benchmark_page(results).html()
    alone = collect(task, {Job("lstm", 0): CachedResult(measured(task, 1.0), "")})
    assert thesis_table(alone) == ("", [])


def test_files_stand_beside_each_other(results, tmp_path):
    paths = write_results(results, tmp_path / "t.csv")
    assert [path.suffix for path in paths] == [".csv", ".md", ".html", ".png"]
    assert all(path.stat().st_size > 500 for path in paths)
    page = benchmark_page(results).html()
    assert "http:" not in page.replace("http://www.w3.org", "")
    assert "https:" not in page
    assert "boids (oracle)" in page


def test_a_table_of_failures_can_be_written(task, tmp_path):
    results = collect(
        task, {Job("lstm", 0): CachedResult(None, "No."), Job("ar1", 0): CachedResult(None, "No.")}
    )
    text = markdown(results)
    assert "2 methods, of which 2 failed" in text
    write_results(results, tmp_path / "t.csv")
