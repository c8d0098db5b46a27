"""A run folder gives the same numbers again, and cannot do anything else."""

import hashlib
import json
import os
import pickle
import pickletools
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch
import xarray as xr

import swarmssm
from swarmssm.errors import InputError
from swarmssm.inference import Fit, fit

FILES = ["config.json", "history.csv", "provenance.json", "weights.safetensors"]


@pytest.fixture(scope="module")
def saved(fitted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "run"
    fitted.save(folder)
    return folder


@pytest.fixture
def run(saved, tmp_path):
    """Return a copy that a test may spoil."""
    return Path(shutil.copytree(saved, tmp_path / "run"))


def seal(run):
    """Make the digests fit whatever was done to the files."""
    provenance = json.loads((run / "provenance.json").read_text())
    for name in provenance["files"]:
        provenance["files"][name] = hashlib.sha256((run / name).read_bytes()).hexdigest()
    (run / "provenance.json").write_text(json.dumps(provenance))


def change_config(run, change):
    """Alter the configuration and the digest with it, as a stranger would."""
    config = json.loads((run / "config.json").read_text())
    change(config)
    (run / "config.json").write_text(json.dumps(config))
    seal(run)


def test_it_holds_these_files(saved):
    assert sorted(os.listdir(saved)) == FILES


def test_the_same_numbers_bit_for_bit(fitted, saved, swarm):
    loaded = Fit.load(saved)
    for name in ("settings", "preparation", "split"):
        assert getattr(loaded, name) == getattr(fitted, name)
    assert loaded.history.equals(fitted.history)
    assert loaded.num_parameters == fitted.num_parameters > 1000
    for numbers in (
        lambda f: f.posterior(swarm, draws=3, seed=1),
        lambda f: f.predictive(swarm),
        lambda f: f.predictive(swarm, draws=2, seed=1),
        lambda f: f.forecast(swarm, 5, draws=3, seed=1),
        lambda f: f.forecast(swarm, 5, draws=3, seed=1, edges="rule"),
        lambda f: f.forecast(swarm, 5, draws=0),
        lambda f: f.rollout(swarm, 6, draws=2, seed=1),
    ):
        one, other = numbers(fitted), numbers(loaded)
        xr.testing.assert_identical(one, other)
        assert one.to_dict() != numbers_of_another(numbers, fitted).to_dict()


def numbers_of_another(numbers, fitted):
    """Return the same numbers of weights that differ a little: the judge is not blind."""
    state = {name: value.clone() for name, value in fitted.guide.state_dict().items()}
    try:
        with torch.no_grad():
            for parameter in fitted.guide.parameters():
                parameter.mul_(1.01)
        return numbers(fitted)
    finally:
        fitted.guide.load_state_dict(state)


def test_it_can_be_saved_and_loaded_again_and_again(saved, tmp_path, swarm):
    Fit.load(saved).save(tmp_path / "second")
    Fit.load(tmp_path / "second").save(tmp_path / "third")
    for name in FILES:
        assert (tmp_path / "third" / name).read_bytes() == (saved / name).read_bytes()


def test_it_tells_where_it_comes_from(fitted, swarm, brief, tmp_path):
    run = fit(tracks=swarm, source=tmp_path / "boids.nc", out=tmp_path / "run", **brief)
    told = json.loads((tmp_path / "run" / "provenance.json").read_text())
    assert told["versions"]["swarmssm"] == swarmssm.__version__
    assert told["versions"]["torch"] == torch.__version__
    assert told["data"]["file"] == str(tmp_path / "boids.nc")
    assert told["data"]["sha256"] == fitted.provenance["data"]["sha256"]
    assert told["files"].keys() == set(FILES) - {"provenance.json"}
    assert Fit.load(tmp_path / "run").provenance == told
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert config["settings"]["epochs"] == 3
    assert config["settings"]["lr"] == run.settings.lr == 0.005
    assert config["preparation"]["rule"] == {"kind": "radius", "radius": 2.5}
    assert config["split"]["test"] == [["0", 85, 100], ["1", 85, 100]]
    assert run.part(swarm, "test").sizes["time"] == 15
    with pytest.raises(InputError, match="there is no trial 0"):
        run.part(swarm.assign_coords(trial=["a", "b"]), "test")


def test_nothing_in_it_is_pickled(saved):
    weights = (saved / "weights.safetensors").read_bytes()
    length = int.from_bytes(weights[:8], "little")
    header = json.loads(weights[8 : 8 + length])
    names = set(header) - {"__metadata__"}
    assert {name.split(".")[0] for name in names} == {"model", "guide"}
    size = sum(end - start for start, end in (header[name]["data_offsets"] for name in names))
    assert 8 + length + size == len(weights)
    for name in FILES:
        with pytest.raises(ValueError):  # noqa: PT011 - whatever pickletools says
            list(pickletools.genops((saved / name).read_bytes()))
    for name in ("config.json", "provenance.json"):
        assert isinstance(json.loads((saved / name).read_text()), dict)
    (saved / "history.csv").read_bytes().decode("ascii")


def test_nothing_is_unpickled(fitted, tmp_path, monkeypatch):
    def fail(*_, **__):
        pytest.fail("something was pickled or unpickled")

    for module, name in ((torch, "load"), (torch, "save")):
        monkeypatch.setattr(module, name, fail)
    for name in ("load", "loads", "Unpickler", "dump", "dumps", "Pickler"):
        monkeypatch.setattr(pickle, name, fail)
    fitted.save(tmp_path / "run")
    Fit.load(tmp_path / "run")


@pytest.mark.parametrize("name", FILES)
def test_a_missing_file_is_named(run, name):
    (run / name).unlink()
    sentence = (
        "it is not a run folder; provenance.json is missing"
        if name == "provenance.json"
        else rf"{name}: this file of the run is missing\. Fit again, or copy it back"
    )
    with pytest.raises(InputError, match=sentence):
        Fit.load(run)


@pytest.mark.parametrize("name", FILES[:2] + FILES[3:])
@pytest.mark.parametrize("where", [0, 0.5, -1])
def test_an_altered_byte_is_noticed(run, name, where):
    path = run / name
    data = bytearray(path.read_bytes())
    place = int(where * len(data)) if where >= 0 else -1
    data[place] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match=f"{name}: it is not the file that the fit wrote"):
        Fit.load(run)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "nul", "\xff", '{"files": 3}', "[" * 10**5])
def test_provenance_that_is_none_is_said(run, text):
    (run / "provenance.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"provenance\.json|is not the file that the fit wrote"):
        Fit.load(run)


def test_each_byte_of_the_provenance_is_read_or_of_no_matter(run):
    """However one byte of it is altered, the same fit comes back, or a sentence."""
    path = run / "provenance.json"
    data = path.read_bytes()
    good = Fit.load(run)
    outcomes = set()
    for place in range(0, len(data), 7):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        try:
            other = Fit.load(run)
        except InputError:
            outcomes.add("refused")
            continue
        outcomes.add("loaded")
        assert other.settings == good.settings
        assert other.history.equals(good.history)
    assert outcomes == {"refused", "loaded"}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda c: c.pop("layout"), r"written by another version of swarmssm .* Fit again"),
        (lambda c: c.pop("settings"), "the table settings is missing"),
        (lambda c: c.update(settings=[]), "the table settings is missing"),
        (lambda c: c["settings"].update(lr="fast"), r"config\.json: lr: .*\(given: 'fast'\)"),
        (lambda c: c["settings"].update(speed=3), "speed: there is no such setting"),
        (lambda c: c.pop("preparation"), "the table preparation is missing"),
        (lambda c: c["preparation"].pop("scaler"), "cannot be understood"),
        (lambda c: c["preparation"]["scaler"].update(offset=["a"]), "cannot be understood"),
        (lambda c: c["preparation"].update(rule={"kind": "best"}), "kind 'best' is unknown"),
        (lambda c: c["split"].update(train=3), "split: each of train, validation and test"),
        (
            lambda c: c["settings"].update(model="no-such"),
            r"config\.json: model: 'no-such' is unknown",
        ),
        (
            lambda c: c["settings"].update(model_options={"latent_dim": 7}),
            r"weights\.safetensors: the weights do not fit the model graph-vae",
        ),
        (
            lambda c: c["settings"].update(guide_options={"widths": [9, 9, 9]}),
            "the weights do not fit the guide encoder",
        ),
        (
            lambda c: c["settings"].update(model_options={"latent_dim": -7}),
            r"config\.json: model: graph-vae cannot be built",
        ),
        (
            lambda c: c["scales"].update(space=3),
            r"config\.json: the scaler has 4 features, and the states of the tracks have 6",
        ),
        (lambda c: c["scales"].update(space="two"), "cannot be understood"),
        (lambda c: c["scales"].update(breadth=2.0), "cannot be understood"),
        (lambda c: c["scales"].pop("speed"), "cannot be understood"),
        (lambda c: c.pop("scales"), "the table scales is missing"),
        (
            lambda c: c["preparation"]["scaler"].update(offset=[0.0] * 6, scale=[1.0] * 6),
            r"config\.json: the scaler has 6 features, and the states of the tracks have 4",
        ),
        (lambda c: c["preparation"].update(observes="faces"), "cannot be understood"),
    ],
)
def test_a_configuration_that_does_not_fit_is_said(run, change, sentence):
    change_config(run, change)
    with pytest.raises(InputError, match=sentence) as caught:
        Fit.load(run)
    assert len(str(caught.value).splitlines()) == 1


def test_a_truncated_configuration_is_said(run):
    text = (run / "config.json").read_text()
    for cut in ("", text[:1], text[:-3], "[1]"):
        (run / "config.json").write_text(cut)
        seal(run)
        with pytest.raises(InputError, match=r"config\.json: it (is not readable|holds no) JSON"):
            Fit.load(run)


def test_damaged_weights_are_said(run):
    path = run / "weights.safetensors"
    data = path.read_bytes()
    for bad in (b"", data[:-4], data[:50], b"\xff" * 64, b"PK\x03\x04" + data):
        path.write_bytes(bad)
        seal(run)
        with pytest.raises(InputError, match=r"weights\.safetensors: the file is damaged"):
            Fit.load(run)
    path.write_bytes(safetensors.torch.save({"model.log_scale": torch.ones(4)}))
    seal(run)
    with pytest.raises(InputError, match="the weights do not fit the model"):
        Fit.load(run)


def test_a_damaged_history_is_said(run):
    for text in ("", "epoch,loss\n1,good\n", '"'):
        (run / "history.csv").write_text(text)
        seal(run)
        with pytest.raises(InputError, match=r"history\.csv cannot be understood"):
            Fit.load(run)


CODE = ["os:system", "subprocess:run", "builtins:eval", "this:s", "strange:Model"]


@pytest.mark.parametrize("part", ["model", "guide"])
@pytest.mark.parametrize("name", CODE)
def test_code_that_is_not_ours_is_not_imported(run, part, name, monkeypatch):
    """Neither a module that is installed, nor a file beside or in the folder."""
    for folder in (run, run.parent):
        (folder / "strange.py").write_text("import pathlib\npathlib.Path('ran').touch()\n")
    monkeypatch.chdir(run.parent)
    monkeypatch.delitem(sys.modules, "this", raising=False)
    change_config(run, lambda c: c["settings"].update({part: name}))
    before = set(sys.modules)
    with pytest.raises(InputError, match=f"the run names the code {name}, .*trust_code=True"):
        Fit.load(run)
    assert set(sys.modules) == before
    assert not (run.parent / "ran").exists()


def test_trust_is_asked_for_what_could_run(run):
    """With trust, a function that is no model fails in a sentence."""
    change_config(run, lambda c: c["settings"].update(model="builtins:repr"))
    with pytest.raises(InputError, match="model: builtins:repr built no torch module, but str"):
        Fit.load(run, trust_code=True)


def test_what_is_no_run_is_said(tmp_path, run):
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    (tmp_path / "begun" / "checkpoint").mkdir(parents=True)
    for name, sentence in (
        ("nowhere", "nowhere: there is no such run folder"),
        ("file", "file: there is no such run folder"),
        ("empty", "empty: it is not a run folder; provenance.json is missing"),
        ("begun", "begun: this fit is not finished"),
    ):
        with pytest.raises(InputError, match=sentence):
            Fit.load(tmp_path / name)


def test_what_may_be_overwritten(fitted, run, tmp_path, swarm):
    before = {name: (run / name).read_bytes() for name in FILES}
    with pytest.raises(InputError, match="run: exists already and was left as it is"):
        fitted.save(run)
    assert {name: (run / name).read_bytes() for name in FILES} == before
    # A run is replaced as a whole: what the old one left behind goes too.
    (run / "report.html").touch()
    fitted.save(run, overwrite=True)
    assert sorted(os.listdir(run)) == FILES
    (tmp_path / "empty").mkdir()
    fitted.save(tmp_path / "empty", overwrite=True)
    assert sorted(os.listdir(tmp_path / "empty")) == FILES
    # Whatever is no run stays.
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "config.json").write_text('{"title": "Swarms"}')
    (tmp_path / "file").touch()
    for name in ("thesis", "file"):
        with pytest.raises(InputError, match=f"{name}: it is not a run folder, and is not overwr"):
            fitted.save(tmp_path / name, overwrite=True)
    assert os.listdir(thesis) == ["config.json"]
    with pytest.raises(InputError, match=r"does not exist\. Make it first"):
        fitted.save(tmp_path / "no" / "run")
    assert sorted(os.listdir(tmp_path)) == ["empty", "file", "run", "thesis"]


def test_a_link_goes_on_pointing_to_the_run(fitted, run, tmp_path):
    (tmp_path / "latest").symlink_to(run, target_is_directory=True)
    (run / "report.html").touch()
    fitted.save(tmp_path / "latest", overwrite=True)
    assert (tmp_path / "latest").is_symlink()
    assert sorted(os.listdir(run)) == FILES
    assert sorted(os.listdir(tmp_path)) == ["latest", "run"]


def test_numbers_are_stored_to_the_last_digit(fitted, tmp_path):
    import dataclasses

    drawn = np.random.default_rng(0).standard_normal((50, len(fitted.history.columns)))
    history = fitted.history.iloc[[0] * 50].reset_index(drop=True)
    history[:] = drawn * 10.0 ** np.random.default_rng(1).integers(-20, 20, drawn.shape)
    history.loc[3, "validation_loss"] = np.nan
    fitted = dataclasses.replace(fitted, history=history)
    fitted.save(tmp_path / "run")
    assert Fit.load(tmp_path / "run").history.equals(history)
