"""Latents against forces: what is known beforehand is found, what is not there is not."""

from dataclasses import replace

import numpy as np
import pyro.distributions as dist
import pytest
import torch
import xarray as xr

from swarmssm import forces
from swarmssm.analysis.interpretation.latents.alignment import (
    compare_latents,
    latent_force_alignment,
)
from swarmssm.analysis.interpretation.latents.block_folds import Cells, block_folds
from swarmssm.analysis.interpretation.latents.rotations import nearest_rotation, rotated_axes
from swarmssm.analysis.interpretation.latents.samples import Samples
from swarmssm.analysis.interpretation.latents.sources import View, forces_on, latents_of, untrained
from swarmssm.errors import InputError
from swarmssm.inference import fit
from swarmssm.models import InitialStates, LatentEdges, PositionEmission, StateSpaceModel
from swarmssm.models.transitions import BoidsTransition
from swarmssm.tracks import make_tracks

#: Swift probes for tests of what comes out, not of how sure it is.
QUICK = {"shifts": 9, "untrained_seeds": 1, "limit": 2000}


def slow(generator, *shape, memory=0.9):
    """Return noise ``(trial, time, ...)`` of unit variance that remembers itself for a while."""
    values = generator.standard_normal(shape)
    for t in range(1, shape[1]):
        values[:, t] = memory * values[:, t - 1] + np.sqrt(1 - memory**2) * values[:, t]
    return values


def labelled_forces(values):
    return xr.DataArray(
        values,
        dims=("trial", "time", "individual", "term", "space"),
        coords={"term": ["cohesion", "alignment"], "space": ["x", "y"]},
        attrs={"truth": 1},
    )


def labelled_latents(values, kinds=None):
    count = values.shape[-1]
    return xr.DataArray(
        values,
        dims=("trial", "time", "individual", "latent"),
        coords={
            "latent": [f"z{place + 1}" for place in range(count)],
            "kind": ("latent", kinds or ["latent"] * count),
        },
    )


@pytest.fixture(scope="module")
def rotated():
    """Latents that are a rotation of two forces and two noises, and the rotation."""
    generator = np.random.default_rng(0)
    force = slow(generator, 4, 150, 3, 2, 2)
    noise = slow(generator, 4, 150, 3, 2)
    rotation = nearest_rotation(generator.standard_normal((6, 6)))
    whole = np.concatenate([force.reshape(4, 150, 3, 4), noise], -1)
    latents = labelled_latents(whole @ rotation.T)
    before = [labelled_latents(slow(generator, 4, 150, 3, 6))]
    noises = {"noise": slow(generator, 4, 150, 3, 2)}
    found = compare_latents(latents, labelled_forces(force), noises, before, fps=10.0, shifts=39)
    return found, rotation


def test_a_rotation_of_forces_tells_them_and_is_undone(rotated):
    found, rotation = rotated
    np.testing.assert_allclose(
        found["source_r2"].sel(source="latents", probe="linear"), 1, atol=1e-3
    )
    assert (found["source_p"].sel(source="latents") == 1 / 40).all()
    assert (found["canonical_correlation"].sel(source="latents") > 0.99).all()
    # The latents have about unit variance, so that standardising hardly bends the rotation.
    direction = found["direction"].sel(group="latents").to_numpy()
    assert found["orthogonal"].item() == 1
    np.testing.assert_allclose(direction @ direction.T, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(direction, rotation[:, :4].T, atol=0.2)
    assert (found["purity"] > 0.97).all()
    assert (found["purity"] <= 1).all()
    alone = found["axis_r2"].sel(group="latents").to_numpy()
    assert np.abs(alone - np.eye(4)).max() < 0.12


def test_purity_is_a_share_of_what_all_latents_tell():
    generator = np.random.default_rng(0)
    force = generator.standard_normal((300, 1))
    noise = generator.standard_normal((300, 2))
    cells = Cells.of(np.arange(300), block_folds(np.ones((3, 100), dtype=bool), folds=3))
    # The axis tells all of it: more than all latents were said to, and than nothing.
    latents = np.concatenate([force, noise], 1)
    assert rotated_axes(latents, force, cells, np.array([0.5])).purity == 1
    assert np.isnan(rotated_axes(latents, force, cells, np.array([-0.1])).purity)
    assert rotated_axes(latents, force, cells, np.array([1.0])).purity > 0.99
    # An axis of noise does worse than the mean, in frames left out.
    nothing = rotated_axes(noise, force, cells, np.array([0.5]))
    assert nothing.r2 < 0
    assert nothing.purity == 0


def test_noise_tells_nothing(rotated):
    found, _ = rotated
    assert (found["source_vector_r2"].sel(source="noise") < 0.05).all()
    assert (found["source_p"].sel(source="noise") > 1 / 40).any()
    assert (found["untrained_r2"].sel(source="latents") < 0.05).all()
    assert found["untrained_r2"].sel(source="noise").isnull().all()


def test_p_values_have_a_floor_and_a_family(rotated):
    found, _ = rotated
    least = found.attrs["least_p"]
    assert least == pytest.approx(1 / 40)
    for name in ("latent_p", "latent_vector_p", "source_p", "latent_family_p"):
        assert found[name].min() >= least - 1e-12
        assert found[name].max() <= 1.0
    assert (found["latent_family_p"] >= found["latent_p"] - 1e-12).all()


def test_each_latent_tells_its_share(rotated):
    found, rotation = rotated
    # Independent forces of unit variance: the squared cosine is the share of variance, up to what
    # chance gives 1800 samples that remember ten frames, about 100 independent ones.
    expected = np.square(rotation[:, :4]).reshape(6, 2, 2)
    np.testing.assert_allclose(
        found["latent_r2"].sel(probe="linear"), expected, atol=6 * np.sqrt(1 / 100) / 2
    )


def test_chance_is_told_as_often_as_it_is_said():
    generator = np.random.default_rng(1)
    p = []
    for _ in range(80):
        force, latents = slow(generator, 3, 60, 2, 1), slow(generator, 3, 60, 2, 2)
        known = np.ones((3, 60, 2), dtype=bool)
        data = Samples.of(known, force, (1, 1), 10.0, 3, 19, 1000, int(generator.integers(1 << 30)))
        p.append(data.score(data.rows(latents)[None], linear=True).vector_p[0, 0])
    # Uniform on 1/20, ..., 1: mean 0.525, standard deviation 0.288.
    assert np.mean(p) == pytest.approx(0.525, abs=5 * 0.288 / np.sqrt(80))
    # Of 80, 8 are expected to be 0.1 or below, with a standard deviation of 2.7.
    assert np.sum(np.array(p) <= 0.1001) <= 8 + 5 * 2.7


def test_it_can_be_written(rotated, tmp_path):
    found, _ = rotated
    found.to_netcdf(tmp_path / "latents.nc")
    read = xr.open_dataset(tmp_path / "latents.nc")
    xr.testing.assert_allclose(read.load(), found)
    read.close()
    assert all(found[name].attrs["long_name"] for name in found.data_vars)


def test_nothing_in_common_is_refused():
    latents = labelled_latents(np.full((1, 50, 2, 2), np.nan))
    with pytest.raises(InputError, match="known together"):
        compare_latents(latents, labelled_forces(np.zeros((1, 50, 2, 2, 2))), fps=10.0)


def known_law(scales):
    """Boids with the simulator's own numbers but for a gain."""
    transition = BoidsTransition(
        scales.space,
        scales.dt,
        cohesion_gain=dist.LogNormal(-0.7, 0.3),
        separation_gain=0.3,
        alignment_gain=0.2,
        process_noise=0.02,
    )
    return StateSpaceModel(
        InitialStates.for_scales(scales),
        transition,
        PositionEmission(scales.space, 0.03),
        LatentEdges("radius:2.5"),
    )


@pytest.fixture(scope="module")
def graph_fit(boids):
    """A graph network, trained for a few seconds on exactly known states."""
    return fit(
        "graph-ssm",
        boids,
        guide="parameters",
        model_options={"observed": "states", "noise": "constant", "tails": "gaussian", "width": 16},
        epochs=30,
        window=20,
        lr=0.02,
        seed=0,
    )


def test_latents_of_a_one_step_model_are_posterior_means(quick_fit, boids):
    latents = latents_of(quick_fit, boids)
    mean = quick_fit.posterior(boids, draws=0)["mean"]
    np.testing.assert_allclose(latents, mean.transpose(*latents.dims))
    assert latents["latent"].values.tolist() == ["z1", "z2", "z3", "z4"]
    assert set(latents["kind"].values) == {"latent"}


def test_latents_of_a_graph_network(graph_fit, boids):
    latents = latents_of(graph_fit, boids)
    names = latents["latent"].values.tolist()
    assert names[:6] == ["x", "y", "vx", "vy", "displacement x", "displacement y"]
    assert names[-1] == "message 16"
    np.testing.assert_allclose(
        latents.sel(latent=["x", "y"]).to_numpy(),
        boids["position"].transpose("trial", "time", "individual", "space"),
        rtol=1e-6,
    )
    parts = latents.to_numpy()[..., latents["kind"].values == "part"]
    total = parts.reshape(*parts.shape[:-1], -1, 2).sum(-2)
    # Exactly the acceleration where the soft limits of speed do nothing, near it elsewhere.
    found = View(graph_fit, boids).beside()["acceleration"]
    assert np.median(np.abs(total - found)) < 0.05 * np.abs(found).mean()


def test_latents_of_named_forces_are_the_forces(boids):
    few = boids.isel(trial=slice(0, 1), time=slice(0, 10))
    known = fit(known_law, few, guide="linearized", graph="radius:2.5", fractions=(1.0, 0.0, 0.0))
    tracks = boids.isel(time=slice(0, 40))
    latents = latents_of(known, tracks)
    values = known.guide.parameters_guide.median()
    states = latents.sel(latent=["x", "y", "vx", "vy"]).to_numpy()
    positions = torch.from_numpy(states[..., :2])
    near = torch.cdist(positions, positions) <= 2.5
    graph = (near & ~torch.eye(5, dtype=torch.bool)).to(torch.float64)
    gain = float(values["transition.cohesion_gain"])
    expected = gain * forces.cohesion(positions, graph)
    found = latents.sel(latent=["cohesion x", "cohesion y"]).to_numpy()
    # The model counts in single precision.
    np.testing.assert_allclose(found, expected, atol=1e-4)
    # Nothing in it is random before it is fitted: three initialisations are one.
    assert len(untrained(known, range(3))) == 1
    alignment = latent_force_alignment(known, tracks, **QUICK)
    assert (alignment["source_vector_r2"].sel(source="forces", term="cohesion") > 0.9).all()


def test_a_constructor_without_a_name_cannot_be_called_again(quick_fit, boids):
    settings = quick_fit.settings.model_copy(update={"model": "nowhere:nothing"})
    lost = replace(quick_fit, settings=settings)
    assert untrained(lost, range(3)) == []
    found = latent_force_alignment(lost, boids.isel(time=slice(0, 40)), **QUICK)
    assert found.attrs["initializations"] == 0


def test_true_forces_are_those_of_the_simulation(quick_fit, boids):
    found = forces_on(quick_fit, boids)
    assert found.attrs["truth"] == 1
    np.testing.assert_array_equal(
        found.sel(term="separation").transpose("trial", "time", "space", "individual"),
        boids["force"].sel(term="separation").transpose("trial", "time", "space", "individual"),
    )


def test_without_truth_forces_are_the_terms_of_the_states(quick_fit, boids):
    found = forces_on(quick_fit, boids.drop_vars("force"))
    assert found.attrs["truth"] == 0
    assert found["term"].values.tolist() == ["cohesion", "separation", "alignment"]
    # With gains of 0.5, 0.3 and 0.2, on the same graph, the true forces are these.
    gains = xr.DataArray([0.5, 0.3, 0.2], dims="term", coords={"term": found["term"]})
    true = boids["force"].sel(term=found["term"].values).transpose(*found.dims)
    np.testing.assert_allclose(found * gains, true, atol=1e-9)


def test_training_is_told_from_no_training(graph_fit, boids):
    fresh = untrained(graph_fit, range(2))
    assert len(fresh) == 2
    again = untrained(graph_fit, [0])[0]
    for name, weight in again.model.state_dict().items():
        assert torch.equal(weight, fresh[0].model.state_dict()[name])
    found = latent_force_alignment(graph_fit, boids, **QUICK)
    parts = found.sel(source="parts", probe="linear")
    social = ["cohesion", "separation", "alignment"]
    # Before training all parts are 0, and tell nothing.
    assert (np.abs(parts["untrained_r2"].sel(term=social)) < 0.05).all()
    assert (parts["source_vector_r2"].sel(term=social) > 0.5).all()
    assert found.attrs["model"] == "graph-ssm"


def test_an_encoder_is_probed_like_any_other(quick_fit, boids):
    found = latent_force_alignment(quick_fit, boids, **QUICK)
    assert found["source"].values.tolist() == [
        "latents",
        "acceleration",
        "own observation",
        "own state",
        "observed terms",
    ]
    # Here the observations are exact, and so are the terms that anybody can compute of them.
    exact = found["source_vector_r2"].sel(
        source="observed terms", probe="linear", term=["cohesion", "separation"]
    )
    assert (exact > 0.99).all()
    assert found["untrained_r2"].sel(source="latents").notnull().all()


@pytest.mark.parametrize(("model", "guide"), [("graph-ssm", "markov"), ("linear", "linearized")])
def test_state_space_models_of_positions_with_gaps(boids, model, guide):
    seen = boids["position"].isel(trial=slice(0, 3), time=slice(0, 40))
    position = seen.transpose("trial", "time", "individual", "space").to_numpy().copy()
    position[np.random.default_rng(0).random(position.shape[:3]) < 0.1] = np.nan
    position[0, :, 2] = np.nan
    tracks = make_tracks(position, fps=10.0)
    few = tracks.isel(trial=slice(1, 3), time=slice(0, 10))
    run = fit(model, few, guide=guide, steps=2, window=10, fractions=(1.0, 0.0, 0.0), seed=0)
    found = latent_force_alignment(run, tracks, **QUICK)
    assert found.attrs["truth"] == 0
    assert found["source_vector_r2"].notnull().all()
    assert found["latent"].values[:4].tolist() == ["x", "y", "vx", "vy"]
    observed = found["source_vector_r2"].sel(source="observed terms", probe="linear")
    assert observed.sel(term="cohesion") > 0.5
