"""Scores against numbers worked out by hand, on frames that are the same for all."""

import copy
import json

import numpy as np
import pyro.distributions as dist
import pytest
import torch
import xarray as xr

from swarmssm import datasets, inference, simulate
from swarmssm.analysis import evaluate
from swarmssm.analysis.posterior.frames import rolling_origins
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks, states_of
from swarmssm.tracks.scaling import fit_scaler
from swarmssm.tracks.splits import take

MODEL, STAY, STRAIGHT, FLOOR = "graph-vae", "stay-put", "constant-velocity", "noise-floor"
FEW = {"horizons": (1, 5), "free_run_steps": 10, "draws": 2, "starts": 2, "origins": 10}


@pytest.fixture(scope="module")
def evaluation(quick_fit, boids):
    return evaluate(
        quick_fit, boids, horizons=(1, 3, 10), free_run_steps=20, origins=12, starts=2, draws=3
    )


def scaled_test_part(fit, tracks):
    return fit.preparation.scaler.transform(states_of(fit.part(tracks, "test")))


def half_mean_step(states):
    lengths = np.sqrt(((states[:, 1:] - states[:, :-1]) ** 2).sum(-1))
    return lengths.mean() / 2


def test_methods_are_the_model_the_baselines_and_the_true_rule(evaluation):
    assert evaluation.scores["method"].values.tolist() == [MODEL, STAY, STRAIGHT, FLOOR]
    assert evaluation.model == MODEL
    assert evaluation.settings["part"] == "test"


def test_one_step_of_the_model_is_that_of_its_predictive(evaluation, quick_fit, boids):
    truth = scaled_test_part(quick_fit, boids)
    predicted = states_of(quick_fit.predictive(quick_fit.part(boids, "test")))
    predicted = quick_fit.preparation.scaler.transform(predicted)
    squares = ((predicted - truth)[:, 1:] ** 2).sum(-1)
    length = half_mean_step(truth)
    assert evaluation.score("mse", MODEL) == pytest.approx(0.5 * squares.mean() / length)
    assert evaluation.score("mae", MODEL) == pytest.approx(0.5 * np.sqrt(squares).mean() / length)


def test_staying_put_has_an_mae_of_one(evaluation, quick_fit, boids):
    assert evaluation.score("mae", STAY) == pytest.approx(1.0)
    truth = scaled_test_part(quick_fit, boids)
    squares = ((truth[:, 1:] - truth[:, :-1]) ** 2).sum(-1)
    expected = 0.5 * squares.mean() / half_mean_step(truth)
    assert evaluation.score("mse", STAY) == pytest.approx(expected)


def test_constant_velocity_is_scored_as_by_hand(evaluation, quick_fit, boids):
    part = quick_fit.part(boids, "test")
    states = states_of(part)
    guess = states[:, :-1].copy()
    guess[..., :2] += guess[..., 2:] * 0.1
    scaler = quick_fit.preparation.scaler
    truth = scaler.transform(states)
    squares = ((scaler.transform(guess) - truth[:, 1:]) ** 2).sum(-1)
    expected = 0.5 * squares.mean() / half_mean_step(truth)
    assert evaluation.score("mse", STRAIGHT) == pytest.approx(expected)


def test_the_noise_floor_is_what_the_noise_free_next_state_leaves(evaluation, quick_fit, boids):
    part = quick_fit.part(boids, "test")
    order = ("trial", "time", "individual", "space")
    following = np.concatenate(
        [part[n].transpose(*order).to_numpy() for n in ("next_position", "next_velocity")], -1
    )
    scaler = quick_fit.preparation.scaler
    truth = scaler.transform(states_of(part))
    squares = ((scaler.transform(following)[:, :-1] - truth[:, 1:]) ** 2).sum(-1)
    expected = 0.5 * squares.mean() / half_mean_step(truth)
    assert evaluation.score("mse", FLOOR) == pytest.approx(expected)
    assert evaluation.score("mse", FLOOR) < evaluation.score("mse", STRAIGHT)


def test_forecasts_are_those_of_fit_forecast_made_from_the_history_alone(
    evaluation, quick_fit, boids
):
    part = quick_fit.part(boids, "test")
    scaler = quick_fit.preparation.scaler
    truth = scaler.transform(states_of(part))
    trials, rows = rolling_origins(np.isfinite(truth).all(-1), 12)
    prepared = quick_fit.prepare(part)
    predictor = quick_fit.predictor()
    start = predictor.begin(prepared, torch.tensor([0]), torch.tensor([0]), 0)
    first = predictor.run(start, 10, sample=False)
    for step in (1, 3, 10):
        squares = [((first.states[0, step - 1].numpy() - truth[0, step]) ** 2).mean()]
        for trial, row in zip(trials, rows, strict=True):
            if row + step >= truth.shape[1]:
                continue
            if row == 0:  # One frame is no history; its state is known all the same.
                continue
            history = part.isel(trial=[trial], time=slice(0, row + 1))
            forecast = quick_fit.forecast(history, step, draws=0)
            states = scaler.transform(states_of(forecast))[0, -1]
            squares.append(((states - truth[trial, row + step]) ** 2).mean())
        found = evaluation.score("squared_error", MODEL, step)
        assert found == pytest.approx(np.mean(squares), rel=1e-4)
        assert int(evaluation.scores["num_scored"].sel(step=step)) == 5 * len(squares)


def test_constant_velocity_is_without_error_where_all_go_straight(quick_fit):
    t = np.arange(40.0)[:, None, None]
    generator = np.random.default_rng(0)
    start, velocity = generator.uniform(-2, 2, (2, 5, 2))
    tracks = make_tracks(
        start + 0.1 * t * velocity,
        velocity=np.broadcast_to(velocity, (40, 5, 2)),
        fps=10.0,
        adjacency=np.zeros((40, 5, 5), dtype=int),
    )
    found = evaluate(quick_fit, tracks, **FEW)
    for score in ("mse", "mae"):
        assert found.score(score, STRAIGHT) < 1e-12
    assert found.score("squared_error", STRAIGHT, 5) < 1e-20
    assert found.score("mae", STAY) == pytest.approx(1.0)
    # Five steps of staying put leave five times the distance of one.
    assert found.score("forecast_mae", STAY, 5) == pytest.approx(5.0)
    assert found.score("avd_error", STRAIGHT) < 1e-12
    assert found.score("amd_error", STRAIGHT) < 1e-12
    assert np.isnan(found.score("mse", FLOOR))
    assert any("noise floor is unknown" in note for note in found.notes)


def test_edges_are_scored_beside_what_needs_no_model(evaluation, quick_fit, boids):
    part = quick_fit.part(boids, "test")
    truth = part["adjacency"].to_numpy()[0].astype(bool)
    off = ~np.eye(5, dtype=bool)
    same = (truth[1:] == truth[:-1])[:, off].mean()
    assert evaluation.edge_score("accuracy", STAY) == pytest.approx(same)
    share = truth[1:][:, off].mean()
    assert evaluation.edge_score("accuracy", "commoner") == pytest.approx(max(share, 1 - share))
    assert evaluation.edge_score("auc", "commoner") == pytest.approx(0.5)
    guess = quick_fit.predictive(part)["edge_probability"].to_numpy()[0, 1:] >= 0.5
    right = (guess == truth[1:])[:, off].mean()
    assert evaluation.edge_score("accuracy", MODEL) == pytest.approx(right)
    assert np.isnan(evaluation.edges["accuracy"].sel(trial="3")[:, 0]).all()


def test_the_result_is_plain_json(evaluation):
    values = json.loads(json.dumps(evaluation.to_dict(), allow_nan=False))
    assert values["methods"][STAY]["mae"] == pytest.approx(1.0)
    assert set(values["methods"][MODEL]["horizons"]) == {"1", "3", "10"}
    assert values["settings"]["horizons"] == [1, 3, 10]
    assert values["truth"]["amd_mean"] == pytest.approx(evaluation.score("amd_mean", "truth"))
    assert values["edges"]["commoner"]["precision"] is None or share_is_high(evaluation)


def share_is_high(evaluation):
    return float(evaluation.edges["density"].mean()) > 0.5


def test_evaluating_again_gives_the_same_and_another_seed_only_moves_the_draws(
    evaluation, quick_fit, boids
):
    options = {"horizons": (1, 3, 10), "free_run_steps": 20, "origins": 12, "starts": 2, "draws": 3}
    torch.manual_seed(5)
    again = evaluate(quick_fit, boids, **options)
    assert again.to_dict() == evaluation.to_dict()
    other = evaluate(quick_fit, boids, seed=1, **options)
    assert other.score("mse", MODEL) == evaluation.score("mse", MODEL)
    assert other.score("amd_mean", STAY) == evaluation.score("amd_mean", STAY)
    assert other.score("amd_mean", MODEL) != evaluation.score("amd_mean", MODEL)


def test_scores_do_not_depend_on_the_scaler_of_the_fit(boids, evaluation):
    fit = inference.fit("graph-vae", boids, epochs=1, scaler="isotropic")
    found = evaluate(fit, boids, horizons=(1,), free_run_steps=2, draws=1)
    assert found.score("mse", STAY) == pytest.approx(evaluation.score("mse", STAY))
    assert any("the training part" in note for note in found.notes)
    other = simulate.simulate_boids(individuals=5, steps=30, trials=1, seed=9)
    scaler = evaluate(fit, other, horizons=(1,), free_run_steps=2, draws=1).settings["scaler"]
    expected = fit_scaler(states_of(other), "minmax")
    np.testing.assert_allclose(scaler["offset"], expected.offset)
    np.testing.assert_allclose(scaler["scale"], expected.scale)


def test_other_tracks_are_scored_as_a_whole_and_it_says_so(quick_fit):
    other = simulate.simulate_boids(individuals=5, steps=30, trials=2, seed=7)
    found = evaluate(quick_fit, other, **FEW)
    assert found.settings["part"] == "all"
    assert any("was not fitted on these tracks" in note for note in found.notes)
    assert found.edges.sizes["trial"] == 2
    with pytest.raises(InputError, match="have no test part"):
        evaluate(quick_fit, other, part="test")


def test_parts_are_those_of_the_fit(quick_fit, boids):
    for part, note in (
        ("train", "of the scored frames"),
        ("validation", "(validation part)"),
        ("all", "of the scored frames"),
    ):
        found = evaluate(quick_fit, boids, part=part, **FEW)
        assert found.settings["part"] == part
        assert any(note in text for text in found.notes)
        segments = getattr(quick_fit.split, part, None)
        expected = boids["trial"].values if segments is None else [s.trial for s in segments]
        assert found.edges["trial"].values.tolist() == list(expected)


def test_without_a_test_part_the_validation_part_is_scored(boids):
    fit = inference.fit("graph-vae", boids, epochs=1, fractions=(0.5, 0.5, 0.0))
    found = evaluate(fit, boids, **FEW)
    assert found.settings["part"] == "validation"
    assert any("(validation part)" in note for note in found.notes)


def test_steps_that_the_part_is_too_short_for_are_left_out(quick_fit, boids):
    short = boids.isel(time=slice(0, 8))
    found = evaluate(quick_fit, short, horizons=(1, 5, 50), free_run_steps=20, draws=1)
    assert found.settings["horizons"] == [1, 5]
    assert any("at most 7 steps ahead: 50 steps are not scored" in note for note in found.notes)
    assert any("over 7 steps" in note for note in found.notes)
    assert found.collective.sizes["time"] == 21
    with pytest.raises(InputError, match="room for at most 7 steps"):
        evaluate(quick_fit, short, horizons=(50,), free_run_steps=2, draws=1)


def test_trials_of_unequal_length_and_gaps_are_scored_on_what_is_known(quick_fit, boids):
    tracks = boids.copy(deep=True)
    position = tracks["position"].to_numpy()
    velocity = tracks["velocity"].to_numpy()
    for values in (position, velocity):
        values[1, 40:] = np.nan
        values[0, 10:15, :, 2] = np.nan
        values[2, :, :, 4] = np.nan
    found = evaluate(quick_fit, tracks, **FEW)
    states = states_of(tracks)
    known = np.isfinite(states).all(-1)
    both = known[:, 1:] & known[:, :-1]
    scaler = quick_fit.preparation.scaler
    truth = scaler.transform(states)
    steps = np.sqrt(((truth[:, 1:] - truth[:, :-1]) ** 2).sum(-1))[both]
    assert found.settings["L"] == pytest.approx(steps.mean() / 2)
    assert found.score("mae", STAY) == pytest.approx(1.0)
    assert np.isfinite(found.score("mse", MODEL))
    # Who is away at the origin is forecast by nobody, who is away later is not scored.
    trials, rows = rolling_origins(known, 10, known.all(-1))
    counted = sum(
        int((known[t, r] & known[t, r + 5]).sum())
        for t, r in zip(trials, rows, strict=True)
        if r + 5 < 60
    )
    assert int(found.scores["num_scored"].sel(step=5)) == counted
    # The true rule cannot go on from where it does not know everybody: nobody does.
    assert np.isfinite(found.score("squared_error", FLOOR, 5))
    assert np.isfinite(found.score("mse", FLOOR))
    assert any("Free runs of the true rule" in note for note in found.notes)
    assert FLOOR not in found.collective["series"]


def test_noisy_positions_have_a_noise_floor_too():
    tracks = simulate.simulate_boids(
        individuals=4, steps=80, trials=3, seed=3, observation_noise=0.01
    )
    fit = inference.fit("graph-vae", tracks, epochs=1)
    found = evaluate(fit, tracks, **FEW)
    part = fit.part(tracks, "test")
    order = ("trial", "time", "individual", "space")
    seen = part["position"].transpose(*order).to_numpy()
    following = part["next_position"].transpose(*order).to_numpy()
    guess = np.concatenate([following, (following - seen) * 10.0], -1)[:, 1:-1]
    scaler = fit.preparation.scaler
    truth = scaler.transform(states_of(part))
    squares = ((scaler.transform(guess) - truth[:, 2:]) ** 2).sum(-1)
    expected = 0.5 * squares.mean() / half_mean_step(truth[:, 1:])
    assert found.score("mse", FLOOR) == pytest.approx(expected)
    assert found.score("mse", FLOOR) < found.score("mse", STRAIGHT)


def test_the_bundled_fish_are_scored():
    tracks = datasets.load_sunbleak(6)
    fit = inference.fit("graph-vae", tracks, epochs=2)
    found = evaluate(fit, tracks, **FEW)
    assert found.settings["unit"] == tracks.attrs["unit"]
    assert found.scores["method"].values.tolist() == [MODEL, STAY, STRAIGHT]
    assert found.score("mae", STAY) == pytest.approx(1.0)
    assert found.settings["thesis"] == "guppies"


def test_one_individual_has_neither_cohesion_nor_edges():
    tracks = simulate.simulate_boids(individuals=1, steps=40, trials=3, seed=0)
    fit = inference.fit("graph-vae", tracks, epochs=1)
    found = evaluate(fit, tracks, **FEW)
    assert found.score("mae", STAY) == pytest.approx(1.0)
    assert np.isnan(found.score("amd_mean", MODEL))
    assert np.isnan(found.edge_score("accuracy", MODEL))
    assert found.to_dict()["methods"][MODEL]["amd_mean"] is None


def test_three_dimensions_are_scored():
    tracks = simulate.simulate_boids(individuals=4, steps=40, trials=3, seed=0, space=3)
    fit = inference.fit("graph-vae", tracks, epochs=1)
    found = evaluate(fit, tracks, **FEW)
    assert found.score("mae", STAY) == pytest.approx(1.0)
    assert found.imitation.sizes["space"] == 3


def test_a_model_that_breaks_down_is_scored_as_infinitely_wrong(quick_fit, boids, monkeypatch):
    broken = copy.deepcopy(quick_fit)
    with torch.no_grad():
        for parameter in broken.model.decoder.parameters():
            parameter.mul_(1e3)
    monkeypatch.setattr(
        type(broken.guide), "encode", lambda self, states, graph: dist.Normal(1e9 * states, 1.0)
    )
    found = evaluate(broken, boids, **FEW)
    assert np.isfinite(found.score("mse", MODEL))
    assert found.score("squared_error", MODEL, 5) == np.inf
    assert found.score("amd_mean", MODEL) == np.inf
    assert found.score("mae", STAY) == pytest.approx(1.0)
    assert any("graph-vae left all bounds" in note for note in found.notes)
    assert found.to_dict()["methods"][MODEL]["amd_mean"] == "infinite"
    by_rule = evaluate(broken, boids, edges="rule", **FEW)
    assert by_rule.score("squared_error", MODEL, 5) == np.inf


def test_tracks_in_which_nothing_can_be_scored_are_refused(quick_fit, boids):
    still = boids.isel(trial=0).copy(deep=True)
    still["position"][:] = still["position"][0]
    still["velocity"][:] = 0.0
    with pytest.raises(InputError, match="nothing moves"):
        evaluate(quick_fit, still)
    alone = boids.isel(trial=0).copy(deep=True)
    alone["position"][1::2] = np.nan
    alone["velocity"][1::2] = np.nan
    with pytest.raises(InputError, match="nobody is observed in two consecutive frames"):
        evaluate(quick_fit, alone)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizons": ()}, "horizons: give rising whole numbers"),
        ({"horizons": (5, 1)}, "horizons: give rising whole numbers"),
        ({"horizons": (0, 1)}, "horizons: give rising whole numbers"),
        ({"horizons": (1.5,)}, "horizons: give rising whole numbers"),
        ({"draws": 0}, "draws: it must be at least 1, and it is 0"),
        ({"free_run_steps": 0}, "free_run_steps: it must be at least 1"),
        ({"origins": 0}, "origins: it must be at least 1"),
        ({"starts": -1}, "starts: it must be at least 1"),
        ({"seed": -1}, "seed: it must not be negative"),
        ({"part": "tset"}, "part: 'tset' is unknown"),
        ({"edges": "magic"}, "edges: 'magic' is unknown"),
    ],
)
def test_arguments_out_of_range_are_told(quick_fit, boids, options, message):
    with pytest.raises(InputError, match=message):
        evaluate(quick_fit, boids, **options)


def test_origins_are_spread_over_each_trial_and_leave_a_step():
    mask = np.zeros((2, 11, 3), dtype=bool)
    mask[0, :, 0] = True
    mask[1, 4:8, 1] = True
    trials, rows = rolling_origins(mask, 3)
    assert trials.tolist() == [0, 0, 0, 1, 1, 1]
    assert rows.tolist() == [0, 4, 9, 4, 5, 6]


def test_a_part_is_taken_without_its_neighbours(quick_fit, boids):
    """Differences at the start of a part would otherwise reach into the part before."""
    position = boids[["position"]].isel(trial=0, drop=True)
    fit = inference.fit(
        "graph-vae", position.assign_attrs(boids.attrs), epochs=1, graph="radius:2.5"
    )
    found = evaluate(fit, position.assign_attrs(boids.attrs), **FEW)
    segment = fit.split.test[0]
    part = take(position.assign_attrs(boids.attrs), [segment])
    assert isinstance(part, xr.Dataset)
    truth = fit.preparation.scaler.transform(states_of(part))[:, 1:]
    assert found.settings["L"] == pytest.approx(half_mean_step(truth))
