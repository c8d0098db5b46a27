"""The unscented filter against filterpy's, and against the exact one where that applies."""

import numpy as np
import pytest
import torch
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from oracles.sigma_points import SigmaPoints, unscented_kalman

from swarmssm.errors import InputError
from swarmssm.inference.filtering import extended_kalman, smooth

STATE = 4
MISSING = [(0, 2, 1), (0, 3, 1), (1, 5, slice(None))]
ABSENT = [(0, slice(0, 2), 2), (0, slice(5, None), 0), (1, slice(2, 4), 1)]
SCALINGS = [SigmaPoints(), SigmaPoints(0.7, 2.0, 1.0)]


@pytest.mark.parametrize("kind", ["general", "kinematic"])
@pytest.mark.parametrize("points", SCALINGS)
def test_it_is_the_kalman_filter_of_a_linear_model(kind, points, linear_swarm, windows):
    model, batch = linear_swarm(kind), windows(missing=MISSING, absent=ABSENT, controls=True)
    exact, found = extended_kalman(model, batch, {}), unscented_kalman(model, batch, {}, points)
    torch.testing.assert_close(found.log_evidence, exact.log_evidence, rtol=1e-9, atol=0)
    torch.testing.assert_close(found.mean, exact.mean, rtol=1e-8, atol=1e-9)
    torch.testing.assert_close(found.covariance, exact.covariance, rtol=1e-8, atol=1e-9)
    torch.testing.assert_close(smooth(found).mean, smooth(exact).mean, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("points", SCALINGS)
def test_it_is_filterpys_where_the_model_bends(points, bent_swarm, windows, observed):
    model = bent_swarm()
    batch, _ = observed(model, windows(batch=1, times=8, individuals=2))
    found = unscented_kalman(model, batch, {}, points)
    individuals, inputs = batch.num_individuals, batch.steps()
    joint = individuals * STATE

    def as_states(x):
        return torch.from_numpy(np.asarray(x).reshape(1, individuals, STATE))

    def emit(x):
        return model.emission(as_states(x)).mean.reshape(-1).numpy()

    judge = UnscentedKalmanFilter(
        dim_x=joint,
        dim_z=individuals * 2,
        dt=1.0,
        hx=emit,
        fx=None,
        points=MerweScaledSigmaPoints(joint, points.alpha, points.beta, points.kappa),
    )
    judge.x = model.initial.mean.repeat(individuals).numpy()
    judge.P = np.diag(model.initial.scale.square().repeat(individuals).numpy())
    judge.R = float(model.emission.noise) ** 2 * np.eye(individuals * 2)
    noise = model.transition(as_states(np.zeros(joint)), inputs.at(0)).covariance_matrix[0]
    judge.Q = torch.block_diag(*noise).numpy()
    for t in range(batch.num_times):
        if t == 0:
            judge.sigmas_f = judge.points_fn.sigma_points(judge.x, judge.P)
        else:

            def move(x, dt, t=t):
                return model.transition(as_states(x), inputs.at(t - 1)).mean.reshape(-1).numpy()

            judge.predict(fx=move)
        judge.update(batch.observations[0, t].reshape(-1).numpy())
        increment = float(found.log_increments[0, t])
        assert increment == pytest.approx(judge.log_likelihood, rel=1e-8, abs=1e-8)
        np.testing.assert_allclose(found.mean[0, t].reshape(-1).numpy(), judge.x, atol=1e-8)
        np.testing.assert_allclose(found.covariance[0, t].numpy(), judge.P, atol=1e-8)


def test_two_windows_are_filtered_as_each_alone(bent_swarm, windows):
    model, batch = bent_swarm(), windows(missing=MISSING, absent=ABSENT)
    both = unscented_kalman(model, batch, {})
    for window in range(2):
        alone = unscented_kalman(model, batch.select(torch.tensor([window])), {})
        torch.testing.assert_close(both.mean[window], alone.mean[0], rtol=1e-9, atol=1e-10)
        torch.testing.assert_close(both.log_evidence[window], alone.log_evidence[0])


def test_scalings_without_a_spread_are_refused(linear_swarm, windows):
    with pytest.raises(InputError, match="alpha must be above 0"):
        SigmaPoints(alpha=0)
    with pytest.raises(InputError, match="kappa must be above -12"):
        unscented_kalman(linear_swarm("general"), windows(), {}, SigmaPoints(kappa=-12))
