"""``swarmssm sbc`` and ``swarmssm recovery``: tiny studies, resuming, invalid input."""

import json

import pytest
import xarray as xr

from swarmssm.analysis.diagnostics.sbc import study

SMALL = ("--set", "frames=5", "--set", "individuals=2", "--set", "trials=1")
HELD = (
    *("--model", "linear", "--set", "priors.cohesion_gain=Normal(1,0.2)"),
    *("--set", "priors.alignment_gain=Normal(1,0.2)"),
)


def test_calibration_is_written_and_said(swarmssm, tmp_path):
    done = swarmssm("sbc", *HELD, *SMALL, "--datasets", 2, "--set", "draws=19", "--out", "sbc.nc")
    assert done.status == 0, done.err
    assert "2 of 2 data sets" in done.err
    assert "cohesion_gain" in done.out
    assert "over 2 data sets" in done.out
    assert "sbc.nc, sbc.png: written" in done.out
    with xr.open_dataset(tmp_path / "sbc.nc") as found:
        assert dict(found.sizes)["dataset"] == 2
        assert found.attrs["draws"] == 19
        assert json.loads(found.attrs["settings"])["individuals"] == 2
    assert (tmp_path / "sbc.png").read_bytes().startswith(b"\x89PNG")
    lines = (tmp_path / "sbc.jsonl").read_text().splitlines()
    assert len(lines) == 3

    again = swarmssm("sbc", *HELD, *SMALL, "--datasets", 2, "--set", "draws=19", "--out", "sbc.nc")
    assert again.status == 2
    assert "exists already" in again.err

    # One data set more than at first.
    more = swarmssm(
        *("sbc", *HELD, *SMALL, "--datasets", 3, "--set", "draws=19", "--out", "sbc.nc"),
        *("--resume", "--format", "json", "--figure", "sbc.svg"),
    )
    assert more.status == 0, more.err
    assert "2 of 3 data sets" in more.err
    assert "3 of 3 data sets" in more.err
    table = json.loads(more.out)
    assert {row["parameter"] for row in table["calibration"]} >= {"transition.cohesion_gain"}
    assert "over 3 data sets" in table["verdict"]
    now = (tmp_path / "sbc.jsonl").read_text().splitlines()
    assert now[:3] == lines
    assert len(now) == 4
    assert "<svg" in (tmp_path / "sbc.svg").read_text()

    other = swarmssm(
        *("sbc", *HELD, *SMALL, "--datasets", 3, "--set", "draws=20", "--out", "sbc.nc"),
        "--resume",
    )
    assert other.status == 2
    assert "other settings (draws)" in other.err


def test_what_was_begun_is_not_lost(swarmssm, tmp_path):
    (tmp_path / "sbc.jsonl").write_text('{"settings": {}}\n')
    begun = swarmssm("sbc", *HELD, *SMALL, "--datasets", 1, "--out", "sbc.nc")
    assert begun.status == 2
    assert "--resume" in begun.err
    assert (tmp_path / "sbc.jsonl").read_text() == '{"settings": {}}\n'


def test_interrupted_by_hand(swarmssm, tmp_path, monkeypatch):

    def stop(self, index):
        if index == 1:
            raise KeyboardInterrupt
        names = ("truth", "rank", "mean", "sd", "low", "high")
        return {**{name: {"gain": 1} for name in names}, "seconds": 0.1}

    monkeypatch.setattr(study._Calibrate, "__call__", stop)
    call = ("sbc", *HELD, *SMALL, "--datasets", 2, "--out", "sbc.nc")
    stopped = swarmssm(*call)
    assert stopped.status == 1
    assert "interrupted" in stopped.err
    assert "sbc.jsonl; continue with --resume." in stopped.err
    assert len((tmp_path / "sbc.jsonl").read_text().splitlines()) == 2
    assert not (tmp_path / "sbc.nc").exists()
    monkeypatch.setattr(
        study._Calibrate,
        "__call__",
        lambda self, index: stop(self, 0),
    )
    done = swarmssm(*call, "--resume")
    assert done.status == 0, done.err
    assert "1 of 2 data sets" in done.err


def test_interrupted_before_anything_was_finished(swarmssm, tmp_path, monkeypatch):

    def stop(self, index):
        raise KeyboardInterrupt

    monkeypatch.setattr(study._Calibrate, "__call__", stop)
    call = ("sbc", *HELD, *SMALL, "--datasets", 2, "--out", "sbc.nc")
    stopped = swarmssm(*call)
    assert stopped.status == 1
    assert "interrupted. No data set was finished." in stopped.err
    assert not list(tmp_path.iterdir())

    # A study that was to be begun anew is still the old one.
    old = '{"settings": {}}\n{"index": 0}\n'
    (tmp_path / "sbc.jsonl").write_text(old)
    again = swarmssm(*call, "--overwrite")
    assert again.status == 1
    assert "No data set was finished." in again.err
    assert [path.name for path in tmp_path.iterdir()] == ["sbc.jsonl"]
    assert (tmp_path / "sbc.jsonl").read_text() == old


@pytest.mark.slow
def test_recovery_like_a_file(swarmssm, tmp_path):
    made = swarmssm(
        *("simulate", "boids", "--individuals", 2, "--steps", 12, "--trials", 1),
        *("--observation-noise", 0.05, "--out", "mine.nc"),
    )
    assert made.status == 0, made.err
    done = swarmssm(
        *("recovery", "mine.nc", "--model", "linear", "--datasets", 1, "--factor", "frames=8"),
        *("--set", "values.cohesion_gain=0.5", "--set", "values.damping=0.5"),
        *("--set", "values.alignment_gain=0.5", "--set", "graph=complete"),
        *("--out", "recovery.nc"),
    )
    assert done.status == 0, done.err
    assert "frames 8" in done.out
    assert "within tolerance at" in done.out
    assert "1 x 12 frames of 2 individuals" in done.out
    with xr.open_dataset(tmp_path / "recovery.nc") as found:
        assert found["frames"].values.tolist() == [12, 8]
        gain = found["truth"].sel(parameter="transition.cohesion_gain")
        assert gain.values.tolist() == [[0.5], [0.5]]
        # The noise is that which the file has, as far as so short tracks tell.
        assert 0.02 < float(found["noise"][0]) < 0.12
        assert found.attrs["tolerance"] == 0.1
    assert (tmp_path / "recovery.png").exists()


@pytest.mark.slow
def test_like_a_run_at_what_it_found(swarmssm, tmp_path):
    swarmssm(
        *("simulate", "boids", "--individuals", 2, "--steps", 10, "--trials", 1),
        *("--observation-noise", 0.05, "--out", "mine.nc"),
    )
    fitted = swarmssm(
        *("fit", "mine.nc", "--model", "linear", "--out", "run", "--graph", "complete"),
        *("--prior", "damping=LogNormal(-1,0.001)", "--set", "fractions=[1,0,0]"),
    )
    assert fitted.status == 0, fitted.err
    done = swarmssm(
        *("recovery", "mine.nc", "--run", "run", "--datasets", 1, "--factor", "noise=0.1"),
        *("--set", "frames=5", "--out", "recovery.nc"),
    )
    assert done.status == 0, done.err
    with xr.open_dataset(tmp_path / "recovery.nc") as found:
        told = json.loads(found.attrs["settings"])
        assert told["model"] == "linear"
        assert told["fit"]["priors"] == {"damping": "LogNormal(-1,0.001)"}
        # exp(-1) = 0.3679, and a prior as narrow as this leaves nothing to learn.
        damping = found["truth"].sel(parameter="transition.damping").values
        assert damping == pytest.approx(0.3679, abs=0.002)
    for mixed in (["--model", "boids"], ["--set", "priors.damping=1"], ["--set", "window=5"]):
        refused = swarmssm("sbc", "--run", "run", *mixed, "--out", "other.nc")
        assert refused.status == 2
        assert "the run determines it" in refused.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("sbc --model graph-vae", "no state-space model"),
        ("sbc --model graph-ssm", "weights without a prior"),
        ("sbc --model nothing", "nothing"),
        ("sbc --set guide=nothing", "nothing"),
        ("sbc --datasets 0", "datasets"),
        ("sbc --set frames=-1", "frames"),
        ("sbc --set individuals=many", "individuals"),
        ("sbc --processes 0", "processes"),
        ("sbc --set draws=0", "draws"),
        ("sbc --set spread=-1", "spread"),
        ("sbc --set draws", "not of the form name=value"),
        ("sbc --set priors.charm=Normal(0,1)", "charm"),
        ("sbc --set weather=1", "weather"),
        ("sbc --figure sbc.txt", ".png"),
        ("sbc --run nowhere", "nowhere"),
        ("sbc nowhere.nc", "nowhere.nc"),
        ("recovery --factor weather=1", "there is no weather"),
        ("recovery --factor frames=many", "frames=many"),
        ("recovery --factor frames=10 --factor noise", "for none"),
        ("recovery --set values.charm=1", "charm"),
        ("recovery --set values.damping=big", "must be a number"),
        ("recovery --set noise=0", "noise"),
        ("recovery --set tolerance=0", "tolerance"),
    ],
)
def test_a_mistake_is_named_and_leaves_nothing(swarmssm, tmp_path, arguments, message):
    model = () if "--model" in arguments or "--run" in arguments else ("--model", "linear")
    failed = swarmssm(*arguments.split(), *model, "--out", "sbc.nc")
    assert failed.status == 2
    assert message in failed.err
    assert "Traceback" not in failed.err
    assert not list(tmp_path.iterdir())
