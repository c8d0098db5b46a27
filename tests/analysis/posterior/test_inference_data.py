"""What leaves the package as an ArviZ object, and what ArviZ makes of it unchanged."""

import subprocess
import sys
import warnings
from types import SimpleNamespace

import arviz as az
import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.posterior import container, pointwise_log_likelihood, to_inference_data
from swarmssm.errors import InputError

DRAWS = 40
GROUPS = {
    "posterior",
    "posterior_predictive",
    "predictions",
    "log_likelihood",
    "prior",
    "prior_predictive",
    "observed_data",
    "constant_data",
    "sample_stats",
}


@pytest.fixture(scope="module")
def whole(springs_fit, ten_trials):
    """Nothing is missing."""
    return to_inference_data(springs_fit, ten_trials, DRAWS, predictions=3, prior_draws=5)


@pytest.fixture(scope="module")
def stacked(springs_fit, gappy):
    """Something is."""
    return to_inference_data(springs_fit, gappy, DRAWS, prior_draws=5)


@pytest.fixture(scope="module")
def of_points(quick_fit, boids):
    """A model whose weights have no posterior."""
    return to_inference_data(quick_fit, boids.isel(trial=[0], time=slice(0, 12)), DRAWS)


def all_of_arviz(idata, rival):
    """Call what the issue of an ArviZ object is."""
    with warnings.catch_warnings():
        # Of few draws in one chain, which is what is given here.
        warnings.filterwarnings("ignore", category=UserWarning)
        warnings.filterwarnings("ignore", category=RuntimeWarning)
        # Of what ArviZ asks of a later matplotlib.
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        table = az.summary(idata)
        az.plot_posterior(idata, var_names=list(idata.posterior.data_vars)[:1], coords=one(idata))
        az.plot_trace(idata, var_names=list(idata.posterior.data_vars)[:1], coords=one(idata))
        az.plot_ppc(idata, num_pp_samples=10)
        left_out = az.loo(idata)
        ranked = az.compare({"one": idata, "other": rival})
    return table, left_out, ranked


def one(idata):
    """Return coordinates of a few numbers of the posterior, if it has many."""
    posterior = idata.posterior
    few = ("trial", "time", "individual", "latent")
    return {name: posterior[name].values[:1] for name in few if name in posterior.dims}


def test_groups_are_named_and_labelled(whole, ten_trials):
    assert set(whole.groups()) == GROUPS
    posterior = whole.posterior
    assert set(posterior.data_vars) == {"alignment_gain", "process_noise"}
    assert posterior["alignment_gain"].dims == ("chain", "draw")
    assert posterior["alignment_gain"].attrs["units"] == "1/s"
    assert posterior["process_noise"].attrs["full_name"] == "transition.process_noise"
    dims = ("trial", "time", "individual")
    assert whole.log_likelihood["position"].dims == ("chain", "draw", *dims)
    assert whole.posterior_predictive["position"].dims == ("chain", "draw", *dims, "space")
    assert whole.observed_data["position"].dims == (*dims, "space")
    # The first two frames say where bodies go.
    np.testing.assert_array_equal(
        whole.observed_data["position"],
        ten_trials["position"].transpose(*dims, "space").isel(time=slice(2, None)),
    )
    np.testing.assert_array_equal(
        whole.constant_data["adjacency"], ten_trials["adjacency"].transpose(*dims, "neighbor")
    )
    assert whole.predictions["position"].dims == ("chain", "draw", *dims, "space")
    assert whole.predictions.sizes["time"] == 3
    assert set(whole.prior.data_vars) == set(posterior.data_vars)
    assert whole.prior_predictive["position"].shape == (1, 5, 10, 14, 3, 2)
    assert whole.sample_stats["loss"].dims == ("step",)
    assert whole.sample_stats.attrs["training_seed"] == 0
    for group in GROUPS:
        for name, variable in whole[group].data_vars.items():
            assert {"units", "long_name"} <= set(variable.attrs), (group, name)


def test_draws_belong_together(whole, springs_fit, ten_trials):
    drawn = springs_fit.parameters(DRAWS, 0)
    np.testing.assert_array_equal(
        whole.posterior["alignment_gain"][0], drawn["transition.alignment_gain"]
    )
    pointwise = pointwise_log_likelihood(springs_fit, ten_trials, DRAWS)
    np.testing.assert_array_equal(
        whole.log_likelihood["position"][0], pointwise.isel(time=slice(2, None))
    )
    np.testing.assert_allclose(
        whole.sample_stats["log_density"][0],
        pointwise.isel(time=slice(2, None)).sum(("trial", "time", "individual")),
    )


def test_replicates_are_about_the_data(whole):
    drawn = whole.posterior_predictive["position"]
    off = (whole.observed_data["position"] - drawn.mean(("chain", "draw"))) / drawn.std(
        ("chain", "draw")
    )
    # Standard normal but for the mean and sd of 40 draws, which add a factor of 1 + 2 / 40.
    assert float((off**2).mean()) == pytest.approx(1.05, abs=6.0 * np.sqrt(2.0 / 720))


def test_the_gaps_are_left_out_in_a_row(stacked, gappy):
    assert stacked.attrs["stacked"] == 1
    seen = (
        gappy["position"].transpose("trial", "time", "individual", "space").notnull().all("space")
    )
    # Two frames with anybody in them are history: the first two here.
    count = int(seen.isel(time=slice(2, None)).sum())
    observed = stacked.observed_data["position"]
    assert observed.dims == ("observation", "space")
    assert observed.shape == (count, 2)
    assert stacked.log_likelihood["position"].shape == (1, DRAWS, count)
    assert stacked.posterior_predictive["position"].shape == (1, DRAWS, count, 2)
    for group in ("observed_data", "log_likelihood", "posterior_predictive"):
        assert np.isfinite(stacked[group]["position"]).all()
    place = stacked.observed_data.isel(observation=17)
    labels = {name: place[name].item() for name in ("trial", "time", "individual")}
    np.testing.assert_array_equal(place["position"], gappy["position"].sel(labels))
    assert set(stacked.constant_data["present"].dims) == {"trial", "time", "individual"}


@pytest.mark.parametrize("kind", ["whole", "stacked", "of_points"])
def test_arviz_works_on_it_before_and_after_a_file(kind, request, tmp_path):
    idata = request.getfixturevalue(kind)
    path = tmp_path / "fit.nc"
    idata.to_netcdf(str(path))
    again = az.from_netcdf(str(path))
    table, left_out, ranked = all_of_arviz(idata, again)
    later, same, _ = all_of_arviz(again, idata)
    np.testing.assert_array_equal(table, later)
    assert np.isfinite(left_out.elpd_loo)
    assert left_out.elpd_loo == pytest.approx(same.elpd_loo)
    assert list(ranked["elpd_diff"]) == [0.0, 0.0]
    assert again.log_likelihood["position"].attrs["how"]


def test_plot_ppc_in_a_fresh_interpreter(whole, tmp_path):
    path = tmp_path / "fit.nc"
    whole.to_netcdf(str(path))
    code = (
        "import sys, arviz as az\n"
        f"idata = az.from_netcdf({str(path)!r})\n"
        "az.plot_ppc(idata); print(az.loo(idata).elpd_loo)\n"
        "assert 'swarmssm' not in sys.modules\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert np.isfinite(float(done.stdout.splitlines()[-1]))


def test_weights_without_a_posterior(of_points):
    assert list(of_points.posterior.data_vars) == ["states"]
    assert "prior" not in of_points.groups()
    density = of_points.log_likelihood["position"]
    np.testing.assert_array_equal(density[0, 0], density[0, -1])
    replicates = of_points.posterior_predictive["position"]
    assert float(replicates.std("draw").min()) > 0.0
    assert "points" in of_points.attrs["notes"]
    assert "no prior group" in of_points.attrs["notes"]


def test_states_are_kept_if_asked_for(springs_fit, ten_trials):
    idata = to_inference_data(springs_fit, ten_trials.isel(trial=[0]), 5, states=4, prior_draws=0)
    states = idata.posterior["states"]
    assert states.dims == ("chain", "draw", "trial", "time", "individual", "latent")
    np.testing.assert_array_equal(
        idata.posterior["time"], ten_trials["time"].to_numpy()[[0, 4, 8, 12]]
    )
    # Paths of a swarm that was seen with noise 0.1 are about what was seen.
    seen = ten_trials["position"].isel(trial=0).transpose("time", "individual", "space")[::4]
    assert float(np.abs(states[0, :, 0, ..., :2] - seen.to_numpy()).max()) < 0.6
    assert "prior" not in idata.groups()


def test_a_later_arviz_gets_a_tree(springs_fit, ten_trials, monkeypatch, tmp_path):
    monkeypatch.setattr(container, "arviz", SimpleNamespace())
    part = ten_trials.isel(trial=[0])
    tree = to_inference_data(springs_fit, part, 5, predictions=2, prior_draws=2)
    assert isinstance(tree, xr.DataTree)
    assert set(tree.children) == GROUPS
    assert tree.attrs["model"] == springs_fit.settings.model
    assert tree["posterior"]["alignment_gain"].dims == ("chain", "draw")
    tree.to_netcdf(tmp_path / "fit.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "fit.nc", engine="h5netcdf") as again:
        np.testing.assert_array_equal(
            again["log_likelihood/position"], tree["log_likelihood/position"]
        )


def test_a_name_kept_for_the_tree_makes_a_tree(monkeypatch):
    monkeypatch.setattr(container, "arviz", SimpleNamespace(InferenceData=xr.DataTree))
    tree = container.container_of({"posterior": xr.Dataset()}, {"seed": 0})
    assert isinstance(tree, xr.DataTree)
    assert tree.attrs == {"seed": 0}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"draws": 0}, "draws: it must be at least 1"),
        ({"prior_draws": -1}, "prior_draws: it must be at least 0"),
        ({"given": 14}, "no position is left"),
        ({"part": "test"}, "the test part is empty"),
        ({"part": "end"}, "part: 'end' is unknown"),
    ],
)
def test_wrong_input(springs_fit, ten_trials, options, words):
    options = {"draws": 2, "prior_draws": 0, **options}
    with pytest.raises(InputError, match=words):
        to_inference_data(springs_fit, ten_trials, **options)
