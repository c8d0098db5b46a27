"""``fit --config``, the listing of models, and how errors name arguments."""

import json

import pytest

from swarmssm.cli.app import as_options


def settings_of(folder):
    return json.loads((folder / "config.json").read_text())["settings"]


def test_settings_come_from_a_file_and_the_command_line_overrides_it(
    swarmssm, flock_file, tmp_path
):
    (tmp_path / "fit.toml").write_text(
        'model = "linear"\nguide = "parameters"\nsteps = 3\nlr = 0.02\nwindow = 10\ngap = 2\n'
        '[model_options]\nobserved = "states"\nhoming = true\n[priors]\ndamping = 0.5\n'
    )
    options = ("--config", "fit.toml", "--lr", "0.005", "--model-option", "homing=false")
    done = swarmssm("fit", flock_file, *options, "--out", "run")
    assert done.status == 0, done.err
    found = settings_of(tmp_path / "run")
    assert (found["model"], found["guide"], found["steps"]) == ("linear", "parameters", 3)
    assert (found["lr"], found["window"], found["gap"]) == (0.005, 10, 2)
    assert found["model_options"] == {"observed": "states", "homing": False}
    assert found["priors"] == {"damping": 0.5}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('model = "boids"\ncolour = 3\n', "fit.toml, line 2: colour: there is no such setting"),
        ('\n\nsteps = "many"\n', "fit.toml, line 3: steps: "),
        ("steps = 3\nsteps = 4\n", "at line 2"),
        ("steps: 3\n", "fit.toml: it is not TOML"),
        ("seed = 1\n[priors]\ngain = true\npull = {a = 1}\n", "fit.toml, line 4: priors.pull"),
        (None, "fit.toml: it cannot be read"),
    ],
)
def test_a_mistake_in_the_file_is_named_with_its_line(
    swarmssm, flock_file, tmp_path, text, sentence
):
    if text is not None:
        (tmp_path / "fit.toml").write_text(text)
    done = swarmssm("fit", flock_file, "--config", "fit.toml", "--out", "run")
    assert done.status == 2
    assert sentence in done.err
    assert not (tmp_path / "run").exists()


def test_models_are_listed_and_described(swarmssm, flock_file):
    listed = swarmssm("models").out
    for name in ("boids", "kernel", "graph-vae", "linearized", "markov"):
        assert name in listed
    shown = swarmssm("models", "linear", "--for", flock_file).out
    assert "homing" in shown
    assert "transition.cohesion_gain" in shown
    assert "--guide-option" in swarmssm("models", "markov").out
    assert swarmssm("models", "lineal").status == 2


def test_arguments_in_errors_become_options():
    assert as_options("add fps=... now") == "add --fps now"
    assert as_options("with fps=25.") == "with --fps 25."
    assert as_options('add empty="drop".') == "add --empty drop."
    assert as_options("add allow_pickle=True.") == "add --allow-pickle."
    assert as_options("boids cannot be built with loc=[0]") == "boids cannot be built with loc=[0]"


def test_debug_shows_the_traceback(swarmssm):
    plain, full = swarmssm("info", "no.nc"), swarmssm("--debug", "info", "no.nc")
    assert plain.status == full.status == 2
    assert "Traceback" not in plain.err
    assert "Traceback" in full.err
