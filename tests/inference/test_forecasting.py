"""Predictions, forecasts and free runs: what they know, and what they leave open."""

import dataclasses
import math

import numpy as np
import pytest
import torch
import xarray as xr

from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import GraphRule, add_adjacency
from swarmssm.inference import fit
from swarmssm.inference.guides import OneStepGuide
from swarmssm.inference.prediction import OneStepPredictor
from swarmssm.inference.starting import MAX_CARRY
from swarmssm.models import NextStep, OneStepModel
from swarmssm.simulate import simulate_boids
from swarmssm.tracks import make_tracks, validate_tracks

ORDER = ("trial", "time", "individual", "space")


@pytest.fixture(scope="module")
def visual(with_gaps, brief):
    """Return a fit in which velocities, and what each sees, follow from the positions."""
    return fit(tracks=with_gaps, graph="visual:0.5", **brief)


def until(tracks, frames):
    return tracks.isel(time=slice(0, frames))


def scrambled_after(tracks, frames):
    """Return tracks whose later frames are somebody else's."""
    other = tracks.copy(deep=True)
    for name in ("position", "velocity"):
        if name in other:
            values = other[name].to_numpy()[:, frames:]  # (trial, time, space, individual)
            values[:] = 1 - 3 * values[..., ::-1]
    if "adjacency" in other:
        edges = other["adjacency"].to_numpy()[:, frames:]
        edges[:] = edges.swapaxes(-1, -2)
    return other


@pytest.mark.parametrize("frames", [2, 30, 55])
def test_nothing_up_to_a_frame_knows_what_comes_after(visual, fitted, with_gaps, swarm, frames):
    for model, tracks in ((visual, with_gaps), (fitted, swarm)):
        other = scrambled_after(tracks, frames)
        assert not other["position"].equals(tracks["position"])
        one, two, cut = (model.predictive(t) for t in (tracks, other, until(tracks, frames)))
        # The prediction of the next frame is the last that the frames up to here can make.
        for name in ("position", "velocity", "edge_probability"):
            np.testing.assert_array_equal(one[name][:, : frames + 1], two[name][:, : frames + 1])
            np.testing.assert_allclose(one[name][:, :frames], cut[name], rtol=1e-4, atol=1e-6)
        kinds = [model.posterior(t, draws=0)["mean"] for t in (tracks, other)]
        np.testing.assert_array_equal(*(mean[:, :frames] for mean in kinds))


def test_a_forecast_is_of_its_history_alone(visual, fitted, with_gaps, swarm):
    for model, tracks in ((visual, with_gaps), (fitted, swarm)):
        histories = [until(t, 40) for t in (tracks, scrambled_after(tracks, 40))]
        for edges in ("decoder", "rule"):
            xr.testing.assert_identical(
                *(model.forecast(h, 4, draws=3, seed=1, edges=edges) for h in histories)
            )


def test_one_step_ahead_is_the_prediction_of_the_next_frame(visual, fitted, with_gaps, swarm):
    for model, tracks, individuals in ((visual, with_gaps, 7), (fitted, swarm, 8)):
        mask = model.prepare(tracks).mask
        # A frame in which all are seen who are ever seen: nobody is carried on.
        last = 1 + int(mask.sum((0, 2))[1:55].argmax())
        known = mask[:, last].numpy()
        assert known.sum() == individuals
        predicted = model.predictive(tracks).isel(time=last + 1)
        ahead = model.forecast(until(tracks, last + 1), 1, draws=0).isel(time=0)
        for name in ("position", "velocity"):
            one, two = (
                f[name].transpose("trial", "individual", "space") for f in (predicted, ahead)
            )
            assert one.notnull().to_numpy()[known].all()
            np.testing.assert_allclose(two, one, rtol=1e-4, atol=1e-5)
        pairs = known[:, :, None] & known[:, None, :] & ~np.eye(4, dtype=bool)
        one, two = (f["edge_probability"].to_numpy()[pairs] for f in (predicted, ahead))
        np.testing.assert_allclose(two, one, rtol=1e-4)


def test_a_prediction_by_hand(fitted, swarm):
    """Decoder of the encoder's mean, in the units of the tracks."""
    prepared = fitted.prepare(swarm)
    with torch.no_grad():
        latent = fitted.guide.encode(prepared.observations, prepared.adjacency.float()).mean
        following = fitted.model.decode(latent)
    scaler = fitted.preparation.scaler
    states = following.states.mean.double().numpy() * scaler.scale + scaler.offset
    found = fitted.predictive(swarm)
    np.testing.assert_allclose(
        found["position"].transpose(*ORDER)[:, 1:], states[:, :-1, :, :2], rtol=1e-5
    )
    np.testing.assert_allclose(
        found["velocity"].transpose(*ORDER)[:, 1:], states[:, :-1, :, 2:], rtol=1e-4, atol=1e-6
    )
    edges = torch.sigmoid(latent @ latent.mT)[:, :-1]
    np.testing.assert_allclose(found["edge_probability"][:, 1:], edges, rtol=1e-4)
    assert found["position"][:, 0].isnull().all()
    assert found["position"].dims == ("trial", "time", "space", "individual")
    assert found["edge_probability"].dims == ("trial", "time", "individual", "neighbor")
    for name in ("trial", "time", "space", "individual"):
        np.testing.assert_array_equal(found[name], swarm[name])
    posterior = fitted.posterior(swarm, draws=0)
    np.testing.assert_allclose(posterior["mean"], latent, rtol=1e-4, atol=1e-6)
    assert set(posterior.data_vars) == {"mean", "sd"}


def test_frames_in_chunks_are_the_same(fitted, swarm, monkeypatch):
    whole = fitted.predictive(swarm)
    monkeypatch.setattr("swarmssm.inference.prediction.one_step.CHUNK", 7 * 16)
    parts = fitted.predictive(swarm)
    for name in whole.data_vars:
        np.testing.assert_allclose(parts[name], whole[name], rtol=1e-4, atol=1e-5)


def test_draws_are_about_the_mean(fitted, swarm):
    """Latent draws have the posterior's moments, by the laws of means and squares."""
    tracks = until(swarm, 5)
    found = fitted.posterior(tracks, draws=2000, seed=1)
    score = (found["states"] - found["mean"]) / found["sd"]
    assert score.dims == ("draw", "trial", "time", "individual", "latent")
    assert float(abs(score.mean("draw")).max()) < 6 / math.sqrt(2000)
    assert float(abs((score**2).mean("draw") - 1).max()) < 6 * math.sqrt(2 / 2000)
    # So do predicted states about the decoder of such draws, whose own noise is s.
    drawn = fitted.predictive(tracks, draws=400, seed=1)
    spread = drawn["position"].std("draw").isel(time=slice(1, None))
    noise = fitted.model.log_scale.detach().exp().numpy() * fitted.preparation.scaler.scale
    assert (spread.min(("trial", "time", "individual")) > 0.7 * noise[:2]).all()


def test_draws_follow_the_seed(fitted, swarm):
    def runs(seed):
        return [
            fitted.posterior(swarm, draws=2, seed=seed),
            fitted.predictive(swarm, draws=2, seed=seed),
            fitted.forecast(swarm, 3, draws=2, seed=seed),
            fitted.rollout(swarm, 3, draws=2, seed=seed),
        ]

    before = torch.get_rng_state()
    for one, two, other in zip(runs(5), runs(5), runs(6), strict=True):
        xr.testing.assert_identical(one, two)
        assert not one.equals(other)
    assert torch.equal(torch.get_rng_state(), before)
    # A generator goes on: the same one twice gives two draws, and like ones the same.
    generators = [torch.Generator().manual_seed(5) for _ in range(2)]
    first = fitted.forecast(swarm, 3, draws=2, seed=generators[0])
    xr.testing.assert_identical(first, fitted.forecast(swarm, 3, draws=2, seed=generators[1]))
    assert not first.equals(fitted.forecast(swarm, 3, draws=2, seed=generators[0]))
    # Draws differ from each other, the mean does not depend on the seed.
    assert not np.array_equal(first["position"][0], first["position"][1])
    xr.testing.assert_identical(
        fitted.forecast(swarm, 3, draws=0, seed=1), fitted.forecast(swarm, 3, draws=0, seed=2)
    )


def test_a_forecast_goes_on_from_the_history(fitted, swarm):
    found = fitted.forecast(swarm, 6, draws=2)
    assert found["position"].dims == ("draw", "trial", "time", "space", "individual")
    assert dict(found.sizes) == {
        "draw": 2,
        "trial": 2,
        "time": 6,
        "space": 2,
        "individual": 4,
        "neighbor": 4,
    }
    # The last of a hundred frames at 10 per second is at 9.9 s.
    np.testing.assert_allclose(found["time"], [10.0, 10.1, 10.2, 10.3, 10.4, 10.5])
    np.testing.assert_allclose(found["history_end"], [9.9, 9.9])
    assert found.attrs["horizon"] == 6
    probability = found["edge_probability"]
    assert float(probability.min()) >= 0
    assert float(probability.max()) <= 1


def test_trials_that_end_at_different_times(fitted, swarm):
    """Each goes on from its own last frame, as if the other were not there."""
    ragged = swarm.copy(deep=True)
    for name in ("position", "velocity"):
        ragged[name][1, 60:] = np.nan
    ragged["adjacency"][1, 60:] = 0
    both = fitted.forecast(ragged, 4, draws=0)
    np.testing.assert_allclose(both["time"], [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(both["history_end"], [9.9, 5.9])
    for trial, frames in ((0, 100), (1, 60)):
        alone = until(swarm, frames).isel(trial=[trial])
        expected = fitted.forecast(alone, 4, draws=0)
        for name in ("position", "velocity", "edge_probability"):
            np.testing.assert_allclose(both[name][[trial]], expected[name], rtol=1e-4, atol=1e-5)
    ragged["position"][1] = np.nan
    with pytest.raises(InputError, match="in one trial nobody is seen in two consecutive frames"):
        fitted.forecast(ragged, 2)


def test_who_is_long_gone_is_not_forecast(fitted, swarm):
    """Neither does anything that stood there reach the others."""
    gone = swarm.copy(deep=True)
    for name in ("position", "velocity"):
        gone[name][0, -MAX_CARRY - 1 :, :, 2] = np.nan
    gone["adjacency"][0, -MAX_CARRY - 1 :, 2, :] = 0
    gone["adjacency"][0, -MAX_CARRY - 1 :, :, 2] = 0
    never = gone.copy(deep=True)
    for name in ("position", "velocity"):
        never[name][0, :, :, 2] = np.nan
    for edges in ("decoder", "rule"):
        found = [fitted.forecast(t, 5, draws=3, seed=1, edges=edges) for t in (gone, never)]
        xr.testing.assert_identical(*found)
        for name in ("position", "velocity"):
            missing = found[0][name].isnull().all(("draw", "time", "space"))
            assert missing.to_numpy().tolist() == [[False, False, True, False], [False] * 4]
            assert found[0][name].isnull().sum() == 3 * 5 * 2
        absent = found[0]["edge_probability"][:, 0]
        assert float(absent[..., 2, :].sum() + absent[..., :, 2].sum()) == 0


def test_who_is_just_out_of_sight_is_carried_on(fitted, swarm):
    """Three frames ago individual 1 was seen last: it is three steps of its velocity further."""
    hidden = swarm.copy(deep=True)
    for name in ("position", "velocity"):
        hidden[name][0, -3:, :, 1] = np.nan
    moved = swarm.copy(deep=True)
    where = {"trial": 0, "individual": 1}
    speed = swarm["velocity"][{**where, "time": -4}]
    moved["position"][{**where, "time": -1}] = (
        swarm["position"][{**where, "time": -4}] + 0.3 * speed
    )
    moved["velocity"][{**where, "time": -1}] = speed
    rule = GraphRule("radius", radius=2.5)
    moved = add_adjacency(moved, rule, overwrite=True)
    found = [fitted.forecast(t, 4, draws=0) for t in (hidden, moved)]
    for name in ("position", "velocity", "edge_probability"):
        np.testing.assert_allclose(found[0][name], found[1][name], rtol=1e-4, atol=1e-5)
    assert found[0]["position"].notnull().all()


class Turning(OneStepModel, OneStepGuide):
    """A rule that is known: each latent state is the state, and the next is its rotation."""

    def __init__(self, turn=0.3, logit=0.0, noise=0.0):
        super().__init__(4)
        self.turn, self.logit, self.noise = turn, logit, noise
        self.graphs = []

    def encode(self, states, adjacency):
        self.graphs.append(adjacency.clone())
        return torch.distributions.Normal(states, torch.full_like(states, 1e-12))

    def decode(self, latent):
        x, y, vx, vy = latent.unbind(-1)
        c, s = math.cos(self.turn), math.sin(self.turn)
        turned = torch.stack([c * x - s * y, s * x + c * y, c * vx - s * vy, s * vx + c * vy], -1)
        sd = torch.full_like(turned, self.noise or 1e-12)
        size = latent.shape[-2]
        logits = torch.full((*latent.shape[:-1], size), self.logit)
        return NextStep(torch.distributions.Normal(turned, sd), logits)


@pytest.fixture
def turning(fitted):
    """Return a fit that is not fitted, but knows how to turn, in units of the tracks."""

    def build(rule=None, own_graph=True, **parameters):
        module = Turning(**parameters)
        scaler = dataclasses.replace(fitted.preparation.scaler, offset=(0.0,) * 4, scale=(1.0,) * 4)
        preparation = dataclasses.replace(
            fitted.preparation,
            scaler=scaler,
            rule=rule or fitted.preparation.rule,
            own_graph=own_graph,
        )
        return dataclasses.replace(fitted, model=module, guide=module, preparation=preparation)

    return build


def test_steps_are_applied_again_and_again(turning, swarm):
    found = turning(turn=0.3).forecast(swarm, 50, draws=0)
    last = swarm["position"].transpose(*ORDER)[:, -1].to_numpy()
    for step in (1, 10, 50):
        c, s = math.cos(0.3 * step), math.sin(0.3 * step)
        expected = np.stack(
            [c * last[..., 0] - s * last[..., 1], s * last[..., 0] + c * last[..., 1]], -1
        )
        got = found["position"].isel(time=step - 1).transpose("trial", "individual", "space")
        np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)


def test_noise_adds_up_over_steps(turning, swarm):
    """After n rotations with noise s each, the spread is s sqrt(n) in every coordinate."""
    found = turning(noise=0.1).forecast(swarm, 16, draws=2000, seed=0)
    for step in (1, 4, 16):
        variance = found["position"].isel(time=step - 1).var("draw", ddof=1)
        expected = 0.01 * step
        assert float(abs(variance - expected).max()) < 6 * expected * math.sqrt(2 / 2000)


def test_edges_from_the_decoder(turning, swarm):
    """As likely as it says: sampled where draws are, or those more likely than not."""
    sure = turning(logit=0.1)
    sure.rollout(swarm, 3, draws=0)
    truth = torch.from_numpy(swarm["adjacency"].to_numpy()[:, -1]).float()
    off = 1.0 - torch.eye(4)
    first, *later = sure.model.graphs
    assert torch.equal(first, truth)
    assert all(torch.equal(graph, off.expand(2, 4, 4)) for graph in later)
    unsure = turning(logit=-1.0)
    unsure.rollout(swarm, 3, draws=0)
    assert all(graph.sum() == 0 for graph in unsure.model.graphs[1:])
    found = unsure.forecast(swarm, 2, draws=1500, seed=0)
    probability = 1 / (1 + math.e)
    np.testing.assert_allclose(
        found["edge_probability"].to_numpy()[..., off.bool().numpy()], probability, rtol=1e-6
    )
    drawn = unsure.model.graphs[-1].mean(0)
    error = 6 * math.sqrt(probability * (1 - probability) / 1500)
    assert (drawn - probability * off).abs().max() < error


@pytest.mark.parametrize("rule", ["radius:1.0", "k-nearest:1", "visual:0.5"])
def test_edges_from_the_rule(turning, swarm, rule):
    """The graph of a free run is that of its own states, whatever the decoder says."""
    rule = GraphRule.parse(rule)
    free = turning(rule=rule, own_graph=False, logit=9.0)
    run = free.rollout(swarm, 12, draws=0, edges="rule")
    remade = add_adjacency(run, rule, overwrite=True)
    # Distances that are equal to seven digits may fall on either side.
    differing = int((run["adjacency"] != remade["adjacency"]).sum())
    assert differing <= 2
    used = torch.stack(free.model.graphs, 1).bool().numpy()
    np.testing.assert_array_equal(used, run["adjacency"].to_numpy()[:, :-1] != 0)
    assert 0 < int(run["adjacency"].sum()) < run["adjacency"].size - run["adjacency"].size / 4


def test_edges_that_cannot_be_are_refused(fitted, swarm):
    with pytest.raises(InputError, match="edges: 'best' is unknown; choose one of decoder, rule"):
        fitted.forecast(swarm, 2, edges="best")
    preparation = dataclasses.replace(fitted.preparation, rule=None)
    blind = dataclasses.replace(fitted, preparation=preparation)
    with pytest.raises(InputError, match="the rule that makes the graph is not known"):
        blind.rollout(swarm, 2, edges="rule")
    assert isinstance(blind.predictor(), OneStepPredictor)


def test_a_rollout_is_tracks(fitted, swarm):
    for draws, trials in ((0, ["0", "1"]), (1, ["0", "1"]), (2, ["0/0", "1/0", "0/1", "1/1"])):
        run = fitted.rollout(swarm, 7, draws=draws, seed=0)
        assert run["trial"].values.tolist() == trials
        assert run["position"].shape == (len(trials), 8, 2, 4)
        xr.testing.assert_identical(validate_tracks(run), run)
        np.testing.assert_allclose(run["time"], np.arange(8) / 10, atol=1e-12)
        assert run["position"].notnull().all()
        # The first frame is where the given tracks end, to the last digit.
        for name in ("position", "velocity"):
            start = swarm[name].transpose("trial", "time", "space", "individual")[:, -1]
            np.testing.assert_array_equal(run[name][:, 0], np.tile(start, (len(trials) // 2, 1, 1)))
        start = swarm["adjacency"][:, -1]
        np.testing.assert_array_equal(
            run["adjacency"][:, 0], np.tile(start, (len(trials) // 2, 1, 1))
        )
        assert (run["adjacency"].to_numpy().diagonal(axis1=2, axis2=3) == 0).all()
        assert run.attrs["source_software"] == "swarmssm"
    one, two = fitted.rollout(swarm, 7, draws=2, seed=0).isel(trial=[0, 2])["position"]
    assert not np.array_equal(one[1:], two[1:])


def test_a_rollout_starts_from_the_fullest_frame(fitted, with_gaps):
    prepared = fitted.prepare(with_gaps)
    count = prepared.mask.sum(-1)
    run = fitted.rollout(with_gaps, 3, draws=0)
    for trial in range(2):
        row = int((count[trial] == count[trial].max()).nonzero().max())
        present = prepared.mask[trial, row].numpy()
        start = run["position"][trial, 0].transpose("individual", "space").to_numpy()
        np.testing.assert_array_equal(start[present], prepared.states[trial, row][present, :2])
        # Who is absent at the start is so throughout, and who is there stays.
        there = run["position"][trial].notnull().all("space")
        assert (there == there[0]).all()
        assert there[0].to_numpy()[present].all()
    # Individual 2 was never seen in the first trial.
    assert run["position"].sel(trial="0", individual="2").isnull().all()


def test_a_run_that_leaves_all_bounds_is_said(turning, swarm):
    class Growing(Turning):
        def decode(self, latent):
            following = super().decode(latent * 1e9)
            return following

    growing = turning()
    module = Growing()
    growing = dataclasses.replace(growing, model=module, guide=module)
    for steps in (2, 9):  # beyond what tracks may hold, and beyond float32
        with pytest.raises(WorkError, match="rollout: the free run left all bounds"):
            growing.rollout(swarm, steps, draws=0)
        with pytest.raises(WorkError, match="rollout: the free run left all bounds"):
            growing.rollout(swarm, steps, draws=1)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda f, t: f.forecast(t, 0), "horizon: it must be at least 1, and it is 0"),
        (lambda f, t: f.forecast(t, 1, draws=-1), "draws: it must be at least 0, and it is -1"),
        (lambda f, t: f.rollout(t, 0), "steps: it must be at least 1, and it is 0"),
        (lambda f, t: f.rollout(t, 1, draws=-1), "draws: it must be at least 0"),
        (lambda f, t: f.predictive(t, draws=-1), "draws: it must be at least 0"),
        (lambda f, t: f.posterior(t, draws=-1), "draws: it must be at least 0"),
        (lambda f, t: f.part(t, "rest"), "part: 'rest' is unknown"),
        (lambda f, t: f.forecast(xr.Dataset(), 1), "no variable called position"),
        (lambda f, t: f.predictive(t.isel(space=[0])), "space"),
    ],
)
def test_calls_that_cannot_be_are_refused(fitted, swarm, call, sentence):
    with pytest.raises(InputError, match=sentence):
        call(fitted, swarm)


def test_in_three_dimensions(brief):
    tracks = simulate_boids(individuals=4, steps=60, space=3, seed=0)
    model = fit(tracks=tracks.drop_vars(["adjacency", "neighbor"]), **brief)
    assert model.preparation.rule == GraphRule("k-nearest", k=6)
    assert model.model.state_dim == 6
    found = model.forecast(tracks, 3, draws=2, edges="rule")
    assert found["position"].sizes["space"] == 3
    run = model.rollout(tracks, 3)
    xr.testing.assert_identical(validate_tracks(run), run)
    assert model.predictive(tracks)["position"][:, 1:].notnull().all()


def test_one_individual_alone(brief):
    angle = 0.4 * np.arange(60)
    tracks = make_tracks(np.stack([np.cos(angle), np.sin(angle)], -1)[:, None], fps=2.0)
    model = fit(tracks=tracks, **brief)
    run = model.rollout(tracks, 5)
    assert run["position"].notnull().all()
    assert int(run["adjacency"].sum()) == 0
    assert model.forecast(tracks, 3, draws=2)["position"].notnull().all()
    # Another number of individuals is no hindrance: what is learned is a rule for each.
    more = model.forecast(simulate_boids(individuals=7, steps=5, seed=1), 3, draws=0)
    assert more["position"].shape == (1, 3, 2, 7)
