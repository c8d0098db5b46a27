"""The same call gives the same weights, whatever ran before, and leaves no trace of itself."""

import contextlib
import random

import numpy as np
import pyro
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.inference import fit
from swarmssm.tracks import make_tracks


def same(one, other):
    return one.keys() == other.keys() and all(torch.equal(one[k], other[k]) for k in one)


def global_state():
    return (
        torch.get_rng_state().tolist(),
        np.random.get_state()[1].tolist(),  # noqa: NPY002
        random.getstate(),
        torch.is_grad_enabled(),
        torch.get_default_dtype(),
        torch.distributions.Distribution._validate_args,
        pyro.infer.util.is_validation_enabled(),
        pyro.poutine.util.is_validation_enabled(),
        pyro.settings.get(),
        list(pyro.get_param_store().keys()),
    )


@pytest.fixture
def again(swarm, brief):
    """Return a function that fits once more, with other settings if given."""

    def run(tracks=swarm, **settings):
        return fit(tracks=tracks, **{**brief, **settings})

    return run


def test_same_seed_same_weights(fitted, again, weights_of):
    torch.manual_seed(77)  # the global state is of no matter
    repeated = again()
    assert same(weights_of(repeated), weights_of(fitted))
    timeless = [f.history.drop(columns="seconds") for f in (fitted, repeated)]
    assert timeless[0].equals(timeless[1])
    other = again(seed=4)
    assert not any(
        torch.equal(a, b)
        for a, b in zip(weights_of(other).values(), weights_of(fitted).values(), strict=True)
        if a.dim() > 1
    )


def test_settings_that_only_watch_change_no_weight(fitted, again, weights_of, tmp_path):
    """Neither rows of the history, checkpoints, a callback, nor whether Pyro validates."""
    watched = again(checkpoint_every=1, out=tmp_path / "run", callbacks=[lambda _: torch.rand(1)])
    assert same(weights_of(watched), weights_of(fitted))
    often, once = again(validate_every=1).history, again(validate_every=3).history
    assert often.iloc[-1].drop("seconds").equals(once.iloc[-1].drop("seconds"))
    blind = again(fractions=(0.7, 0, 0.3), validate_every=3)
    assert blind.history["loss"].equals(once["loss"])
    # Each row is validated with the same noise: where nothing is learned, nothing changes.
    still = again(lr=1e-12).history["validation_loss"]
    assert np.ptp(still) < 1e-6 * abs(still[0])
    for validate in (True, False):
        with pyro.validation_enabled(validate):
            assert same(weights_of(again()), weights_of(fitted))


@pytest.mark.parametrize("validate", [True, False])
def test_global_state_is_left_as_it_was(again, validate):
    with pyro.validation_enabled(validate):
        before = global_state()
        again()
        assert global_state() == before
        # Also where it fails.
        with pytest.raises(InputError):
            again(model_options={"latent_dim": 0})
        assert global_state() == before

        class Stop(Exception):
            pass

        def stop(_):
            raise Stop

        with pytest.raises(Stop):
            again(callbacks=[stop])
        assert global_state() == before


def test_the_param_store_is_not_touched(again, fitted, weights_of):
    """What another model keeps in it under the same name neither comes in nor goes out."""
    pyro.param("model$$$log_scale", torch.ones(4))
    pyro.param("log_scale", torch.zeros(4))
    before = {k: v.clone() for k, v in pyro.get_param_store().items()}
    assert same(weights_of(again()), weights_of(fitted))
    after = dict(pyro.get_param_store().items())
    assert same(before, after)


def test_the_default_dtype_is_of_no_matter(again, swarm):
    with contextlib.ExitStack() as stack:
        stack.callback(torch.set_default_dtype, torch.get_default_dtype())
        torch.set_default_dtype(torch.float64)
        fitted = again()
        assert {p.dtype for p in fitted.model.parameters()} == {torch.float32}
        assert np.isfinite(fitted.predictive(swarm)["position"][:, 1:]).all()
        assert np.isfinite(fitted.forecast(swarm, 2, draws=2)["position"]).all()


def test_the_test_part_reaches_no_weight(swarm, again, fitted, weights_of):
    """Frames of the test part are changed beyond recognition, those before are not."""
    start = min(segment.start for segment in fitted.split.test)
    position = swarm["position"].transpose("trial", "time", "individual", "space").to_numpy()
    for tracks in (swarm, make_tracks(position, fps=swarm.attrs["fps"])):
        other = tracks.copy(deep=True)
        later = other["time"] >= other["time"][start]
        for name in ("position", "velocity"):
            if name in other:
                other[name] = other[name].where(~later, other[name] * -50 + 1000)
        if "adjacency" in other:
            other["adjacency"] = other["adjacency"].where(~later, 0).astype("uint8")
        one, two = again(tracks), again(other)
        assert same(weights_of(one), weights_of(two))
        assert one.preparation == two.preparation
        assert one.split == two.split
        assert one.history.drop(columns="seconds").equals(two.history.drop(columns="seconds"))


def test_the_validation_part_reaches_only_the_choice(swarm, again, weights_of):
    """It is watched, but neither scales nor trains."""
    fractions = {"fractions": (0.7, 0.3, 0.0)}
    # Of a single row of the history the weights are the best, whatever the validation part is.
    settings = {**fractions, "validate_every": 3}
    start = 70
    other = swarm.copy(deep=True)
    later = other["time"] >= other["time"][start]
    other["position"] = other["position"].where(~later, other["position"] * 1.5)
    one, two = again(swarm, **settings), again(other, **settings)
    assert one.split.validation[0].start == start
    assert same(weights_of(one), weights_of(two))
    assert one.preparation == two.preparation
    assert one.history["loss"].equals(two.history["loss"])
    assert not one.history["validation_loss"].equals(two.history["validation_loss"])


def test_the_scaler_is_that_of_the_training_part(fitted, swarm):
    train = fitted.part(swarm, "train")
    low = [float(train[v].sel(space=s).min()) for v in ("position", "velocity") for s in "xy"]
    high = [float(train[v].sel(space=s).max()) for v in ("position", "velocity") for s in "xy"]
    scaler = fitted.preparation.scaler
    np.testing.assert_allclose(scaler.offset, low, rtol=1e-12)
    np.testing.assert_allclose(np.add(scaler.offset, scaler.scale), high, rtol=1e-12)
    assert not np.allclose(high[:2], [float(swarm["position"].sel(space=s).max()) for s in "xy"])
