"""The unscented Kalman filter: models made affine by sigma points instead of derivatives."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.inference.filtering.affine import AffineMap
from swarmssm.inference.filtering.kalman_filter import Filtered, filter_with
from swarmssm.inference.filtering.matrices import block_diagonal, root
from swarmssm.models import StateSpaceModel, StepInputs, SwarmBatch
from swarmssm.models.distributions.moments import covariance_of

__all__ = ["SigmaPoints", "unscented_kalman"]


@dataclass(frozen=True)
class SigmaPoints:
    r"""Statistical linearisation with the :math:`2n + 1` scaled sigma points of a joint state.

    With :math:`P = L L^\top`, :math:`c^2 = \alpha^2 (n + \kappa)` and
    :math:`y^\pm_k = f(m \pm c L_{\cdot k})`, the function is replaced by the affine one with the
    same mean and covariance with its argument,

    .. math::
        J L = \frac{y^+ - y^-}{2 c}, \qquad
        \Omega = w_0 d_0 d_0^\top + \frac{1}{c^2} \sum_k s_k s_k^\top, \qquad
        s_k = \tfrac12 (y^+_k + y^-_k) - m', \quad d_0 = f(m) - m',

    where :math:`\Omega`, what it misses, is added to the noise. That is the unscented transform of
    Julier and Uhlmann in the scaling of van der Merwe (2004), written as a regression.

    Parameters
    ----------
    alpha, beta, kappa
        Of the scaling. Absent, :math:`c^2 = n` and nothing weighs on the centre: the cubature
        points of Arasaratnam and Haykin (2009), whose weights are never negative.

    Raises
    ------
    InputError
        If ``alpha`` is not above 0.
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if not self.alpha > 0:
            raise InputError(f"alpha must be above 0, and it is {self.alpha}.")

    def step(
        self, model: StateSpaceModel, mean: Tensor, covariance: Tensor, inputs: StepInputs
    ) -> AffineMap:
        """Return the transition as an affine map of joint states; graphs are those of each point.

        Parameters
        ----------
        model
            Its parameters fixed.
        mean, covariance
            ``(..., individual, state)`` and ``(..., joint, joint)``.
        inputs
            Of the step.
        """
        points, factor = self._spread(mean, covariance)
        following = model.step(points, inputs)
        noise = covariance_of(following).expand(*points.shape, points.shape[-1])
        return self._regress(mean, factor, following.mean.expand(points.shape), noise)

    def observe(self, model: StateSpaceModel, mean: Tensor, covariance: Tensor) -> AffineMap:
        """Return the emission as an affine map of joint states; see :meth:`step`."""
        if model.emission.is_exact:
            raise ValueError("a model that observes states exactly has nothing to filter")
        points, factor = self._spread(mean, covariance)
        seen = model.emission(points)
        size = seen.event_shape[-1]
        shape = (*points.shape[:-1], size)
        noise = covariance_of(seen).expand(*shape, size)
        return self._regress(mean, factor, seen.mean.expand(shape), noise)

    def _scale(self, joint: int) -> float:
        scale = self.alpha**2 * (joint + self.kappa)
        if not scale > 0:
            raise InputError(
                f"kappa must be above -{joint}, less the size of the joint state, and it is "
                f"{self.kappa}."
            )
        return scale

    def _spread(self, mean: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
        """Return points ``(point, ..., individual, state)``, the mean first, and the factor."""
        factor = root(covariance)
        reach = math.sqrt(self._scale(covariance.shape[-1])) * factor.movedim(-1, 0)
        reach = reach.reshape(-1, *mean.shape)
        return torch.cat([mean.unsqueeze(0), mean + reach, mean - reach]), factor

    def _regress(self, point: Tensor, factor: Tensor, moved: Tensor, noise: Tensor) -> AffineMap:
        """Return the regression of moved points ``(point, ..., individual, out)``."""
        joint = factor.shape[-1]
        scale = self._scale(joint)
        weight = (scale - joint) / scale
        centre, up, down = torch.split(moved.flatten(-2), [1, joint, joint])
        half = 0.5 * (up + down)
        mean = weight * centre[0] + half.sum(0) / scale
        bent = (half - mean).movedim(0, -1)
        aside = (centre - mean).movedim(0, -1)
        slopes = (0.5 * (up - down) / math.sqrt(scale)).movedim(0, -1)
        missed = (weight + 1 - self.alpha**2 + self.beta) * (aside @ aside.mT)
        missed = missed + bent @ bent.mT / scale
        # A direction without variance has no slope: it is given variance 1 for the solution.
        dead = factor.diagonal(dim1=-2, dim2=-1) <= 0
        whole = factor + torch.diag_embed(dead.to(factor.dtype))
        jacobian = torch.linalg.solve_triangular(whole, slopes, upper=False, left=False)
        middle, rest = noise[0], noise[1:]
        average = weight * middle + rest.sum(0) / (2 * scale)
        return AffineMap(point.flatten(-2), mean, jacobian, block_diagonal(average) + missed)


def unscented_kalman(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor],
    points: SigmaPoints | None = None,
) -> Filtered:
    """Filter the joint state of a swarm with sigma points.

    The same filter as :func:`swarmssm.inference.filtering.extended_kalman`, and equal to it for a
    linear model: presence, missing observations and gradients are as there, and the result can
    be smoothed and drawn from. It asks the transition at ``2 * joint + 1`` points in one call,
    where filterpy's, which the tests hold it against, takes one window and one point at a time.

    Parameters
    ----------
    model, batch, values
        As in :func:`swarmssm.inference.filtering.extended_kalman`.
    points
        Their scaling.

    Raises
    ------
    ValueError
        If the model has no emission.
    WorkError
        If the covariance of an observation is not positive definite.
    """
    return filter_with(model, batch, values, SigmaPoints() if points is None else points)
