"""A user's own model and guide, in a file of the current folder, are fitted like the ready ones."""

import sys

import pytest
import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.inference import Fit, fit

#: A model whose next state is a shift of this one, and a guide that knows each state as it is.
SHIFT = """
import pyro
import pyro.distributions as dist
import torch
from swarmssm.inference.guides import OneStepGuide
from swarmssm.models import NextStep, OneStepModel


def plate(batch):
    return pyro.plate("windows", batch.population, subsample=torch.arange(len(batch)), dim=-1)


def scored(batch):
    return (batch.mask[:, 1:] & batch.mask[:, :-1]).unsqueeze(-1)


class Shift(OneStepModel):
    default_epochs = 2

    def __init__(self, scales, start=0.0):
        super().__init__(scales.state_dim)
        self.shift = torch.nn.Parameter(torch.full((self.state_dim,), float(start)))

    def decode(self, latent):
        size = latent.shape[-2]
        states = dist.Normal(latent + self.shift, torch.full_like(latent, 0.1))
        return NextStep(states, latent.new_zeros(*latent.shape[:-1], size))

    def forward(self, batch):
        before = batch.observations[:, :-1]
        with plate(batch):
            prior = dist.Normal(torch.zeros_like(before), 10.0)
            latent = pyro.sample("states", prior.mask(scored(batch)).to_event(3))
            states = self.decode(latent).states.mask(scored(batch)).to_event(3)
            pyro.sample("next_states", states, obs=batch.observations[:, 1:])


class Known(OneStepGuide):
    def __init__(self, sd):
        super().__init__()
        self.sd = sd

    @classmethod
    def for_model(cls, model, sd=0.01):
        return cls(sd)

    def encode(self, states, adjacency):
        return dist.Normal(states, torch.full_like(states, self.sd))

    def forward(self, batch):
        with plate(batch):
            posterior = self.encode(batch.observations[:, :-1], batch.adjacency[:, :-1])
            pyro.sample("states", posterior.mask(scored(batch)).to_event(3))


def built(scales, **options):
    return Shift(scales, **options)


def known(model):
    return Known(0.02)


def nothing(*_):
    return None
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    before = set(sys.modules)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shift.py").write_text(SHIFT)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", None)).startswith(str(tmp_path)):
            del sys.modules[name]


OWN = {"model": "shift:Shift", "guide": "shift:Known", "window": 20, "batch_windows": None}


def test_they_are_fitted_and_learn(folder, swarm):
    """The best shift is the mean step of the scaled states: the guide's mean is the state."""
    own = fit(tracks=swarm, epochs=150, lr=0.02, scaler="isotropic", fractions=(1, 0, 0), **OWN)
    prepared = own.prepare(swarm)
    steps = (prepared.observations[:, 1:] - prepared.observations[:, :-1]).flatten(0, 2)
    # Each draw is off by 0.01, and there are 2 x 99 x 4 of them in a step of the optimiser.
    error = 6 * 0.01 / len(steps) ** 0.5
    torch.testing.assert_close(own.model.shift.detach(), steps.mean(0), rtol=0, atol=error)
    assert steps.mean(0).abs().max() > 0.02
    assert len(fit(tracks=swarm, **OWN).history) == 2  # its own number of epochs


def test_options_reach_them(folder, swarm):
    own = fit(
        tracks=swarm,
        steps=1,
        lr=1e-9,
        model_options={"start": 0.25},
        guide_options={"sd": 0.5},
        **OWN,
    )
    torch.testing.assert_close(own.model.shift.detach(), torch.full((4,), 0.25))
    assert own.guide.sd == 0.5
    by_function = fit(
        tracks=swarm, **{**OWN, "model": "shift:built", "guide": "shift:known", "steps": 1}
    )
    assert by_function.guide.sd == 0.02


def test_a_run_of_them_is_saved_and_loaded_with_trust(folder, swarm):
    own = fit(tracks=swarm, steps=2, out=folder / "run", **OWN)
    with pytest.raises(InputError, match=r"names the code shift:Shift.*\(trust_code=True\)"):
        Fit.load(folder / "run")
    again = Fit.load(folder / "run", trust_code=True)
    xr.testing.assert_identical(
        again.forecast(swarm, 3, draws=2, seed=1), own.forecast(swarm, 3, draws=2, seed=1)
    )
    assert own.rollout(swarm, 3, draws=0)["position"].notnull().all()
    # Of a model alone the guide is asked for trust too, and the other way round.
    mixed = fit(tracks=swarm, steps=1, out=folder / "mixed", **{**OWN, "model": "graph-vae"})
    assert mixed.settings.model == "graph-vae"
    with pytest.raises(InputError, match="names the code shift:Known"):
        Fit.load(folder / "mixed")


def test_code_that_changed_since_the_checkpoint_is_noticed(folder, swarm):
    class Halt(Exception):
        pass

    def halt(progress):
        if progress.epoch == 3:
            raise Halt

    settings = {**OWN, "epochs": 4, "checkpoint_every": 1, "out": folder / "run"}
    with pytest.raises(Halt):
        fit(tracks=swarm, callbacks=[halt], **settings)
    del sys.modules["shift"]
    (folder / "shift.py").write_text(SHIFT.replace("(self.state_dim,), float", "(1,), float"))
    with pytest.raises(InputError, match="checkpoint does not fit model and guide; has their code"):
        fit(tracks=swarm, resume=True, **settings)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"model": "no_such_file:Shift"}, "model: there is no module no_such_file"),
        ({"model": "shift:Shaft"}, "model: the module shift has no class or function Shaft"),
        (
            {"guide": "shift"},
            "guide: 'shift' is unknown. Choose one of .*encoder, .* or name your own",
        ),
        (
            {"model_options": {"stop": 1}},
            r"model: shift:Shift cannot be built with \{'stop': 1\}: .*argument 'stop'",
        ),
        ({"model_options": {"start": "x"}}, "model: shift:Shift cannot be built with .*'x'"),
        ({"guide_options": {"sd": 1, "sb": 2}}, "guide: shift:Known cannot be built with"),
        ({"model": "shift:nothing"}, "model: shift:nothing built no torch module, but NoneType"),
        ({"guide": "shift:nothing"}, "guide: shift:nothing built no torch module, but NoneType"),
    ],
)
def test_what_is_wrong_with_them_is_said(folder, swarm, change, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        fit(tracks=swarm, out=folder / "run", **{**OWN, **change})
    assert len(str(caught.value).splitlines()) == 1
    assert not (folder / "run").exists()
