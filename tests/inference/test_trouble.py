"""A fit that goes wrong says where, and keeps the last state in which all was well."""

import os
import subprocess

import pyro
import pytest
import torch

from swarmssm.errors import InputError, WorkError
from swarmssm.inference import Fit, fit
from swarmssm.inference.checkpoints import read_checkpoint
from swarmssm.models import MODELS, GraphVAE
from swarmssm.models.registry import Entry

STEP_6 = r"at step 6 \(epoch 3\)\. Try a smaller learning rate than 0\.005"


@pytest.fixture
def settings(brief):
    """Eight windows, four a batch: two steps an epoch. Nothing is validated."""
    return {**brief, "epochs": 6, "fractions": (1, 0, 0), "checkpoint_every": 1, "window": 30}


@pytest.fixture
def failing(monkeypatch):
    """Return a function that registers a model whose ELBO gets a term at its n-th step."""

    def register(call, term):
        class Failing(GraphVAE):
            calls = 0

            def forward(self, batch):
                super().forward(batch)
                # Without gradient it is only looked at, before training.
                if torch.is_grad_enabled():
                    type(self).calls += 1
                    if type(self).calls >= call:
                        pyro.factor("planted", term(self))

        monkeypatch.setitem(MODELS, "failing", Entry(Failing, "", ""))

    return register


@pytest.mark.parametrize(
    ("term", "what"),
    [
        (lambda model: torch.tensor(float("nan")), "the loss is not a number"),
        (lambda model: torch.tensor(float("-inf")), "the loss (is not a number|exploded to inf)"),
        (lambda model: torch.tensor(-1e12), r"the loss exploded to \d\.\d+e\+\d+"),
        # The loss is sound, and its gradient is 0 / 0.
        (
            lambda model: (0 * model.decoder[0].bias).abs().sum().sqrt(),
            "the gradient is not finite",
        ),
    ],
)
def test_the_step_is_named_and_the_last_good_checkpoint_kept(
    swarm, settings, failing, tmp_path, term, what
):
    failing(6, term)
    told = []
    with pytest.raises(WorkError, match=f"training: {what} {STEP_6}") as caught:
        fit(
            tracks=swarm,
            out=tmp_path / "run",
            callbacks=[told.append],
            **{**settings, "model": "failing"},
        )
    assert len(str(caught.value).splitlines()) == 1
    assert [progress.epoch for progress in told] == [1, 2]
    kept = read_checkpoint(tmp_path / "run" / "checkpoint")
    assert kept.state["epoch"] == 2
    assert all(value.isfinite().all() for name, value in kept.tensors.items() if name != "rng")
    # It is a checkpoint like any other: without the fault, the fit goes on from it.
    failing(10**6, term)
    settings["model"] = "failing"
    again = fit(tracks=swarm, out=tmp_path / "run", resume=True, **settings)
    assert again.history["epoch"].tolist() == [1, 2, 3, 4, 5, 6]
    assert again.history["loss"].notna().all()


def test_the_first_step_may_fail_too(swarm, settings, failing, tmp_path):
    failing(1, lambda model: torch.tensor(float("nan")))
    with pytest.raises(WorkError, match=r"not a number at step 1 \(epoch 1\)"):
        fit(tracks=swarm, out=tmp_path / "run", **{**settings, "model": "failing"})
    assert os.listdir(tmp_path) == []  # there is nothing to go on from


def test_a_failure_of_the_last_step_is_noticed(swarm, settings, failing, monkeypatch):
    """Its loss is fine, and the weights it leaves are not; no later loss would tell."""
    failing(12, lambda model: (0 * model.decoder[0].bias).abs().sum().sqrt())
    with pytest.raises(WorkError, match=r"gradient is not finite at step 12 \(epoch 6\)"):
        fit(tracks=swarm, **{**settings, "model": "failing"})

    class Brim(GraphVAE):
        """Has a weight that one more step carries out of the range of float32."""

        def __init__(self, state_dim, **options):
            super().__init__(state_dim, **options)
            self.brim = torch.nn.Parameter(torch.tensor(3e38))

        def forward(self, batch):
            super().forward(batch)
            pyro.factor("planted", 1e-3 * self.brim)

    monkeypatch.setitem(MODELS, "brim", Entry(Brim, "", ""))
    single = {"epochs": 1, "batch_windows": None, "clip": None, "lr": 1e38}
    with pytest.raises(WorkError, match=r"a weight is no longer finite at step 1 \(epoch 1\)"):
        fit(tracks=swarm, **{**settings, **single, "model": "brim"})


def test_a_learning_rate_beyond_all_bounds(swarm, settings, tmp_path):
    with pytest.raises(WorkError, match=r"at step \d+ .* smaller learning rate than 1e\+10"):
        fit(tracks=swarm, out=tmp_path / "run", **{**settings, "lr": 1e10, "clip": None})


def test_a_failed_successor_leaves_the_old_run(swarm, settings, failing, fitted, tmp_path):
    fitted.save(tmp_path / "run")
    failing(1, lambda model: torch.tensor(float("nan")))
    with pytest.raises(WorkError):
        fit(tracks=swarm, out=tmp_path / "run", overwrite=True, **{**settings, "model": "failing"})
    assert os.listdir(tmp_path) == ["run"]
    assert Fit.load(tmp_path / "run").settings == fitted.settings


@pytest.fixture
def small_disk(tmp_path):
    """Return a folder on a disk of 64 KiB; a run without its checkpoints needs about 20."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("a small disk can only be mounted by root")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_full_disk(swarm, settings, fitted, small_disk):
    """Whether it is full when saving, or while checkpoints are written, the old run is there."""
    out = small_disk / "run"
    fitted.save(out)
    before = contents(out)
    (small_disk / "filler").write_bytes(b"\0" * 28 * 1024)
    for work in (
        lambda: fitted.save(out, overwrite=True),
        lambda: fitted.save(small_disk / "second"),
        lambda: fit(tracks=swarm, out=out, overwrite=True, **settings),
        lambda: fit(tracks=swarm, out=small_disk / "third", **settings),
    ):
        with pytest.raises(WorkError, match="No space left on device"):
            work()
        assert contents(out) == before
        assert Fit.load(out).history.equals(fitted.history)
        assert sorted(os.listdir(small_disk)) == ["filler", "run"]


def test_a_folder_that_cannot_be_replaced(fitted, tmp_path, monkeypatch):
    fitted.save(tmp_path / "run")
    before = contents(tmp_path / "run")
    from pathlib import Path

    original = Path.rename

    def rename(path, target):
        if path.name.startswith(".run.") and not path.name.endswith(".old"):
            raise OSError(5, "Input/output error")
        return original(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", rename)
        with pytest.raises(WorkError, match=r"run: cannot be replaced \(Input/output error\)"):
            fitted.save(tmp_path / "run", overwrite=True)
    assert contents(tmp_path / "run") == before
    assert os.listdir(tmp_path) == ["run"]


def test_tracks_from_which_nothing_can_be_learned(swarm, brief):
    from swarmssm.tracks import make_tracks

    nan = float("nan")
    position = torch.rand(40, 2, 2, dtype=torch.float64).numpy()
    blinking = position.copy()
    blinking[::2] = nan
    for broken, settings, sentence in (
        (None, {}, "tracks: none are given"),
        (make_tracks(blinking, fps=1.0), {}, "no individual is seen in two consecutive frames"),
        (make_tracks(position * 0, fps=1.0), {}, "nothing moves"),
        (make_tracks(position[:3], fps=1.0), {}, "has 3 frames, too few to split"),
        (make_tracks(position[:14], fps=1.0), {}, "in the validation part nobody is seen"),
        (swarm, {"graph": "data:1"}, "graph"),
        (swarm, {"fractions": (0.5, 0.5, 0.5)}, "fractions: three shares that sum to 1"),
    ):
        with pytest.raises(InputError, match=sentence):
            fit(tracks=broken, **{**brief, **settings})
