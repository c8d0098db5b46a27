"""Simulation-based calibration: exact posteriors pass, too sure and biased ones do not."""

import json
import math

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from scipy import stats

from swarmssm.analysis.diagnostics.sbc import study as module
from swarmssm.analysis.diagnostics.sbc.ranks import Calibration, calibration_of_ranks
from swarmssm.analysis.diagnostics.sbc.simulated import (
    FixedModel,
    SimulatedData,
    standard_scales,
)
from swarmssm.analysis.diagnostics.sbc.study import sbc
from swarmssm.errors import InputError, WorkError
from swarmssm.inference.guides import LinearizedGuide
from swarmssm.jobs import Progress
from swarmssm.models.parameters import priors_of
from swarmssm.models.presets import linear

#: A linear swarm that holds together: everything but the guide's Laplace step is exact.
PRIORS = {
    "cohesion_gain": "Normal(1, 0.2)",
    "alignment_gain": "Normal(1, 0.2)",
    "damping": "LogNormal(-0.7, 0.3)",
    "homing_gain": "LogNormal(-0.7, 0.3)",
    "process_noise": "LogNormal(-1.9, 0.2)",
    "emission.noise": "LogNormal(-3.5, 0.2)",
}
TINY = {"frames": 5, "individuals": 2, "trials": 1, "priors": PRIORS, "draws": 19}
#: With ranks of the states besides.
PATHS = {"seed": 1, "path_draws": 3}


def conjugate_ranks(number: int, draws: int, *, sd: float = 1.0, shift: float = 0.0) -> np.ndarray:
    """Ranks of a normal mean, prior N(0, 1), five observations of variance 1.

    The posterior is N(s / 6, 1 / 6); ``sd`` and ``shift`` (in its deviations) spoil it.
    """
    rng = np.random.default_rng(0)
    truth = rng.standard_normal(number)
    total = (truth[:, None] + rng.standard_normal((number, 5))).sum(-1)
    deviation = math.sqrt(1 / 6)
    centre = total / 6 + shift * deviation
    posterior = centre[:, None] + sd * deviation * rng.standard_normal((number, draws))
    return (posterior < truth[:, None]).sum(-1)


@pytest.fixture(scope="module")
def toy():
    return calibration_of_ranks(
        {
            "exact": conjugate_ranks(200, 199),
            "too_sure": conjugate_ranks(200, 199, sd=0.6),
            "too_wide": conjugate_ranks(200, 199, sd=1.6),
            "too_high": conjugate_ranks(200, 199, shift=0.5),
        },
        199,
    )


def test_an_exact_posterior_passes_and_others_do_not(toy):
    assert toy["passes"].values.tolist() == [1, 0, 0, 0]
    assert toy["p_value"].values[0] > 0.05
    assert (toy["p_value"].values[1:] < 0.001).all()


def test_coverage_is_what_a_spoilt_posterior_has(toy):
    # Intervals of z sd: truth minus centre is N(0, 1) deviations, so that coverage is known.
    for name, factor in (("exact", 1.0), ("too_sure", 0.6), ("too_wide", 1.6)):
        for level in (0.5, 0.8, 0.9, 0.95):
            z = stats.norm.ppf(0.5 + 0.5 * level) * factor
            wanted = 2 * stats.norm.cdf(z) - 1
            found = float(toy["coverage"].sel(parameter=name, level=level))
            # 6 binomial errors, and what quantiles of 199 draws add.
            assert abs(found - wanted) < 6 * math.sqrt(wanted * (1 - wanted) / 200) + 0.01


def test_levels_are_hit_exactly_with_199_draws(toy):
    assert toy["expected_coverage"].values == pytest.approx([0.5, 0.8, 0.9, 0.95])
    few = calibration_of_ranks({"a": np.arange(10)}, 9)
    # Of ranks 0 to 9, the middle one to eight places are within 0.5 and 0.8; 0.9 adds the rest.
    assert few["expected_coverage"].values == pytest.approx([0.6, 0.8, 1.0, 1.0])


def test_bounds_of_a_coverage_are_clopper_and_pearsons():
    found = calibration_of_ranks({"a": [5] * 9 + [0]}, 10).sel(parameter="a", level=0.5)
    assert float(found["coverage"]) == 0.9
    interval = stats.binomtest(9, 10).proportion_ci(0.95, method="exact")
    assert float(found["coverage_low"]) == pytest.approx(interval.low)
    assert float(found["coverage_high"]) == pytest.approx(interval.high)


def test_histogram_counts_every_rank(toy):
    assert (toy["histogram"].sum("bin") == 200).all()
    assert float(toy["expected"].sum()) == pytest.approx(200)
    assert toy.sizes["bin"] == 20


def test_the_verdict_names_what_is_wrong(toy):
    exact = Calibration(calibration_of_ranks({"exact": conjugate_ranks(200, 199)}, 199))
    assert exact.verdict().startswith("Calibrated")
    verdict = Calibration(toy).verdict()
    assert verdict.startswith("Not calibrated: the ranks of 3 of 4 quantities")
    assert "estimates too high" in verdict
    assert "estimates too low" not in verdict
    summary = Calibration(toy).summary()
    assert summary["in_band"].tolist() == [True, False, False, False]
    assert summary.loc["exact", "coverage_90"] == float(
        toy["coverage"].sel(parameter="exact", level=0.9)
    )
    assert len(Calibration(toy).to_pandas()) == 4 * 200


@pytest.mark.parametrize("ranks", [{}, {"a": []}, {"a": [1, 2], "b": [1]}])
def test_ranks_that_do_not_go_together(ranks):
    with pytest.raises(InputError, match="ranks"):
        calibration_of_ranks(ranks, 10)


def test_truths_are_drawn_from_the_priors():
    model = FixedModel("linear", standard_scales(2), {}, PRIORS)
    data = SimulatedData(model, 2, 2, 1)
    number = 100
    drawn = [data.draw(seed) for seed in range(number)]
    for name, mean, sd, log in (
        ("transition.cohesion_gain", 1.0, 0.2, False),
        ("emission.noise", -3.5, 0.2, True),
    ):
        values = np.array([float(truth[name]) for _, truth, _ in drawn])
        values = np.log(values) if log else values
        assert abs(values.mean() - mean) < 6 * sd / math.sqrt(number)
        # The error of a standard deviation is sd / sqrt(2 n).
        assert abs(values.std() - sd) < 6 * sd / math.sqrt(2 * number)
    # First states are the model's: as wide as the box of side sqrt(12), and the measured speed.
    first = torch.cat([states[0, 0] for _, _, states in drawn])
    # The speed of 1, and what noise of 0.03 adds to differences over 0.1 s.
    speed = math.sqrt(1.0 + 4 * (0.03 / 0.1) ** 2)
    assert abs(float(first[:, 2:].std()) / speed - 1.0) < 6 / math.sqrt(2 * 4 * number)
    assert abs(float(first[:, :2].std()) / math.sqrt(12) - 1.0) < 6 / math.sqrt(2 * 4 * number)
    # What is seen differs from the states by noise that was drawn.
    offs = np.concatenate(
        [
            (tracks["position"].transpose(..., "individual", "space") - states[..., :2].numpy())
            .to_numpy()
            .ravel()
            / float(truth["emission.noise"])
            for tracks, truth, states in drawn
        ]
    )
    assert abs(offs.std() - 1.0) < 6 / math.sqrt(2 * len(offs))


def test_wide_priors_are_narrowed_and_others_kept():
    model = FixedModel("linear", standard_scales(2), spread=0.5)()
    prior = model.transition._pyro_samples["damping"]
    assert float(prior.scale) == 0.5
    # The median is U / L = 1 in these scales.
    assert float(prior.loc) == pytest.approx(0.0, abs=1e-6)
    assert isinstance(model.transition._pyro_samples["cohesion_gain"], dist.Normal)
    wide = FixedModel("linear", standard_scales(2), spread=None)()
    assert float(wide.transition._pyro_samples["damping"].scale) == 1.5


def test_the_prior_does_not_depend_on_the_tracks():
    fixed = FixedModel("linear", standard_scales(3))
    other = standard_scales(3, noise=7.0)
    one, two = fixed(standard_scales(3)), fixed(other)
    for name in priors_of(one):
        place, _, own = name.rpartition(".")
        mine = one.get_submodule(place)._pyro_samples[own]
        theirs = two.get_submodule(place)._pyro_samples[own]
        assert float(mine.mean) == float(theirs.mean)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study of two data sets and its file."""
    out = tmp_path_factory.mktemp("study") / "sbc.jsonl"
    return sbc("linear", datasets=2, out=out, **TINY, **PATHS).data, out


def test_the_same_data_set_whatever_their_number(study):
    found, _ = study
    alone = sbc("linear", datasets=1, **TINY, seed=PATHS["seed"]).data
    parameters = alone["parameter"].values
    own = found.sel(parameter=parameters)
    assert alone["truth"].values[:, 0].tolist() == own["truth"].values[:, 0].tolist()
    assert alone["rank"].values[:, 0].tolist() == own["rank"].values[:, 0].tolist()
    assert (own["truth"].values[:, 0] != own["truth"].values[:, 1]).all()


def test_gone_on_with_after_a_power_cut(study, tmp_path):
    whole, kept = study
    out = tmp_path / "sbc.jsonl"
    out.write_bytes(kept.read_bytes()[:-30])
    told: list[Progress] = []
    again = sbc("linear", datasets=2, out=out, resume=True, progress=told.append, **TINY, **PATHS)
    assert [count.done for count in told] == [1, 2]
    again = again.data
    assert again.drop_vars("seconds").identical(whole.drop_vars("seconds"))
    states = [str(name) for name in whole["parameter"].values if str(name).startswith("states.")]
    assert states == list(module.STATE_QUANTITIES)
    with pytest.raises(InputError, match=r"other settings \(frames\)"):
        sbc("linear", datasets=2, out=out, resume=True, **{**TINY, **PATHS, "frames": 9})


def test_given_frames_are_none_unless_asked_for(study, monkeypatch):
    found, _ = study
    assert json.loads(found.attrs["settings"])["fit"]["guide_options"] == {"given": 0}
    asked = []

    def fit(*arguments, **settings):
        asked.append(settings["guide_options"])
        raise WorkError("No maximum.")

    monkeypatch.setattr(module.inference, "fit", fit)
    for options in ({}, {"guide_options": {"given": 2}}):
        with pytest.raises(WorkError, match="fit: No maximum"):
            sbc("linear", datasets=1, **options, **TINY)
    assert asked == [{"given": 0}, {"given": 2}]


def test_failures_are_counted_and_not_hidden(monkeypatch):
    drawn = SimulatedData.draw

    def draw(self, seed, values=None):
        draw.calls += 1
        if draw.calls % 2:
            raise WorkError("The group flew apart.")
        return drawn(self, seed, values)

    draw.calls = 0
    monkeypatch.setattr(SimulatedData, "draw", draw)
    calibration = sbc("linear", datasets=3, **TINY)
    found = calibration.data
    assert found.attrs["failed"] == 2
    assert found.attrs["failures"] == "2 x simulation: The group flew apart."
    assert found.sizes["dataset"] == 1
    assert "2 further data sets failed" in calibration.verdict()
    draw.calls = 0
    with pytest.raises(WorkError, match="All 1 data sets failed"):
        sbc("linear", datasets=1, **TINY)


def test_a_group_that_flies_apart_is_told_of():
    away = FixedModel(
        "linear",
        standard_scales(2),
        {"homing": False},
        {
            "cohesion_gain": "Normal(-1e6, 1)",
        },
    )
    with pytest.raises(WorkError):
        SimulatedData(away, 100, 2, 1).draw(0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"model": "graph-vae"}, "no state-space model"),
        ({"model": "graph-ssm", "priors": {}}, "weights without a prior"),
        ({"model": "nothing"}, "nothing"),
        ({"datasets": 0}, "datasets: it must be a whole number from 1"),
        ({"draws": 0}, "draws"),
        ({"frames": 2.5}, "frames"),
        ({"path_draws": -1}, "path_draws"),
        ({"seed": -1}, "seed"),
        ({"model_options": {"nonsense": 1}}, "nonsense"),
        ({"priors": {"nonsense": "Normal(0, 1)"}}, "nonsense"),
        ({"graph": "nonsense"}, "nonsense"),
        ({"nonsense": 1}, "nonsense"),
        ({"guide": "nothing"}, "nothing"),
    ],
)
def test_mistakes(options, words):
    given = {**TINY, "model": "linear", "datasets": 1, **options}
    with pytest.raises(InputError, match=words):
        sbc(**given)


def test_a_model_without_priors_has_nothing_to_rank():
    def bare(scales):
        made = linear(scales)
        for name in priors_of(made):
            place, _, own = name.rpartition(".")
            module = made.get_submodule(place)
            del module._pyro_samples[own]
            setattr(module, own, torch.tensor(0.1))
        return made

    with pytest.raises(InputError, match="no parameter with a prior"):
        sbc(bare, "linearized", datasets=1, **TINY | {"priors": {}})


class TooSure(LinearizedGuide):
    """A guide whose posterior of the parameters is a third as wide as it found."""

    def __init__(self, model, **options):
        super().__init__(model, given=0, **options)
        draw = self.parameters_guide.draw

        def shrunk(draws):
            middle = self.parameters_guide.median()
            return {
                name: middle[name] + (value - middle[name]) / 3.0
                for name, value in draw(draws).items()
            }

        self.parameters_guide.draw = shrunk


@pytest.mark.slow
def test_the_exact_guide_of_a_linear_swarm_passes_and_one_too_sure_does_not():
    sizes = {"frames": 30, "individuals": 3, "trials": 2, "priors": PRIORS, "draws": 99}
    right = sbc("linear", "linearized", datasets=40, **sizes)
    # Six quantities: at a level of 0.05 / 6 all of them pass with 95 %.
    assert (right.data["p_value"].values > 0.05 / 6).all()
    wrong = sbc("linear", TooSure, datasets=40, **sizes)
    assert (wrong.data["p_value"].values < 0.05 / 6).sum() >= 4
