"""Priors as text, and on the parameters of a model that stands already."""

import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import SVI, Trace_ELBO
from pyro.infer.autoguide import AutoNormal
from pyro.nn import PyroParam, PyroSample
from torch import nn
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.inference.settings import FitSettings, settings_from
from swarmssm.models import (
    ExactEmission,
    InitialStates,
    KinematicTransition,
    PositionEmission,
    StateSpaceModel,
    assign,
    parameters_of,
    parse_distribution,
    with_priors,
)
from swarmssm.models.parameters import priors_of
from swarmssm.models.prior_text import distribution_text
from swarmssm.models.priors import PRIORS
from swarmssm.models.supports import covers, describe


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("LogNormal(-1, 0.5)", dist.LogNormal(-1.0, 0.5)),
        ("  LogNormal( loc = -1 , scale=5e-1 ) ", dist.LogNormal(-1.0, 0.5)),
        ("Normal(+0, scale=2)", dist.Normal(0.0, 2.0)),
        ("Normal(--1, 2)", dist.Normal(1.0, 2.0)),
        ("Uniform(-.5, 3)", dist.Uniform(-0.5, 3.0)),
        ("StudentT(4)", dist.StudentT(4.0)),
        ("HalfNormal(0.1)", dist.HalfNormal(0.1)),
        ("Normal([0, 1], [1, 2])", dist.Normal(torch.tensor([0.0, 1]), torch.tensor([1.0, 2]))),
        ("Normal([0, 1], 2)", dist.Normal(torch.tensor([0.0, 1]), 2.0)),
        ("Normal((0, 1), 2)", dist.Normal(torch.tensor([0.0, 1]), 2.0)),
        ("Normal([[0, 1], [2, 3]], 2)", dist.Normal(torch.tensor([[0.0, 1], [2, 3]]), 2.0)),
        ("Dirichlet([1, 2, 3])", dist.Dirichlet(torch.tensor([1.0, 2, 3]))),
        (
            "MultivariateNormal([0, 1], [[2, 1], [1, 2]])",
            dist.MultivariateNormal(torch.tensor([0.0, 1]), torch.tensor([[2.0, 1], [1, 2]])),
        ),
        (
            "MultivariateNormal([0, 1], scale_tril=[[2, 0], [1, 2]])",
            dist.MultivariateNormal(
                torch.tensor([0.0, 1]), scale_tril=torch.tensor([[2.0, 0], [1, 2]])
            ),
        ),
    ],
)
def test_a_text_is_the_distribution_that_it_names(text, same):
    found = parse_distribution(text)
    assert found.batch_shape == ()
    assert found.event_shape == same.batch_shape + same.event_shape
    value = same.sample()
    torch.testing.assert_close(found.log_prob(value), same.log_prob(value).sum())


@pytest.mark.parametrize(
    "text",
    [
        "LogNormal(-1, 0.5)",
        "Normal([0, 1], [1, 2])",
        "Normal(0, [1, 2, 3, 4])",
        "Beta(2, 3)",
        "Chi2(3)",
        "Gamma(2, 0.25)",
        "Uniform(-0.5, 3)",
        "Weibull(1, 2)",
        "HalfCauchy(2)",
    ],
)
def test_a_prior_is_written_as_it_is_read(text):
    found = parse_distribution(text)
    again = parse_distribution(distribution_text(found))
    assert distribution_text(found).startswith(text.partition("(")[0])
    pyro.set_rng_seed(0)
    drawn = found.sample((5,))
    torch.testing.assert_close(again.log_prob(drawn), found.log_prob(drawn))


@pytest.mark.parametrize(
    ("distribution", "text"),
    [
        (dist.Normal(0.0, 1.0).expand([12]).to_event(1), "Normal(0, 1)"),
        (dist.Normal(torch.zeros(5), torch.arange(1.0, 6.0)), "Normal(0, 5 numbers)"),
        (
            dist.MultivariateNormal(torch.zeros(2), 3 * torch.eye(2)),
            "MultivariateNormal(0, 2 x 2 numbers)",
        ),
        (dist.LogNormal(-1 / 3, 2.0), "LogNormal(-0.3333, 2)"),
    ],
)
def test_a_prior_too_long_to_write_is_counted(distribution, text):
    assert distribution_text(distribution) == text


@pytest.mark.parametrize("name", PRIORS)
def test_every_prior_can_be_written_down(name):
    arguments = {
        "Dirichlet": "[1, 2]",
        "MultivariateNormal": "[0, 0], [[1, 0], [0, 1]]",
        "Uniform": "0.5, 2",
    }
    one = name in ("Exponential", "HalfCauchy", "HalfNormal", "Chi2", "StudentT")
    text = f"{name}({arguments.get(name, '0.5' if one else '0.5, 2')})"
    drawn = parse_distribution(text).sample((3,))
    assert drawn.isfinite().all()
    assert drawn.dtype == torch.float32


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'' cannot be read as a name with arguments in brackets. Write for instance Log"),
        ("Normal(0, 1", r"'Normal\(0, 1' cannot be read at character 7"),
        ("Normal(0 1)", "cannot be read at character 8"),
        ("Normal(0, 1); 2", "cannot be read at character 13"),
        ("(" * 500, "cannot be read"),
        ("Normal", "'Normal' is no name with arguments in brackets"),
        ("3", "is no name with arguments"),
        ("Normal(0, 1) + 1", "is no name with arguments"),
        ("dist.Normal(0, 1)", "is no name with arguments"),
        ("__import__('os').system('echo')", "is no name with arguments"),
        ("[x for x in (1,)]", "is no name with arguments"),
        ("Norml(0, 1)", "Norml is no known distribution. Choose one of Beta, Cauchy"),
        ("Poisson(3)", "Poisson is no known distribution"),
        ("Delta(3)", "Delta is no known distribution"),
        ("eval('1')", "eval is no known distribution"),
        ("Normal(0)", r"'Normal\(0\)' lacks scale"),
        ("Normal()", "lacks loc, scale"),
        ("Normal(0, 1, 2)", "has 3 arguments, and Normal takes at most 2: loc, scale"),
        ("Normal(0, 1, scale=2)", "scale is given twice"),
        ("Normal(0, 1, loc=2)", "loc is given twice"),
        ("Normal(0, sd=1)", "sd is not one of loc, scale"),
        ("Normal(0, 1, validate_args=False)", "validate_args is not one of loc, scale"),
        ("Normal(**{'loc': 1})", r"\*\* is not one of loc, scale"),
        ("Normal(*[0, 1])", r"argument 1 must be a number or a list of numbers, and \*\[0, 1\] is"),
        ("Normal(0, abs(1))", r"argument 2 must be .*, and abs\(1\) is not"),
        ("Normal(0, scale=x)", "scale must be a number or a list of numbers, and x is not"),
        ("Normal(0, 2**999999)", r"2\*\*999999 is not"),
        ("Normal(0, 1e999)", "1e999 is not"),
        ("Normal(0, '1')", "'1' is not"),
        ("Normal(0, True)", "True is not"),
        ("Normal(0, 1j)", "1j is not"),
        ("Normal([], 1)", r"\[\] is not"),
        ("Normal([1, [2]], 1)", r"\[1, \[2\]\] is not"),
        ("Normal(0, -1)", "is not possible: scale must be positive"),
        ("Normal(0, 0)", "scale must be positive"),
        ("Uniform(2, 1)", "high must be greater than low"),
        ("Normal([0, 0], [1, 1, 1])", r"do not go together \(shapes: loc \(2,\), scale \(3,\)\)"),
        ("Dirichlet(1)", r"do not go together \(shapes: concentration \(\)\)"),
        ("MultivariateNormal([0, 0])", r"do not go together \(shapes: loc \(2,\)\)"),
        (
            "MultivariateNormal([0, 0], [[1, 2], [2, 1]])",
            "covariance_matrix must be a positive definite matrix",
        ),
    ],
)
def test_a_text_that_is_no_prior_is_refused_with_its_place(text, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_distribution(text)
    assert len(str(caught.value)) < 420


class Drift(KinematicTransition):
    """A fixed gain, a learned noise, a prior of a push, and a network."""

    def __init__(self):
        super().__init__(2, 0.1)
        assign(self, "gain", 0.5)
        positive = constraints.positive
        assign(self, "noise", PyroParam(torch.tensor(0.2), positive), constraint=positive)
        assign(self, "push", dist.Normal(torch.zeros(2), 1.0))
        assign(self, "reach", dist.LogNormal(0.0, 1.0))
        self.network = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 2, bias=False))

    def velocity(self, positions, velocities, inputs):
        bent = self.network(torch.cat([positions, velocities], -1)) * self.reach
        return dist.Normal(
            velocities + self.gain.unsqueeze(-1) * bent + self.push, self.noise
        ).to_event(1)


def build(**options):
    torch.manual_seed(0)
    initial = InitialStates(torch.zeros(4), torch.ones(4))
    return StateSpaceModel(initial, Drift(), PositionEmission(2, 0.1, **options))


def test_all_parameters_have_names():
    assert list(parameters_of(build(tails="student"))) == [
        "initial.mean",
        "initial.scale",
        "transition.gain",
        "transition.noise",
        "transition.push",
        "transition.reach",
        "transition.network.0.weight",
        "transition.network.0.bias",
        "transition.network.2.weight",
        "emission.noise",
        "emission.excess_degrees",
    ]


def score(model, batch, values, path):
    given = pyro.poutine.condition(model, {**values, "states": path})
    return pyro.poutine.trace(given).get_trace(batch).log_prob_sum()


@pytest.mark.parametrize("ran_before", [False, True])
def test_numbers_hold_a_parameter(ran_before):
    model = build()
    batch = model.simulate(4, 3, num_windows=2, seed=0).batch()
    if ran_before:
        model(batch)
    held = {
        "gain": 2,
        "transition.noise": "0.7",
        "push": [1.0, -1.0],
        "reach": "3.0",
        "network.0.bias": 0.25,
        "network.2.weight": torch.ones(2, 8),
    }
    with_priors(model, held)
    assert priors_of(model) == []
    trace = pyro.poutine.trace(model).get_trace(batch)
    assert "transition.push" not in trace.stochastic_nodes
    law = model.transition
    assert (float(law.gain), float(law.reach)) == (2.0, 3.0)
    assert float(law.noise) == pytest.approx(0.7)
    assert law.push.tolist() == [1.0, -1.0]
    assert law.network[0].bias.tolist() == [0.25] * 8
    learned = {name for name, value in model.named_parameters() if value.requires_grad}
    assert learned == {"transition.network.0.weight"}
    # What is held may be let go again.
    with_priors(model, {"gain": "Normal(0, 1)"})
    assert priors_of(model) == ["transition.gain"]


@pytest.mark.parametrize("ran_before", [False, True])
def test_priors_are_put_on_any_parameter(ran_before):
    """Given the values that it had, the model differs by the density of the priors alone."""
    model, twin = build(), build()
    own = {"transition.push": torch.tensor([0.1, -0.2]), "transition.reach": torch.tensor(0.7)}
    drawn = twin.simulate(6, 3, num_windows=2, values=own)
    batch = drawn.batch()
    if ran_before:
        score(model, batch, own, drawn.states)
        pyro.clear_param_store()
    new = {
        "transition.gain": dist.Normal(0.0, 2.0),
        "transition.noise": dist.LogNormal(-1.0, 0.5),
        "emission.noise": dist.LogNormal(torch.tensor([-2.0, -2.0]), 0.3),
        "transition.network.0.weight": dist.Normal(0.0, 0.3),
        "transition.network.2.weight": dist.Normal(torch.zeros(2, 8), 0.5),
    }
    given = {
        "gain": new["transition.gain"],
        "transition.noise": "LogNormal(-1, 0.5)",
        "emission.noise": "LogNormal([-2, -2], 0.3)",
        "network.0.weight": "Normal(0, 0.3)",
        "transition.network.2.weight": new["transition.network.2.weight"],
    }
    assert with_priors(model, given) is model
    assert sorted(priors_of(model)) == sorted([*own, *new])
    values = {
        "transition.gain": torch.tensor(0.5),
        "transition.noise": torch.tensor(0.2),
        "emission.noise": torch.tensor([0.1, 0.1]),
        "transition.network.0.weight": twin.transition.network[0].weight.detach(),
        "transition.network.2.weight": twin.transition.network[2].weight.detach(),
    }
    expected = score(twin, batch, own, drawn.states)
    for name, value in values.items():
        expected = expected + new[name].log_prob(value).sum()
    found = score(model, batch, {**own, **values}, drawn.states)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-3)
    left = {name for name, _ in model.named_parameters()}
    assert left == {"transition.network.0.bias"}
    again = model.simulate(6, 3, seed=1)
    assert again.parameters["transition.network.0.weight"].shape == (8, 4)


def test_a_prior_may_replace_a_prior():
    model = build()
    with_priors(model, {"push": "Normal(0, 3)", "reach": "Uniform(0.5, 2)"})
    push = model.transition._pyro_samples["push"]
    torch.testing.assert_close(push.variance, torch.tensor([9.0, 9.0]))
    # A narrow prior does not keep a wide one out, and a positive one a real one does.
    with_priors(model, {"reach": "LogNormal(0, 1)"})
    with pytest.raises(InputError, match=r"transition\.reach: it must be positive"):
        with_priors(model, {"reach": "Normal(0, 1)"})


def test_a_gain_of_all_may_become_one_of_each():
    model = build()
    with_priors(model, {"gain": dist.LogNormal(torch.zeros(3), 1.0)})
    assert model.simulate(4, 3).parameters["transition.gain"].shape == (3,)


def test_weights_with_a_prior_are_learned_by_an_automatic_guide():
    def random():
        model = build()
        model.emission = ExactEmission()
        return with_priors(model, {"network.0.weight": "Normal(0, 0.3)"})

    batch = random().simulate(6, 3, num_windows=2).batch()
    for local in (True, False):
        pyro.clear_param_store()
        with pyro.settings.context(module_local_params=local):
            fresh = random()
            guide = AutoNormal(fresh, init_scale=0.05)
            svi = SVI(fresh, guide, pyro.optim.Adam({"lr": 0.01}), Trace_ELBO())
            loss = Trace_ELBO()(fresh, guide) if local else None
            bias = fresh.transition.network[0].bias.detach().clone()
            last = fresh.transition.network[2].weight.detach().clone()
            for _ in range(3):
                if loss is None:
                    svi.step(batch)
                    continue
                loss(batch).backward()
                with torch.no_grad():
                    for weight in loss.parameters():
                        weight -= 1e-4 * weight.grad
                        weight.grad = None
            assert guide.median()["transition.network.0.weight"].shape == (8, 4)
            # The other weights are still learned as points.
            assert not torch.equal(bias, fresh.transition.network[0].bias)
            assert not torch.equal(last, fresh.transition.network[2].weight)


@pytest.mark.parametrize(
    ("priors", "message"),
    [
        (
            {"cohesion": "Normal(0, 1)"},
            r"no parameter 'cohesion'. Those there are: initial.mean, .*, emission.noise\.",
        ),
        (
            {"noise": "LogNormal(0, 1)"},
            r"noise may be any of transition.noise, emission.noise. Give the full name",
        ),
        ({"weight": "Normal(0, 1)"}, r"weight may be any of transition.network.0.weight, "),
        ({"": "Normal(0, 1)"}, "no parameter ''"),
        ({"network": "Normal(0, 1)"}, "no parameter 'network'"),
        ({"ain": "Normal(0, 1)"}, "no parameter 'ain'"),
        (
            {"transition.noise": "Normal(0, 1)"},
            r"prior: transition.noise: it must be positive, and .* either sign.*LogNormal",
        ),
        ({"emission.noise": "Normal(0, 1)"}, r"emission.noise: it must be positive"),
        ({"reach": "Normal(0, 1)"}, r"transition.reach: it must be positive"),
        (
            {"emission.noise": "LogNormal([0, 0, 0], 1)"},
            r"emission.noise: it must be a number or \(2,\) in shape, and it is \(3,\)",
        ),
        ({"push": "Normal([0, 0, 0], 1)"}, r"must be \(2,\) in shape, and it is \(3,\)"),
        ({"network.2.weight": "Normal([0, 0], 1)"}, r"\(2, 8\) in shape, and it is \(2,\)"),
        ({"gain": True}, "transition.gain must be a number, a distribution .* not bool"),
        ({"gain": object()}, "transition.gain must be a distribution .* not object"),
        ({"emission.noise": -1.0}, r"emission.noise: it must be positive, and it is -1"),
        ({"push": [0.0, 0.0, 0.0]}, r"must be \(2,\) in shape, and it is \(3,\)"),
        ({"push": "[1, [2]]"}, "push must be a number"),
        ({"gain": dist.Poisson(3.0)}, "may be whole numbers"),
        ({"gain": "Normal(0)"}, "lacks scale"),
        (
            {"gain": "Normal(0, 1)", "transition.gain": "Normal(0, 2)"},
            r"transition.gain is given twice",
        ),
    ],
)
def test_a_prior_that_does_not_fit_is_refused_and_changes_nothing(priors, message):
    model = build()
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with pytest.raises(InputError, match=message):
        with_priors(model, {"network.0.bias": "Normal(0, 1)", **priors})
    assert list(before) == list(model.state_dict())
    assert priors_of(model) == ["transition.push", "transition.reach"]
    assert type(model.transition.network) is nn.Sequential


def test_a_prior_may_replace_one_that_hangs_on_others():
    model = build()
    own = PyroSample(lambda self: dist.LogNormal(self.push.sum(), 1.0).expand([3]))
    assign(model.transition, "gain", own)
    with_priors(model, {"gain": "LogNormal(0, 1)"})
    assert model.transition._pyro_samples["gain"].event_shape == (3,)
    assign(model.transition, "gain", own)
    with pytest.raises(InputError, match="positive"):
        with_priors(model, {"gain": "Normal(0, 1)"})


def test_intervals_and_structures_are_compared():
    positive, unit = constraints.positive, constraints.unit_interval
    assert covers(positive, dist.Uniform(0.0, 2.0).support)
    assert not covers(positive, dist.Uniform(-1.0, 2.0).support)
    assert covers(unit, dist.Beta(1.0, 1.0).support)
    assert covers(unit, dist.Uniform(0.2, 0.8).support)
    assert not covers(unit, dist.HalfNormal(1.0).support)
    assert covers(constraints.real, dist.Dirichlet(torch.ones(3)).support)
    assert not covers(constraints.lower_cholesky, dist.Normal(0.0, 1.0).support)
    assert covers(constraints.simplex, dist.Dirichlet(torch.ones(3)).support)
    words = {
        constraints.greater_than(2.0): "greater than 2",
        constraints.less_than(2.0): "less than 2",
        constraints.interval(1.0, 3.0): "between 1 and 3",
        constraints.nonnegative: "0 or more",
        constraints.lower_cholesky: "a lower triangular matrix with a positive diagonal",
        constraints.simplex: "fractions that sum to 1",
    }
    assert {describe(constraint) for constraint in words} == set(words.values())


@pytest.mark.parametrize(
    "prior",
    [
        dist.Gamma(2.0, 1.0),
        torch.distributions.Gamma(2.0, 1.0),
        dist.LogNormal(torch.tensor(-1.0 / 3.0), 0.5),
        dist.Normal(torch.tensor([0.0, 1.0]), 2.0).to_event(1),
        dist.HalfNormal(0.3).expand([3]).to_event(1),
        dist.StudentT(4.0, 0.0, 2.0),
        dist.MultivariateNormal(torch.zeros(2), torch.tensor([[2.0, 0.5], [0.5, 1.0]])),
    ],
)
def test_a_distribution_is_stored_as_text_that_makes_the_same_one(prior):
    settings = FitSettings(priors={"pull": prior})
    again = parse_distribution(settings.priors["pull"])
    assert again.batch_shape + again.event_shape == prior.batch_shape + prior.event_shape
    value = prior.sample()
    density = prior.log_prob(value).sum()
    torch.testing.assert_close(again.log_prob(value).sum(), density)


def test_a_distribution_that_has_no_text_is_refused():
    odd = dist.TransformedDistribution(
        dist.Normal(0.0, 1.0), [torch.distributions.transforms.TanhTransform()]
    )
    with pytest.raises(InputError, match="pull: prior: a TransformedDistribution cannot be"):
        settings_from({"priors": {"pull": odd}})
