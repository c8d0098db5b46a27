"""A fit that is killed goes on where it was, and ends where it would have ended."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

from swarmssm.errors import InputError, WorkError
from swarmssm.inference import Fit, fit
from swarmssm.inference.checkpoints import Checkpoint, read_checkpoint, write_checkpoint
from swarmssm.io import read, write
from swarmssm.models import MODELS, GraphVAE
from swarmssm.models.registry import Entry

SETTINGS = {
    "model": "graph-vae",
    "epochs": 12,
    "window": 20,
    "batch_windows": 4,
    "seed": 3,
    "checkpoint_every": 4,
}

#: Fit as told, say when an epoch is over, and hang in one epoch or in writing one checkpoint.
CHILD = """
import json, os, sys, time
from swarmssm import files, inference, io

told = json.loads(sys.argv[1])

def hang(what):
    print(what, flush=True)
    time.sleep(600)

def watch(progress):
    if progress.epoch == told.get("hang_in_epoch"):
        hang("epoch")

replace, seen = os.replace, []

def hanging_replace(source, target):
    seen.append(target)
    mine = [path for path in seen if "checkpoint" in str(path)]
    if len(mine) == told.get("hang_in_checkpoint"):
        hang("checkpoint")
    replace(source, target)

files.os.replace = hanging_replace
inference.fit(tracks=io.read(told["tracks"]), callbacks=[watch], **told["settings"])
print("done", flush=True)
"""


def killed(**told):
    """Run a fit in a process of its own and kill it where it hangs."""
    process = subprocess.Popen(
        [sys.executable, "-c", CHILD, json.dumps(told, default=str)],
        stdout=subprocess.PIPE,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        text=True,
    )
    said = process.stdout.readline().strip()
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert process.returncode == -signal.SIGKILL
    return said


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("resume")


@pytest.fixture(scope="module")
def path(place, swarm):
    """Return the file of the tracks; a process of its own has to read them."""
    write(swarm, place / "swarm.nc")
    return place / "swarm.nc"


@pytest.fixture(scope="module")
def tracks(path):
    return read(path)


@pytest.fixture(scope="module")
def whole(place, tracks):
    """Return the folder of the fit that nothing has interrupted."""
    fit(tracks=tracks, out=place / "whole", **SETTINGS)
    return place / "whole"


@pytest.fixture
def halted(half, tmp_path):
    """Return a copy of a folder whose fit was stopped half way."""
    shutil.copytree(half, tmp_path / "run")
    return tmp_path / "run"


class Halt(Exception):
    """Stops a fit as an interrupt from the keyboard would."""


def halt_in(epoch):
    def halt(progress):
        if progress.epoch == epoch:
            raise Halt

    return halt


@pytest.fixture(scope="module")
def half(place, tracks):
    """Return the folder of a fit that stopped in epoch 7, after the checkpoint of epoch 6."""
    with pytest.raises(Halt):
        fit(tracks=tracks, out=place / "half", callbacks=[halt_in(7)], **SETTINGS)
    return place / "half"


def assert_same_run(one: Path, other: Path):
    weights = [(folder / "weights.safetensors").read_bytes() for folder in (one, other)]
    assert weights[0] == weights[1]
    histories = [Fit.load(folder).history for folder in (one, other)]
    assert len(histories[0]) == 12
    assert histories[0].drop(columns="seconds").equals(histories[1].drop(columns="seconds"))
    for history in histories:
        assert (np.diff(history["seconds"]) > 0).all()
    assert not (other / "checkpoint").exists()
    assert (one / "config.json").read_bytes() == (other / "config.json").read_bytes()


def test_a_killed_fit_ends_as_if_nothing_had_happened(place, path, tracks, whole):
    """Killed while it writes the checkpoint of epoch 8, after those of epochs 2, 4 and 6."""
    out = place / "killed"
    told = {"tracks": path, "settings": {**SETTINGS, "out": out}}
    assert killed(**told, hang_in_checkpoint=4) == "checkpoint"
    assert read_checkpoint(out / "checkpoint").state["epoch"] == 6
    assert any(name.endswith(".part") for name in os.listdir(out / "checkpoint"))
    with pytest.raises(InputError, match=r"this fit is not finished. Go on with .*resume=True"):
        Fit.load(out)
    fit(tracks=tracks, out=out, resume=True, **SETTINGS)
    assert_same_run(whole, out)


@pytest.mark.slow
def test_killed_while_it_overwrites(place, path, tracks, whole):
    """The old run is there until the new one is finished, and then gone with all traces."""
    out = place / "again"
    shutil.copytree(whole, out)
    before = {name: (out / name).read_bytes() for name in os.listdir(out)}
    other = {**SETTINGS, "seed": 4}
    told = {"tracks": path, "settings": {**other, "out": out, "overwrite": True}}
    assert killed(**told, hang_in_epoch=7) == "epoch"
    assert {name: (out / name).read_bytes() for name in os.listdir(out)} == before
    assert Fit.load(out).settings.seed == 3
    with pytest.raises(InputError, match=r"finished; there is nothing to resume. Add overwrite"):
        fit(tracks=tracks, out=out, resume=True, **other)
    new = fit(tracks=tracks, out=out, resume=True, overwrite=True, **other)
    assert new.settings.seed == Fit.load(out).settings.seed == 4
    assert not [name for name in os.listdir(place) if "again" in name and name != "again"]
    fit(tracks=tracks, out=place / "afresh", **other)
    assert_same_run(place / "afresh", out)


def test_an_interrupted_fit_ends_as_if_nothing_had_happened(halted, tracks, whole):
    epochs = []
    fit(tracks=tracks, out=halted, resume=True, callbacks=[epochs.append], **SETTINGS)
    assert [progress.epoch for progress in epochs] == list(range(7, 13))
    assert_same_run(whole, halted)


def test_with_no_checkpoint_it_starts_from_scratch(tmp_path, tracks, whole):
    fit(tracks=tracks, out=tmp_path / "new", resume=True, **SETTINGS)
    assert_same_run(whole, tmp_path / "new")
    # So does a fit that was stopped before its first checkpoint.
    with pytest.raises(Halt):
        fit(tracks=tracks, out=tmp_path / "early", callbacks=[halt_in(1)], **SETTINGS)
    assert read_checkpoint(tmp_path / "early" / "checkpoint") is None
    fit(tracks=tracks, out=tmp_path / "early", resume=True, **SETTINGS)
    assert_same_run(whole, tmp_path / "early")


def test_killed_after_the_last_epoch_it_only_finishes(tmp_path, tracks, whole, monkeypatch):
    """Nothing is trained any more, neither at the end nor where patience had run out."""

    def fail(*_):
        raise WorkError("the disk is full")

    hasty = {**SETTINGS, "lr": 0.05, "schedule": "constant", "seed": 0, "patience": 2}
    for name, settings in (("all", SETTINGS), ("patient", hasty)):
        straight = fit(tracks=tracks, **settings).history
        with monkeypatch.context() as patch:
            patch.setattr("swarmssm.inference.fitting.finish_run", fail)
            with pytest.raises(WorkError):
                fit(tracks=tracks, out=tmp_path / name, **settings)
        told = []
        out = {"out": tmp_path / name, "resume": True, "callbacks": [told.append]}
        history = fit(tracks=tracks, **out, **settings).history
        assert not told
        assert history.drop(columns="seconds").equals(straight.drop(columns="seconds"))
    assert len(straight) < 12
    assert_same_run(whole, tmp_path / "all")


def test_other_settings_or_tracks_are_refused(halted, tracks, whole):
    before = (halted / "checkpoint" / "last.safetensors").read_bytes()
    config = (halted / "config.json").read_bytes()
    for change, named in (
        ({"lr": 0.1}, r"settings \(lr\)"),
        ({"seed": 9, "epochs": 20}, r"settings \(.*epochs.*\)"),
        ({"model_options": {"latent_dim": 3}}, r"settings \(model_options\)"),
    ):
        with pytest.raises(InputError, match=f"belongs to a fit with other {named}. Resume with"):
            fit(tracks=tracks, out=halted, resume=True, **{**SETTINGS, **change})
    moved = tracks.copy(deep=True)
    moved["position"][0, 0, 0, 0] += 1e-9
    renamed = tracks.assign_coords(individual=list("abcd"), neighbor=list("abcd"))
    ruled = tracks.copy(deep=True)
    ruled["adjacency"].attrs["rule"] = json.dumps({"kind": "radius", "radius": 3.0})
    slower = tracks.assign_attrs(fps=5.0).assign_coords(time=tracks["time"] * 2)
    for other in (moved, renamed, ruled, slower):
        with pytest.raises(InputError, match="belongs to a fit with other tracks"):
            fit(tracks=other, out=halted, resume=True, **SETTINGS)
    # A refusal changes nothing, and how often checkpoints are written is free.
    assert (halted / "checkpoint" / "last.safetensors").read_bytes() == before
    assert (halted / "config.json").read_bytes() == config
    fit(tracks=tracks, out=halted, resume=True, **{**SETTINGS, "checkpoint_every": 1})
    assert (halted / "weights.safetensors").read_bytes() == (
        whole / "weights.safetensors"
    ).read_bytes()


def test_what_cannot_be_resumed_is_said(place, tracks, whole, tmp_path):
    with pytest.raises(InputError, match="whole: this fit is finished; there is nothing to resume"):
        fit(tracks=tracks, out=whole, resume=True, **SETTINGS)
    with pytest.raises(InputError, match="resume: there is nothing to resume without out"):
        fit(tracks=tracks, resume=True, **SETTINGS)
    with pytest.raises(InputError, match=r"exists already and was left as it is.*or resume=True"):
        fit(tracks=tracks, out=whole, **SETTINGS)
    # Somebody else's folder, even one with a config.json, is not written into.
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "config.json").write_text('{"name": "theirs"}')
    (tmp_path / "file").touch()
    for name in ("theirs", "file"):
        for how in ("resume", "overwrite"):
            with pytest.raises(InputError, match=f"{name}: it is not a run folder"):
                fit(tracks=tracks, out=tmp_path / name, **{how: True}, **SETTINGS)
    assert os.listdir(theirs) == ["config.json"]
    assert (theirs / "config.json").read_text() == '{"name": "theirs"}'
    with pytest.raises(InputError, match=r"the folder .*nowhere does not exist\. Make it first"):
        fit(tracks=tracks, out=tmp_path / "nowhere" / "run", **SETTINGS)


@pytest.mark.parametrize("damage", ["cut", "empty", "other bytes", "other tensors", "no state"])
def test_a_damaged_checkpoint_is_said(halted, tracks, damage):
    path = halted / "checkpoint" / "last.safetensors"
    data = path.read_bytes()
    if damage == "no state":
        path.write_bytes(safetensors.torch.save({"weights.x": torch.ones(2)}))
    elif damage == "other tensors":
        # Its state is ours, and the network is another: its code was changed meanwhile.
        state = read_checkpoint(path.parent).state
        write_checkpoint(path.parent, Checkpoint({"weights.x": torch.ones(2)}, state))
    else:
        path.write_bytes({"cut": data[:-100], "empty": b"", "other bytes": b"\0" * 99}[damage])
    sentence = {
        "no state": "is not a checkpoint of a fit",
        "other tensors": "checkpoint does not fit model and guide; has their code changed",
    }.get(damage, r"last\.safetensors: the file is damaged and cannot be read")
    with pytest.raises(InputError, match=sentence):
        fit(tracks=tracks, out=halted, resume=True, **SETTINGS)


def test_normalisation_and_frozen_weights_go_on_too(tmp_path, tracks, monkeypatch):
    """A model with running means, weights that share memory, and some that are not trained."""

    class Normalised(GraphVAE):
        def __init__(self, state_dim):
            super().__init__(state_dim)
            self.norm = torch.nn.BatchNorm1d(4)
            self.decoder = torch.nn.Sequential(self.decoder)
            self.tied = self.decoder[0][0].weight
            self.frozen = torch.nn.Parameter(torch.ones(2), requires_grad=False)

        def decode(self, latent):
            shape = latent.shape
            return super().decode(self.norm(latent.reshape(-1, 4)).reshape(shape))

    monkeypatch.setitem(MODELS, "normalised", Entry(Normalised, "", ""))
    settings = {**SETTINGS, "model": "normalised"}
    fit(tracks=tracks, out=tmp_path / "whole", **settings)
    with pytest.raises(Halt):
        fit(tracks=tracks, out=tmp_path / "run", callbacks=[halt_in(7)], **settings)
    fit(tracks=tracks, out=tmp_path / "run", resume=True, **settings)
    assert_same_run(tmp_path / "whole", tmp_path / "run")
    # Watching does not move a running mean: with and without it, they are the same.
    sparse = fit(tracks=tracks, **{**settings, "fractions": (0.7, 0.3, 0), "validate_every": 12})
    often = fit(tracks=tracks, **{**settings, "fractions": (0.7, 0.0, 0.3)})
    assert torch.equal(sparse.model.norm.running_mean, often.model.norm.running_mean)
    assert torch.equal(sparse.model.tied, often.model.tied)
