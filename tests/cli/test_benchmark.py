"""``swarmssm benchmark`` as a user calls it."""

import json

import pandas as pd
import pytest

QUICK = ("--horizons", "1,5", "--origins", "5", "--free-run-steps", "10")


def test_a_table_is_made_and_grows(swarmssm, flock_file, tmp_path):
    done = swarmssm("benchmark", flock_file, "--methods", "stay-put", *QUICK, "--jobs", 2)
    assert done.status == 0
    assert "noise-floor" in done.out
    table = pd.read_csv(tmp_path / "table.csv", index_col="method")
    assert table.index[0] == "noise-floor"
    # Of the fits of the tracks the true rule is best; what it leaves is noise.
    assert table.loc["noise-floor", "mse"] < table["mse"].drop("noise-floor").min()
    assert {path.name for path in tmp_path.glob("table.*")} == {
        "table.csv",
        "table.html",
        "table.md",
        "table.parts",
        "table.png",
    }

    refused = swarmssm("benchmark", flock_file, "--methods", "stay-put", *QUICK)
    assert refused.status == 2
    assert "table.csv" in refused.err

    grown = swarmssm(
        "benchmark", flock_file, "--methods", "ar1,stay-put", *QUICK, "--resume", "--format", "json"
    )
    assert grown.status == 0
    rows = {row["method"]: row for row in json.loads(grown.out)}
    assert set(rows) == {"noise-floor", "ar1", "stay-put"}
    assert rows["stay-put"]["mse"] == pytest.approx(table.loc["stay-put", "mse"])


def test_what_there_is_can_be_listed(swarmssm):
    datasets, methods = (swarmssm("benchmark", f"--{x}", "list") for x in ("dataset", "methods"))
    assert datasets.status == methods.status == 0
    assert "zebrafish100" in datasets.out
    assert "dygrencoder" in methods.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "give either a FILE of tracks or --dataset NAME"),
        (("--dataset", "boids", "x.nc"), "give either a FILE"),
        (("--dataset", "bees"), "dataset: 'bees' is unknown"),
        (("--dataset", "goats", "--data", "nowhere"), "the recording goats is not there"),
        (("x.nc",), "x.nc"),
        (("x.nc", "--budget", "soon"), "--budget: 'soon' is no time; write 90s"),
        (("x.nc", "--methods", "magic"), "methods: 'magic' is unknown"),
        (("x.nc", "--horizons", "1;5"), "--horizons"),
        (("x.nc", "--out", "table.txt"), "must end in .csv"),
    ],
)
def test_mistakes_are_told(swarmssm, arguments, said):
    done = swarmssm("benchmark", *arguments)
    assert done.status == 2
    assert said in " ".join(done.err.split())
