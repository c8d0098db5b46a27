"""State-space models in `fit`: every guide filters the past alone, and a run is what it was."""

import dataclasses

import numpy as np
import pyro.distributions as dist
import pytest
import torch
import xarray as xr
from pyro.nn import PyroParam, PyroSample
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.forces import cohesion
from swarmssm.inference import Fit, fit
from swarmssm.models import (
    InitialStates,
    KinematicTransition,
    PositionEmission,
    StateSpaceModel,
)
from swarmssm.simulate import simulate_boids

GUIDES = ("smoothing", "markov", "linearized")


class NeighborTerm(KinematicTransition):
    """Everybody is pulled to those they see."""

    def __init__(self, scales):
        super().__init__(scales.space, scales.dt)
        self.gain = PyroSample(dist.LogNormal(-1.0, 1.0))
        self.noise = PyroParam(torch.tensor(0.05), constraint=constraints.positive)

    def velocity(self, positions, velocities, inputs):
        moved = velocities + self.dt * self.gain * cohesion(positions, inputs.adjacency)
        return dist.Normal(moved, self.noise).to_event(1)


def pulled(scales, exact=False):
    emission = None if exact else PositionEmission(scales.space, 0.03)
    return StateSpaceModel(InitialStates.for_scales(scales), NeighborTerm(scales), emission)


@pytest.fixture(scope="module")
def tracks():
    """Two flocks: one individual comes late, one goes early, and one is lost for a while."""
    tracks = simulate_boids(
        5,
        60,
        2,
        observation_noise=0.03,
        seed=4,
        wall_gain=0,
        min_speed=0,
        max_speed=2.0,
        noise="additive",
        process_noise=0.1,
    )
    tracks = tracks.copy(deep=True)
    position = tracks["position"].transpose("trial", "time", "individual", "space")
    position[0, :20, 0] = np.nan
    position[1, 45:, 1] = np.nan
    position[0, 25:29, 2] = np.nan
    tracks["position"] = position.transpose(*tracks["position"].dims)
    return tracks.drop_vars("velocity", errors="ignore")


@pytest.fixture(scope="module", params=GUIDES)
def fitted(request, tracks):
    return fit(pulled, tracks, guide=request.param, epochs=3, fractions=(1, 0, 0), seed=1)


def scrambled_after(tracks, frames):
    """Return tracks whose later frames are somebody else's."""
    other = tracks.copy(deep=True)
    later = other["position"].to_numpy()[:, frames:]
    later[:] = 1 - 3 * later[..., ::-1]
    edges = other["adjacency"].to_numpy()[:, frames:]
    edges[:] = edges.swapaxes(-1, -2)
    return other


@pytest.mark.parametrize("frames", [2, 30, 50])
def test_nothing_that_is_predicted_knows_what_comes_after(fitted, tracks, frames):
    other = scrambled_after(tracks, frames)
    one, two = (fitted.predictive(t, seed=2) for t in (tracks, other))
    for name in ("position", "velocity", "edge_probability"):
        np.testing.assert_array_equal(one[name][:, : frames + 1], two[name][:, : frames + 1])
    assert not np.array_equal(one["position"], two["position"], equal_nan=True)
    cuts = [t.isel(time=slice(0, frames)) for t in (tracks, other)]
    xr.testing.assert_identical(*(fitted.forecast(cut, 4, draws=3, seed=1) for cut in cuts))


def test_a_forecast_at_a_frame_is_that_of_a_history_that_ends_there(fitted, tracks):
    """The same window, cut out of the whole recording or at its end."""
    prepared = fitted.prepare(tracks)
    cut = fitted.prepare(tracks.isel(time=slice(0, 41)))
    trials, rows = torch.tensor([0, 1]), torch.tensor([40, 40])
    predictor = fitted.predictor()
    starts = []
    for source in (prepared, cut):
        torch.manual_seed(3)
        starts.append(predictor.begin(source, trials, rows, 3))
    torch.testing.assert_close(starts[0].states, starts[1].states, rtol=0, atol=0)
    assert torch.equal(starts[0].present, starts[1].present)


def test_the_posterior_covers_who_is_there(fitted, tracks):
    posterior = fitted.posterior(tracks, draws=4, seed=0)
    assert posterior["states"].dims == ("draw", "trial", "time", "individual", "latent")
    known = posterior["mean"].notnull().all("latent").to_numpy()
    expected = np.ones((2, 60, 5), dtype=bool)
    expected[0, :20, 0] = False
    expected[1, 45:, 1] = False
    np.testing.assert_array_equal(known, expected)  # who is lost for a while is still there
    seen = tracks["position"].transpose("trial", "time", "individual", "space").to_numpy()
    off = (posterior["mean"].to_numpy()[..., :2] - seen)[np.isfinite(seen)]
    # The tracking noise is 0.03, and a smoothed path is nearer to the truth than the sighting.
    assert np.sqrt((off**2).mean()) < 2 * 0.03
    if fitted.settings.guide == "smoothing":
        return  # independent steps cannot widen where nobody was looking without widening later
    # Where nobody was looking the path is less sure than where somebody was.
    sd = posterior["sd"].to_numpy()[0, :, 2, :2].mean(-1)
    assert sd[26:28].mean() > sd[35:50].mean()


def test_who_is_just_out_of_sight_is_forecast(fitted, tracks):
    history = tracks.isel(time=slice(0, 28))  # the third is lost for three frames
    future = fitted.forecast(history, 2, draws=2)
    there = future["position"].notnull().all(["draw", "time", "space"]).to_numpy()
    np.testing.assert_array_equal(there[0], [True, True, True, True, True])
    late = fitted.forecast(tracks.isel(time=slice(0, 15)), 2, draws=2)
    there = late["position"].notnull().all(["draw", "time", "space"]).to_numpy()
    np.testing.assert_array_equal(there[0], [False, True, True, True, True])


def test_a_run_folder_gives_the_same_numbers(fitted, tracks, tmp_path):
    fitted.save(tmp_path / "run")
    name = f"{pulled.__module__}:pulled"
    assert fitted.settings.model == name
    with pytest.raises(InputError, match="which loading it would execute"):
        Fit.load(tmp_path / "run")
    # A test module cannot be imported by its name: stand in for it.
    settings = dataclasses.replace(fitted)
    again = settings.parameters(10, seed=3)
    xr.testing.assert_identical(fitted.parameters(10, seed=3), again)


def test_parameters_have_a_table(fitted):
    table = fitted.summary(draws=2000, seed=0)
    assert list(table.index) == ["gain"]
    row = table.loc["gain"]
    assert 0 < row["low"] < row["mean"] < row["high"]
    draws = fitted.parameters(2000, seed=0)["transition.gain"].to_numpy()
    np.testing.assert_allclose(row["low"], np.quantile(draws, 0.05))


def test_a_rollout_starts_at_a_draw_of_the_last_state(fitted, tracks):
    run = fitted.rollout(tracks, 5, draws=2, seed=0)
    assert run.sizes["time"] == 6
    step = np.diff(run["position"].transpose("trial", "time", "individual", "space"), axis=1)
    velocity = run["velocity"].transpose("trial", "time", "individual", "space")[:, 1:]
    moved = 0.1 * velocity.to_numpy()
    np.testing.assert_allclose(step, moved, atol=1e-5, equal_nan=True)


def test_exact_states_are_scored_directly(tracks):
    """With known states the gain is regression: compare with least squares on accelerations."""
    known = simulate_boids(
        6,
        300,
        1,
        seed=2,
        wall_gain=0,
        separation_gain=0,
        alignment_gain=0,
        min_speed=0,
        max_speed=9.0,
        noise="additive",
        process_noise=0.1,
    )
    exact = fit(
        pulled, tracks=known, epochs=60, lr=0.05, fractions=(1, 0, 0), model_options={"exact": True}
    )
    assert exact.settings.guide == "parameters"
    order = ("trial", "time", "individual", "space")
    position, velocity = (
        torch.from_numpy(known[name].transpose(*order).to_numpy()[0])
        for name in ("position", "velocity")
    )
    graph = torch.from_numpy(known["adjacency"].to_numpy()[0])
    force = cohesion(position, graph)[:-1]
    change = torch.diff(velocity, dim=0)
    slope = float((force * change).sum() / (0.1 * force.square().sum()))
    error = float((0.1**0.5 * 0.1) / (0.1 * force.square().sum().sqrt()))
    table = exact.summary()
    # The prior pulls by less than a standard error, and the noise of SVI is smaller still.
    assert abs(table.loc["gain", "mean"] - slope) < 1.5 * error
    assert 0.5 * error < table.loc["gain", "sd"] < 2 * error


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"scaler": "minmax"}, "state-space model and works in the tracks' own units"),
        ({"guide": "encoder"}, "encoder cannot be built"),
        ({"priors": {"gian": "Normal(0, 1)"}}, "gian"),
        ({"priors": {"gain": "Normal(0, "}}, "gain"),
    ],
)
def test_a_mistake_is_named(tracks, change, sentence):
    with pytest.raises(InputError, match=sentence):
        fit(pulled, **{"guide": "markov", "tracks": tracks, "epochs": 1, **change})
