"""Fixed, learned and random parameters, under the handlers that Pyro has."""

import copy

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import SVI, Predictive, Trace_ELBO
from pyro.infer.autoguide import AutoNormal
from pyro.infer.mcmc import MCMC, NUTS
from pyro.nn import PyroModule, PyroParam, PyroSample
from torch import nn
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.models import InitialStates, KinematicTransition, StateSpaceModel, assign
from swarmssm.models.parameters import convert_priors, fixed, priors_of

POSITIVE = constraints.positive


class LocalPyroModule(PyroModule):
    """A part with one parameter, which it returns."""

    def __init__(self, value, **options):
        super().__init__()
        assign(self, "gain", value, **options)

    def forward(self):
        return self.gain


def test_a_fixed_parameter_is_a_buffer_of_the_usual_type():
    for value in (2, 2.0, np.float32(2.0), np.float64(2.0), torch.tensor(2), np.array(2.0)):
        part = LocalPyroModule(value)
        assert torch.equal(part.gain, torch.tensor(2.0))
        assert list(part.state_dict()) == ["gain"]
        assert not list(part.parameters())
    assert torch.equal(LocalPyroModule([1, 2.5]).gain, torch.tensor([1.0, 2.5]))
    assert LocalPyroModule(torch.tensor(0.1, dtype=torch.float64)).gain.dtype == torch.float64


def test_a_fixed_parameter_that_had_a_gradient_is_cut_off():
    value = torch.tensor(1.0, requires_grad=True)
    assert not LocalPyroModule(value * 2).gain.requires_grad


def test_learned_parameters():
    part = LocalPyroModule(nn.Parameter(torch.tensor([1.0, -2.0])))
    assert [name for name, _ in part.named_parameters()] == ["gain"]
    # A parameter that must be positive is learned on the logarithmic scale.
    held = LocalPyroModule(nn.Parameter(torch.tensor(0.5)), constraint=POSITIVE)
    torch.testing.assert_close(held.gain, torch.tensor(0.5))
    optimizer = torch.optim.SGD(held.parameters(), lr=10.0)
    held.gain.backward()
    optimizer.step()
    assert 0.0 < held.gain < 0.5
    own = LocalPyroModule(
        PyroParam(torch.tensor(0.5), constraints.interval(0.0, 2.0)), constraint=POSITIVE
    )
    torch.testing.assert_close(own.gain, torch.tensor(0.5))


def test_a_prior_is_one_site_whatever_its_shape():
    for prior, shape in [
        (dist.Normal(0.0, 1.0), ()),
        (dist.Normal(torch.zeros(3), 1.0), (3,)),
        (dist.Normal(torch.zeros(3), 1.0).to_event(1), (3,)),
        (dist.Normal(0.0, 1.0).expand([2, 3]), (2, 3)),
        (dist.MultivariateNormal(torch.zeros(2), torch.eye(2)), (2,)),
        (dist.LogNormal(0.0, 1.0).expand([4]), (4,)),
    ]:
        part = LocalPyroModule(prior)
        trace = pyro.poutine.trace(part).get_trace()
        trace.compute_log_prob()
        site = trace.nodes["gain"]
        assert site["value"].shape == shape
        assert site["fn"].batch_shape == ()
        assert site["log_prob"].shape == ()
        assert torch.equal(trace.nodes["_RETURN"]["value"], site["value"])
        torch.testing.assert_close(site["log_prob"], prior.log_prob(site["value"]).sum())


def test_a_parameter_may_be_given_again_and_as_something_else():
    part = LocalPyroModule(1.0)
    ways = [
        2.0,
        dist.Normal(0.0, 1.0),
        nn.Parameter(torch.tensor(3.0)),
        PyroParam(torch.tensor(4.0), POSITIVE),
        torch.tensor(5.0),
        PyroParam(torch.tensor(4.0), POSITIVE),
        dist.LogNormal(0.0, 1.0),
        PyroSample(dist.Normal(0.0, 2.0)),
        nn.Parameter(torch.tensor(6.0)),
        7.0,
    ]
    for value in ways:
        assign(part, "gain", value)
        random = isinstance(value, dist.Distribution | PyroSample)
        assert priors_of(part) == (["gain"] if random else [])
        assert len(list(part.parameters())) == isinstance(value, nn.Parameter | PyroParam)
        trace = pyro.poutine.trace(part).get_trace()
        assert ("gain" in trace.nodes and trace.nodes["gain"]["type"] == "sample") == random
    assert torch.equal(part.gain, torch.tensor(7.0))


def test_what_was_said_of_a_parameter_holds_when_it_is_given_again():
    part = LocalPyroModule(1.0, constraint=POSITIVE, shapes=[()])
    with pytest.raises(InputError, match="gain: it must be positive, and it is -2"):
        assign(part, "gain", -2.0)
    assert torch.equal(part.gain, torch.tensor(1.0))


@pytest.mark.parametrize(
    ("value", "options", "error", "message"),
    [
        (0.0, {"constraint": POSITIVE}, InputError, "must be positive, and it is 0"),
        ([1.0, -1.0], {"constraint": POSITIVE}, InputError, r"positive, and it is \[1, -1\]"),
        (
            3.0,
            {"constraint": constraints.unit_interval},
            InputError,
            "must be between 0 and 1, and it is 3",
        ),
        (float("nan"), {}, InputError, r"it is not a number \(NaN\)"),
        (
            [1.0, 2.0, 3.0],
            {"shapes": [(), (2,)]},
            InputError,
            r"must be a number or \(2,\) in shape, and it is \(3,\)",
        ),
        (
            dist.Normal(torch.zeros(3), 1.0),
            {"shapes": [(), (2,)]},
            InputError,
            r"must be a number or \(2,\) in shape, and it is \(3,\)",
        ),
        (
            dist.Normal(0.0, 1.0),
            {"constraint": POSITIVE},
            InputError,
            "must be positive, and the values of the prior may be of either sign",
        ),
        (
            nn.Parameter(torch.tensor(-1.0)),
            {"constraint": POSITIVE},
            InputError,
            "must be positive, and it is -1",
        ),
        (
            PyroParam(torch.tensor(1.0)),
            {"constraint": POSITIVE},
            InputError,
            "must be positive, and as a PyroParam it is only held to be of either sign",
        ),
        (dist.Poisson(3.0), {}, InputError, "values of the prior may be whole numbers"),
        (object(), {}, TypeError, "gain must be a number, a distribution or a parameter, not ob"),
        ("wide", {}, InputError, "'wide' is no name with arguments in brackets"),
        ("Normal(0, 1)", {"constraint": POSITIVE}, InputError, "gain: it must be positive"),
        (True, {}, TypeError, "not bool"),
        (None, {}, TypeError, "not NoneType"),
        ([[1.0], [1.0, 2.0]], {}, TypeError, "not list"),
        (torch.distributions.Normal(0.0, 1.0), {}, TypeError, "take it from pyro.distributions"),
    ],
)
def test_what_cannot_be_a_parameter_is_refused(value, options, error, message):
    with pytest.raises(error, match=message):
        LocalPyroModule(value, **options)


@pytest.mark.parametrize(
    "prior",
    [
        dist.LogNormal(0.0, 1.0),
        dist.HalfNormal(1.0),
        dist.Uniform(0.1, 3.0),
        dist.Gamma(2.0, 2.0).expand([3]),
        dist.Beta(2.0, 2.0),
    ],
)
def test_any_prior_of_positive_values_is_one_of_a_positive_parameter(prior):
    assert priors_of(LocalPyroModule(prior, constraint=POSITIVE)) == ["gain"]


class Hierarchy(PyroModule):
    """Gains of each individual about one of all."""

    def __init__(self):
        super().__init__()
        assign(self, "middle", dist.Normal(0.0, 1.0))
        assign(self, "spread", dist.HalfNormal(1.0))
        own = PyroSample(lambda self: dist.Normal(self.middle, self.spread).expand([5]))
        assign(self, "gain", own, shapes=[(5,)])
        assign(self, "twice", PyroSample(lambda self: 2.0 * self.gain))

    def forward(self):
        return self.gain, self.twice


def test_a_prior_may_hang_on_other_parameters():
    part = Hierarchy()
    trace = pyro.poutine.trace(part).get_trace()
    gain, twice = trace.nodes["_RETURN"]["value"]
    assert gain.shape == (5,)
    torch.testing.assert_close(twice, 2 * gain)
    middle, spread = trace.nodes["middle"]["value"], trace.nodes["spread"]["value"]
    expected = dist.Normal(0.0, 1.0).log_prob(middle) + dist.HalfNormal(1.0).log_prob(spread)
    expected = expected + dist.Normal(middle, spread).log_prob(gain).sum()
    torch.testing.assert_close(trace.log_prob_sum(), expected)


def test_a_dependent_prior_of_a_wrong_shape_is_refused_when_it_is_made():
    part = LocalPyroModule(PyroSample(lambda self: dist.Normal(torch.zeros(4), 1.0)), shapes=[(5,)])
    with pytest.raises(InputError, match=r"gain: it must be \(5,\) in shape, and it is \(4,\)"):
        part()


class NeighborTerm(KinematicTransition):
    """Velocities relax; the gain and the noise are random."""

    def __init__(self):
        super().__init__(2, 0.5)
        assign(self, "gain", dist.LogNormal(0.0, 0.3))
        assign(self, "noise", dist.LogNormal(-1.0, 0.3), constraint=POSITIVE)

    def velocity(self, positions, velocities, inputs):
        moved = velocities * (1.0 - 0.5 * self.gain.unsqueeze(-1))
        return dist.Normal(moved, self.noise.unsqueeze(-1)).to_event(1)


def exact_model():
    return StateSpaceModel(InitialStates(torch.zeros(4), torch.ones(4)), NeighborTerm(), None)


NAMES = ["transition.gain", "transition.noise"]


@pytest.fixture
def drawn():
    return exact_model().simulate(
        30,
        4,
        num_windows=3,
        values={"transition.gain": torch.tensor(0.6), "transition.noise": torch.tensor(0.3)},
    )


def by_hand(values, states):
    gain, noise = values
    mean = states[:, :-1, :, 2:] * (1 - 0.5 * gain)
    step = dist.Normal(mean, noise).log_prob(states[:, 1:, :, 2:]).sum()
    return dist.Normal(0.0, 1.0).log_prob(states[:, 0]).sum() + step


def test_handlers_that_fix_hide_and_repeat(drawn):
    model, batch = exact_model(), drawn.batch()
    gain, noise = torch.tensor(0.7), torch.tensor(0.4)
    conditioned = pyro.poutine.condition(model, {NAMES[0]: gain})
    trace = pyro.poutine.trace(conditioned).get_trace(batch)
    assert trace.nodes[NAMES[0]]["is_observed"]
    other = trace.nodes[NAMES[1]]["value"]
    prior = dist.LogNormal(0.0, 0.3).log_prob(gain) + dist.LogNormal(-1.0, 0.3).log_prob(other)
    expected = prior + by_hand((gain, other), batch.observations)
    torch.testing.assert_close(trace.log_prob_sum(), expected)

    first = pyro.poutine.trace(model).get_trace(batch)
    again = pyro.poutine.replay(model, trace=first)
    second = pyro.poutine.trace(again).get_trace(batch)
    torch.testing.assert_close(second.log_prob_sum(), first.log_prob_sum())
    for name in NAMES:
        assert torch.equal(first.nodes[name]["value"], second.nodes[name]["value"])

    given = dict(zip(NAMES, (gain, noise), strict=True))
    hidden = pyro.poutine.block(pyro.poutine.condition(model, given), hide=NAMES)
    trace = pyro.poutine.trace(hidden).get_trace(batch)
    assert not set(NAMES) & set(trace.nodes)
    torch.testing.assert_close(trace.log_prob_sum(), by_hand((gain, noise), batch.observations))


def test_each_call_draws_anew(drawn):
    model, batch = exact_model(), drawn.batch()
    first, second = (pyro.poutine.trace(model).get_trace(batch) for _ in range(2))
    assert first.nodes[NAMES[0]]["value"] != second.nodes[NAMES[0]]["value"]
    for trace in (first, second):
        values = [trace.nodes[name]["value"] for name in NAMES]
        trace.compute_log_prob()
        torch.testing.assert_close(
            trace.nodes["states"]["log_prob"].sum(), by_hand(values, batch.observations)
        )


def test_a_failed_call_leaves_nothing_behind(drawn):
    model, batch = exact_model(), drawn.batch()
    given = {NAMES[0]: torch.tensor(9.0), NAMES[1]: torch.tensor(8.0)}
    with pytest.raises(ZeroDivisionError), model.fixed(given):
        1 / (model.sample_globals()[NAMES[0]].item() - 9.0)
    context = model._pyro_context
    assert not context.active
    assert not context.cache
    with pytest.raises(ZeroDivisionError), fixed(model, given), fixed(model, {}):
        raise ZeroDivisionError
    assert not context.cache
    trace = pyro.poutine.trace(model).get_trace(batch)
    assert trace.nodes[NAMES[0]]["value"] != 9.0


def test_fixed_values_hold_inside_and_those_of_outside_come_back():
    model = exact_model()
    one, two = ({NAMES[0]: torch.tensor(v), NAMES[1]: torch.tensor(v)} for v in (1.0, 2.0))
    with model.fixed(one):
        with model.fixed(two):
            assert model.sample_globals() == two
        assert model.sample_globals() == one
    assert model.sample_globals() != one


def test_names_that_are_none_are_refused(drawn):
    model = exact_model()
    message = "transition.gian is no parameter with a prior. Those there are: transition.gain, "
    with pytest.raises(InputError, match=message), model.fixed({"transition.gian": 1.0}):
        pass
    with pytest.raises(InputError, match=r"transition\.noise is missing; it has a prior"):
        model.chain(drawn.batch(), {NAMES[0]: torch.tensor(1.0)})


def test_predictive_draws_one_by_one_and_refuses_all_at_once(drawn):
    model, batch = exact_model(), drawn.batch()
    samples = Predictive(model, num_samples=3)(batch)
    assert samples[NAMES[0]].shape == (3, 1)
    # Its own samples have a dimension for the plate of windows.
    again = Predictive(model, samples, return_sites=("states", *NAMES))(batch)
    assert torch.equal(again["states"], batch.observations.expand(3, *batch.observations.shape))
    assert torch.equal(again[NAMES[0]].flatten(), samples[NAMES[0]].flatten())
    with pytest.raises(InputError, match=r"its prior, \(\), and this one has \(3, 1\).*parallel"):
        Predictive(model, num_samples=3, parallel=True)(batch)


def test_nuts_on_parameters_alone_finds_the_posterior(drawn):
    """The posterior of a gain and a noise on a grid, and by NUTS."""
    model, batch = exact_model(), drawn.batch()

    def density():
        values = model.sample_globals()
        chain = model.chain(batch, values)
        pyro.factor("evidence", chain.log_prob(batch.observations).sum())

    pyro.set_rng_seed(0)
    number = 100
    sampler = MCMC(NUTS(density), num_samples=number, warmup_steps=60, disable_progbar=True)
    sampler.run()
    samples = sampler.get_samples()
    assert set(samples) == set(NAMES)

    gains = torch.linspace(0.4, 0.8, 161)
    noises = torch.linspace(0.25, 0.35, 161)
    states = batch.observations
    before, after = states[:, :-1, :, 2:].flatten(), states[:, 1:, :, 2:].flatten()
    squares = ((after - before * (1 - 0.5 * gains[:, None])) ** 2).sum(-1)
    score = -len(after) * noises.log() - 0.5 * squares[:, None] / noises**2
    score = score + dist.LogNormal(0.0, 0.3).log_prob(gains)[:, None]
    score = score + dist.LogNormal(-1.0, 0.3).log_prob(noises)
    weight = (score - score.max()).exp()
    for name, grid, own in zip(NAMES, (gains, noises), (weight.sum(1), weight.sum(0)), strict=True):
        own = own / own.sum()
        mean = (grid * own).sum()
        sd = ((grid - mean) ** 2 * own).sum().sqrt()
        # The chain is correlated: at the least a quarter of its draws count.
        assert (samples[name].mean() - mean).abs() < 5 * sd / (number / 4) ** 0.5
        assert 0.6 < samples[name].std() / sd < 1.6


def test_parts_in_plain_containers_are_parts_all_the_same():
    class Several(NeighborTerm):
        def __init__(self):
            super().__init__()
            self.parts = nn.ModuleList([LocalPyroModule(dist.Normal(0.0, 1.0)) for _ in range(2)])

        def velocity(self, positions, velocities, inputs):
            push = sum(part() for part in self.parts)
            return dist.Normal(velocities + push, 0.1).to_event(1)

    model = StateSpaceModel(InitialStates(torch.zeros(4), torch.ones(4)), Several(), None)
    names = [*NAMES, "transition.parts.0.gain", "transition.parts.1.gain"]
    assert priors_of(model) == names
    batch = model.simulate(3, 2).batch()
    trace = pyro.poutine.trace(model).get_trace(batch)
    assert [name for name in trace.nodes if name in names] == names
    push = sum(trace.nodes[name]["value"] for name in names[2:])
    trace.compute_log_prob()
    states = batch.observations
    expected = dist.Normal(0.0, 1.0).log_prob(states[:, 0]).sum()
    steps = dist.Normal(states[:, :-1, :, 2:] + push, 0.1).log_prob(states[:, 1:, :, 2:])
    expected = expected + steps.sum()
    torch.testing.assert_close(trace.nodes["states"]["log_prob"].sum(), expected)


def test_an_automatic_guide_and_svi_learn_them(drawn):
    model, batch = exact_model(), drawn.batch()
    with pyro.settings.context(module_local_params=True):
        guide = AutoNormal(model, init_scale=0.05)
        svi = SVI(model, guide, pyro.optim.Adam({"lr": 0.05}), Trace_ELBO())
        for _ in range(150):
            svi.step(batch)
        found = guide.median()
    # 3 swarms of 4, 29 steps, 2 axes: the noise is known to 1 / sqrt(2 * 696) of itself.
    assert abs(found[NAMES[1]] - 0.3) < 5 * 0.3 / (2 * 696) ** 0.5


def test_types_of_priors_follow_those_of_the_model():
    model = exact_model()
    assign(model.transition, "drift", dist.Normal(torch.zeros(2), 1.0))
    shifted = [dist.transforms.AffineTransform(torch.tensor(2.0), torch.tensor(1.0))]
    assign(
        model.transition, "shifted", dist.TransformedDistribution(dist.LogNormal(0.0, 1.0), shifted)
    )
    model.double()
    values = model.sample_globals()
    assert {value.dtype for value in values.values()} == {torch.float64}
    prior = model.transition._pyro_samples["shifted"]
    value = torch.tensor(2.5, dtype=torch.float64)
    expected = dist.LogNormal(0.0, 1.0).log_prob(value - 2.0)
    torch.testing.assert_close(prior.log_prob(value), expected)
    model.float()
    assert {value.dtype for value in model.sample_globals().values()} == {torch.float32}
    # The user's own distribution is as it was.
    own = dist.Normal(torch.zeros(2), 1.0)
    part = LocalPyroModule(own)
    convert_priors(part, torch.Tensor.double)
    assert own.loc.dtype == torch.float32


def test_a_copy_of_a_model_is_one_of_its_own():
    model = exact_model()
    twin = copy.deepcopy(model)
    assign(twin.transition, "gain", 5.0)
    assert priors_of(model) == NAMES
    assert priors_of(twin) == NAMES[1:]
    with twin.fixed({NAMES[1]: torch.tensor(2.0)}):
        assert twin.sample_globals() == {NAMES[1]: torch.tensor(2.0)}
        assert not model._pyro_context.active
