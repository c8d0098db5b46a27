"""A guide that does not fit its model is refused before training, in a sentence."""

import dataclasses

import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.nn import PyroSample

from swarmssm.errors import InputError
from swarmssm.inference import fit
from swarmssm.inference.agreement import check_agreement, evaluating
from swarmssm.inference.data import windows_of
from swarmssm.inference.guides import (
    GraphEncoderGuide,
    LinearizedGuide,
    OneStepGuide,
    ParameterGuide,
    PathGuide,
)
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    GraphVAE,
    InitialStates,
    KinematicTransition,
    PositionEmission,
    StateSpaceModel,
    SwarmBatch,
)

WINDOWS, TIMES, INDIVIDUALS = 3, 5, 4


@pytest.fixture(autouse=True)
def local_parameters():
    """Parameters stay in their modules, as in a fit."""
    with quiet_pyro():
        yield


def rand(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def windows(features, number=WINDOWS):
    mask = torch.ones(number, TIMES, INDIVIDUALS, dtype=torch.bool)
    mask[0, :2, 1] = False
    observations = rand(number, TIMES, INDIVIDUALS, features) * mask.unsqueeze(-1)
    adjacency = torch.ones(number, TIMES, INDIVIDUALS, INDIVIDUALS) - torch.eye(INDIVIDUALS)
    adjacency *= mask.unsqueeze(-1) & mask.unsqueeze(-2)
    return SwarmBatch.of(observations, mask, adjacency)


def plate(batch):
    return pyro.plate("windows", batch.population, subsample=torch.arange(len(batch)), dim=-1)


class Wandering(KinematicTransition):
    """Velocities go on as they are, with a damping that is to be inferred."""

    def __init__(self):
        super().__init__(2, 0.5)
        self.damping = PyroSample(dist.LogNormal(-2.0, 1.0))

    def velocity(self, positions, velocities, inputs):
        return dist.Normal(velocities * (1 - self.damping), 0.3).to_event(1)


def wandering(exact=False):
    emission = None if exact else PositionEmission(2, 0.1)
    return StateSpaceModel(InitialStates(torch.zeros(4), torch.ones(4)), Wandering(), emission)


class Drawn(PathGuide):
    """Paths on which p' = p + dt v' holds, of a wrong density."""

    off = 0.0

    def path(self, batch, values):
        states = torch.zeros(len(batch), batch.num_times, batch.num_individuals, 4)
        states[:, 2:, :, 0] += self.off
        return states, states.sum((1, 2, 3))


class Sites(OneStepGuide):
    """A guide of the graph VAE by a function."""

    def __init__(self, forward):
        super().__init__()
        self.function = forward

    def forward(self, batch):
        with plate(batch):
            self.function(batch)


def of_shape(*shape, name="states"):
    return lambda batch: pyro.sample(
        name, dist.Normal(torch.zeros(len(batch), *shape), 1.0).to_event(len(shape))
    )


GOOD = of_shape(TIMES - 1, INDIVIDUALS, 4)


def both(one, other):
    def run(batch):
        one(batch)
        other(batch)

    return run


@pytest.mark.parametrize("number", [WINDOWS, 1])
def test_those_that_agree_pass_and_nothing_is_changed(number):
    vae, seen, exact = GraphVAE(4), wandering(), wandering(exact=True)
    batch = windows(4, number)
    # Nobody moves, and so all are where their velocities have brought them.
    still = dataclasses.replace(batch, observations=torch.zeros_like(batch.observations))
    for model, guide, given in (
        (vae, GraphEncoderGuide(4), batch),
        (vae, Sites(GOOD), batch),
        (seen, Drawn(seen), windows(2, number)),
        (exact, ParameterGuide(exact), still),
    ):
        weights = {n: p.clone() for m in (model, guide) for n, p in m.state_dict().items()}
        before = torch.get_rng_state()
        check_agreement(model, guide, given)
        assert torch.equal(torch.get_rng_state(), before)
        after = {n: p for m in (model, guide) for n, p in m.state_dict().items()}
        assert weights.keys() == after.keys()
        assert all(torch.equal(after[name], weights[name]) for name in weights)
        assert model.training
        assert guide.training


def test_a_prior_whose_swarms_fly_apart_is_no_fault():
    """What counts is whether the density of the guide's own draws is a number."""

    class Bursting(Wandering):
        def velocity(self, positions, velocities, inputs):
            # Who moves at all is at infinity minus infinity soon.
            return dist.Normal(1e30 * (velocities**5 - velocities**3), 1e30).to_event(1)

    model = StateSpaceModel(
        InitialStates(torch.zeros(4), torch.ones(4)), Bursting(), PositionEmission(2, 0.1)
    )
    with pyro.validation_enabled(True), pytest.raises(ValueError, match="invalid values"):
        model(windows(2))
    check_agreement(model, Drawn(model), windows(2))


def test_layers_of_normalisation_are_not_moved():
    model, guide = GraphVAE(4), GraphEncoderGuide(4)
    model.norm = torch.nn.BatchNorm1d(4)
    model.norm.eval()
    with evaluating(model, guide):
        assert not any(part.training for top in (model, guide) for part in top.modules())
    assert model.training
    assert guide.training
    assert not model.norm.training  # as it was, though the model around it is trained


@pytest.mark.parametrize(
    ("function", "sentence"),
    [
        (
            lambda batch: None,
            r"guide: it does not sample 'states', which the model does\. Sample it in the guide's "
            r"forward, under the same name\.",
        ),
        (
            both(GOOD, of_shape(2, name="mood")),
            r"guide: it samples 'mood', which the model does not know\. The model's sites are "
            r"'states'\.",
        ),
        (
            of_shape(TIMES, INDIVIDUALS, 4),
            r"guide: it draws states of shape \(2, 5, 4, 4\), and the model's is \(2, 4, 4, 4\)\.",
        ),
        (
            of_shape(TIMES - 1, INDIVIDUALS, 3),
            r"guide: it draws states of shape \(2, 4, 4, 3\), and the model's is \(2, 4, 4, 4\)\.",
        ),
        (
            lambda batch: batch.observations @ torch.zeros(3, 2),
            r"guide: it fails on windows of the tracks .*line .*: .*shapes cannot be multiplied",
        ),
        (
            lambda batch: batch.velocities,
            "guide: it fails on windows of the tracks .*line .*: AttributeError: .*'velocities'",
        ),
        (
            lambda batch: {}["gain"],
            "guide: it fails on windows of the tracks .*line .*: KeyError: 'gain'",
        ),
        (
            # Features of a state that are taken for windows: their terms would be counted wrongly.
            lambda batch: pyro.sample(
                "states", dist.Normal(torch.zeros(len(batch), 4, 4, 4), 1.0).to_event(2)
            ),
            r"guide: it fails .*: Shape mismatch inside plate\('windows'\) at site states",
        ),
        (
            lambda batch: pyro.sample(
                "states", dist.Normal(torch.zeros(len(batch), 4, 4, 4), -1.0).to_event(3)
            ),
            r"guide: it fails .*scale .*GreaterThan\(lower_bound=0\.0\), but found invalid values",
        ),
    ],
)
@pytest.mark.parametrize("number", [WINDOWS, 1])
def test_a_guide_that_does_not_fit_is_refused(function, sentence, number):
    with pytest.raises(InputError, match=f"^{sentence}") as caught:
        check_agreement(GraphVAE(4), Sites(function), windows(4, number))
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 400


def test_windows_outside_of_their_plate_are_noticed():
    """Mini-batches would not be scaled to the whole."""

    class Loose(Sites):
        def forward(self, batch):
            self.function(batch)

    with pytest.raises(InputError, match=r'guide: at site "states".*Expected.*actual') as caught:
        check_agreement(GraphVAE(4), Loose(GOOD), windows(4, 1))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (
            lambda batch: torch.ones(3) @ torch.ones(2),
            "model: it fails on windows of the tracks .*line .*: ",
        ),
        (lambda batch: pyro.factor("x", torch.tensor(float("nan"))), "model: it fails .*invalid"),
        (lambda batch: pyro.sample("y", dist.Normal(0.0, 1.0)), "guide: it does not sample 'y'"),
    ],
)
def test_a_model_that_fails_is_said(fault, sentence):
    class Faulty(GraphVAE):
        def forward(self, batch):
            super().forward(batch)
            fault(batch)

    with pytest.raises(InputError, match=f"^{sentence}") as caught:
        check_agreement(Faulty(4), GraphEncoderGuide(4), windows(4))
    assert len(str(caught.value).splitlines()) == 1


def test_the_model_s_own_sentence_comes_through_alone():
    model = wandering()
    with pytest.raises(InputError, match=r"^observations: the model observes 2 features") as caught:
        check_agreement(model, Drawn(model), windows(4))
    assert len(str(caught.value).splitlines()) == 1


def test_a_parameter_that_the_guide_forgets_is_named():
    class Forgetful(Drawn):
        def forward(self, batch):
            with plate(batch):
                states, density = self.path(batch, {})
                pyro.sample("states", dist.Delta(states, log_density=density, event_dim=3))

    model = wandering()
    with pytest.raises(InputError, match=r"does not sample 'transition\.damping', which the model"):
        check_agreement(model, Forgetful(model), windows(2))


def test_paths_whose_positions_do_not_follow_are_refused():
    """Whether a guide draws them, or they are observed exactly and no velocity leads there."""
    model = wandering()
    guide = Drawn(model)
    guide.off = 1.0
    sentence = r"positions of a path must follow from its velocities, p' = p \+ dt v', and some do"
    with pytest.raises(InputError, match=f"^model: .*{sentence}") as caught:
        check_agreement(model, guide, windows(2))
    assert len(str(caught.value).splitlines()) == 1
    exact = wandering(exact=True)
    batch = windows(4)  # positions and velocities drawn each for itself
    with pytest.raises(InputError, match=f"^model: .*{sentence}.*backward differences"):
        check_agreement(exact, ParameterGuide(exact), batch)
    # Velocities of the data that are their backward differences are well.
    positions = rand(WINDOWS, TIMES + 1, INDIVIDUALS, 2, seed=1)
    states = torch.cat([positions[:, 1:], positions.diff(dim=1) / 0.5], -1)
    check_agreement(
        exact, ParameterGuide(exact), SwarmBatch.of(states, batch.mask, batch.adjacency)
    )


def samples_nothing(model):
    return Sites(lambda batch: None)


def test_a_fit_is_refused_before_anything_is_written(swarm, brief, tmp_path):
    settings = {**brief, "out": tmp_path / "run"}
    with pytest.raises(InputError, match="guide: it does not sample 'states'"):
        fit(guide=samples_nothing, tracks=swarm, **settings)
    assert list(tmp_path.iterdir()) == []


def test_a_check_leaves_the_fit_as_it_would_be_without(swarm, brief, weights_of, monkeypatch):
    checked = fit(tracks=swarm, **brief)
    monkeypatch.setattr("swarmssm.inference.fitting.check_agreement", lambda *_, **__: None)
    unchecked = fit(tracks=swarm, **brief)
    one, other = weights_of(checked), weights_of(unchecked)
    assert all(torch.equal(one[name], other[name]) for name in one)
    prepared = checked.prepare(checked.part(swarm, "train"))
    check_agreement(checked.model, checked.guide, windows_of(prepared, 20))


def typo(positions, velocities, dt):
    return dist.Normal(velocities + dt * poll, 0.3).to_event(1)  # noqa: F821


def inside(positions, velocities, dt):
    raise RuntimeError("no pull")


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (typo, r"model.*test_agreement.py, line \d+, in typo\): NameError: name 'poll'"),
        (lambda p, v, dt: dist.Normal(v.velocity, 0.3), r"model.*line \d+.*AttributeError: "),
        (inside, r"model.*test_agreement.py, line \d+, in inside\): no pull"),
        (
            lambda p, v, dt: dist.Normal(v[..., :1], 0.3).to_event(1),
            r"model.*positions have 2 coordinates and velocities 1",
        ),
        (
            lambda p, v, dt: dist.Normal(v[..., :1, :], 0.3).to_event(1),
            r"velocity: it must return a distribution of batch shape .*individual",
        ),
        (
            lambda p, v, dt: dist.Normal(v, 0.3),
            r"velocity: it must return a distribution of batch shape .*individual",
        ),
    ],
)
def test_a_fault_in_a_transition_is_the_model_s_with_file_and_line(fault, sentence):
    class Faulty(Wandering):
        def velocity(self, positions, velocities, inputs):
            return fault(positions, velocities, self.dt)

    for emission in (PositionEmission(2, 0.1), None):
        model = StateSpaceModel(InitialStates(torch.zeros(4), torch.ones(4)), Faulty(), emission)
        guide = LinearizedGuide(model) if emission is not None else ParameterGuide(model)
        with pytest.raises(InputError, match=f"^{sentence}") as caught:
            check_agreement(model, guide, windows(4 if emission is None else 2))
        assert "\n" not in str(caught.value)


def test_what_fails_when_a_guide_runs_the_transition_is_the_model_s():
    class Faulty(Wandering):
        def linearize(self, mean, inputs, covariance=None):
            return mean.no_such_thing

    model = StateSpaceModel(
        InitialStates(torch.zeros(4), torch.ones(4)), Faulty(), PositionEmission(2, 0.1)
    )
    with pytest.raises(InputError, match=r"^model: .*line \d+, in linearize.*no_such_thing"):
        check_agreement(model, LinearizedGuide(model), windows(2))


@pytest.mark.parametrize("shape", [(2, 4, 1), (1, 4, 2)])
def test_forces_of_another_shape_are_refused(shape):
    class Pulled(KinematicTransition):
        terms = ("pull", "drag")

        def __init__(self):
            super().__init__(2, 0.5)
            self.process_noise = PyroSample(dist.LogNormal(-2.0, 1.0))

        def forces(self, states, inputs):
            return torch.zeros(*states.shape[:-2], *shape)

    model = StateSpaceModel(
        InitialStates(torch.zeros(4), torch.ones(4)), Pulled(), PositionEmission(2, 0.1)
    )
    with pytest.raises(InputError, match=r"^forces: they must be .*\(\.\.\., 2, 4, 2\)"):
        check_agreement(model, LinearizedGuide(model), windows(2))
