"""State-space models from the command line: fit, posterior, forecast, mistakes."""

import re

import pytest
import xarray as xr


@pytest.fixture
def noisy(swarmssm):
    made = swarmssm(
        *("simulate", "boids", "--individuals", 4, "--steps", 60, "--trials", 2),
        *("--observation-noise", 0.03, "--out", "noisy.nc"),
    )
    assert made.status == 0, made.err
    return "noisy.nc"


def test_fit_prints_the_posterior_of_named_parameters(swarmssm, noisy, tmp_path):
    fitted = swarmssm(
        *("fit", noisy, "--model", "linear", "--guide", "linearized", "--out", "run"),
        *("--prior", "noise=LogNormal(-3.5, 0.001)"),
    )
    assert fitted.status == 0, fitted.err
    assert "linear with guide linearized" in fitted.out
    assert "90 % intervals" in fitted.out
    for name in ("cohesion_gain", "alignment_gain", "damping", "process_noise", "noise"):
        assert re.search(rf"\b{name}\b", fitted.out)
    # exp(-3.5) = 0.0302, and a prior as narrow as this leaves nothing to learn.
    assert re.search(r"\bnoise\b[^\n]*0\.0302[^\n]*0\.0301[^\n]*0\.0302", fitted.out)
    again = swarmssm("forecast", "run", noisy, "--horizon", 3, "--draws", 2, "--out", "next.nc")
    assert again.status == 0, again.err
    with xr.open_dataset(tmp_path / "next.nc") as future:
        assert dict(future.sizes)["time"] == 3
        assert bool(future["position"].notnull().all())


def test_the_usual_guide_is_taken(swarmssm, noisy):
    fitted = swarmssm("fit", noisy, "--model", "graph-ssm", "--steps", 2, "--out", "run")
    assert fitted.status == 0, fitted.err
    assert "graph-ssm with guide markov" in fitted.out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--model", "boids", "--prior", "cohesion=LogNormal(0, 1)"], "cohesion"),
        (
            ["--model", "boids", "--prior", "cohesion_gain=eval('1')"],
            "eval is no known distribution",
        ),
        (["--model", "boids", "--prior", "cohesion_gain=Normal(0, 1)"], "cohesion_gain"),
        (["--model", "boids", "--prior", "cohesion_gain"], "not of the form name=value"),
        (["--model", "boids", "--guide", "markov"], "without hard limits"),
        (["--model", "graph-vae", "--guide", "markov"], "markov cannot be built"),
        (["--model", "graph-ssm", "--guide", "nobody"], "guide: 'nobody' is unknown"),
        (["--model", "graph-ssm", "--model-option", "width=0"], "width"),
        (["--model", "graph-ssm", "--scaler", "minmax"], "scaler"),
    ],
)
def test_a_mistake_is_named_and_leaves_nothing(swarmssm, noisy, tmp_path, arguments, sentence):
    failed = swarmssm("fit", noisy, "--out", "run", *arguments)
    assert failed.status == 2
    assert sentence in failed.err
    assert "Traceback" not in failed.err
    assert len(failed.err.strip().splitlines()) <= 2
    assert not (tmp_path / "run").exists()
