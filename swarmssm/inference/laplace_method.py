"""The posterior of the global parameters by Laplace's method, the latent paths summed out."""

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyro
import scipy
import torch
from torch import Tensor
from torch.distributions import biject_to

from swarmssm.errors import InputError, WorkError
from swarmssm.inference.collapsed_model import population_evidence
from swarmssm.inference.filtering.evidence import Method, collapsed_evidence, linearization_points
from swarmssm.inference.filtering.layouts import Layout, Points
from swarmssm.inference.guides.parameters import GlobalGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import StateSpaceModel, SwarmBatch

__all__ = ["Laplace", "laplace"]

#: Rounds of maximising at held points and moving the points.
ROUNDS = 6
#: The maximum stands when a round moves it by less than this part of its standard deviations.
SETTLED = 0.02
#: Or when it makes the parameters more probable by less than so many nats.
GAIN = 1e-2
#: Steps of L-BFGS in the first rounds, while the points are still far off.
FIRST_STEPS = 10
STEPS = 60
#: Difference for the Hessian, in standard deviations of the prior on the unconstrained scale.
DIFFERENCE = 1e-3
#: Least curvature that is believed: a standard deviation of 10 of those of the prior.
LEAST_CURVATURE = 1e-2
#: Moves of the normal to the middle of the posterior, at most, and what ends them: a step and a
#: change of width that are less than so many standard deviations.
REFINEMENTS, REFINED = 3, 0.1
#: Draws from which the spread of the prior is taken.
PRIOR_DRAWS = 200
#: The objective where a filter breaks down, so that a line search turns back.
OUT_OF_BOUNDS = 1e15

#: Told the number of the step, the negative log-density and, after a step, the parameters.
Callback = Callable[[int, float, Tensor | None], None]


@dataclass(frozen=True)
class Laplace:
    r"""Normal approximation of the posterior on the unconstrained scale.

    Attributes
    ----------
    names
        Full names of the parameters with a prior, in the order of ``loc``.
    loc
        Its mean, unconstrained and in one vector.
    scale_tril
        Lower Cholesky factor of the covariance.
    values
        Full name -> value at ``loc``.
    log_joint
        :math:`\log p(x, \theta)` there, with the Jacobian of the unconstrained scale.
    log_evidence
        The log evidence by Laplace's method, or if the normal was refined the lower bound that it
        makes, in nats, windows weighted.
    points
        Where the model was linearised at last; ``None`` if it was linearised as the filter went.
    rounds
        How often they were moved.
    steps
        Steps of L-BFGS that were taken.
    """

    names: tuple[str, ...]
    loc: Tensor
    scale_tril: Tensor
    values: dict[str, Tensor]
    log_joint: float
    log_evidence: float
    points: Points | None
    rounds: int
    steps: int

    def fill(self, guide: GlobalGuide) -> None:
        """Give the posterior to a guide of kind ``"multivariate"`` of the same model.

        Raises
        ------
        ValueError
            If the guide is of another kind, or over other parameters.
        """
        if guide.kind != "multivariate" or tuple(guide.names) != self.names:
            raise ValueError("a guide of kind 'multivariate' of the same model is needed")
        if not self.names:
            return
        auto = guide.auto
        scale = self.scale_tril.diagonal()
        auto.loc.data = self.loc.to(auto.loc)
        auto.scale = scale.to(auto.loc)
        auto.scale_tril = (self.scale_tril / scale.unsqueeze(-1)).to(auto.loc)


def laplace(
    model: StateSpaceModel,
    batch: SwarmBatch,
    *,
    method: Method = "iterated",
    layout: Layout = "auto",
    given: int = 0,
    start: Mapping[str, Tensor] | None = None,
    refine: bool = True,
    steps: int | None = None,
    callback: Callback | None = None,
) -> Laplace:
    r"""Fit all parameters of a model by Laplace's method, and move the normal to where it fits.

    The evidence of the windows times the priors is maximised by L-BFGS on the unconstrained scale.
    With ``method="iterated"`` the points of linearisation are held meanwhile, and moved to the
    new posterior path afterwards, until neither moves. The covariance is the inverse of the
    Hessian by central differences of the gradient; curvatures that are not positive are
    replaced by their size, and by that of ten standard deviations of the prior where there is none.

    The mode of a skewed posterior is not its middle. A refined normal :math:`q = N(m, S)` is that
    of the smallest divergence :math:`KL(q \,\|\, p)`, at which

    .. math:: E_q[\nabla \log p] = 0, \qquad S^{-1} = -E_q[\nabla^2 \log p];

    both expectations are taken by the rule of third degree at :math:`m \pm \sqrt 3\, s_k`, with
    :math:`s_k` the columns of a root of S, at the held points of linearisation. Of a normal
    posterior it is the same as Laplace's.

    Parameters that the model learns without prior (:class:`torch.nn.Parameter`) are maximised over
    together with the others and left at the maximum; the covariance is that at their values.

    Parameters
    ----------
    model
        With an emission.
    batch
        All windows to fit; weighted and scaled as in the ELBO.
    method, layout, given
        As in :func:`swarmssm.inference.filtering.collapsed_evidence`.
    start
        Values to begin with, full name -> value; those left out begin at the prior's median.
    refine
        Whether the normal is moved so; else it stays about the mode.
    steps
        Steps of L-BFGS at most; absent, until the maximum stands.
    callback
        Called after each evaluation with the number of the step, the negative log-density, and
        the unconstrained parameters if the step was taken there, else ``None``.

    Raises
    ------
    InputError
        If the model has nothing to fit, or states that are not hidden.
    WorkError
        If no maximum is found: the evidence breaks down or is not finite where it begins.

    References
    ----------
    M. Opper and C. Archambeau (2009), The variational Gaussian approximation revisited, Neural
    Computation 21.
    """
    if model.emission.is_exact:
        raise InputError("model: its states are observed exactly; there is nothing to sum out.")
    with quiet_pyro():
        problem = _Problem(model, batch, method, layout, given, start or {}, refine, callback)
        return problem.solve(steps)


class _Problem:
    """The log-density over one vector: unconstrained parameters, then learned ones."""

    def __init__(
        self,
        model: StateSpaceModel,
        batch: SwarmBatch,
        method: Method,
        layout: Layout,
        given: int,
        start: Mapping[str, Tensor],
        refine: bool,
        callback: Callback | None,
    ) -> None:
        self.original = model
        self.model = copy.deepcopy(model).double()
        self.batch = _as_double(batch)
        self.method, self.layout, self.callback = method, layout, callback
        self.given, self.refine = given, refine
        guide = GlobalGuide(self.model, "multivariate")
        self.names = tuple(guide.names)
        middle = guide.median()
        middle = {name: start.get(name, middle[name]).detach().double() for name in self.names}
        self.transforms = self._transforms(middle)
        self.shapes = {}
        pieces = []
        for name in self.names:
            free = self.transforms[name].inv(middle[name])
            self.shapes[name] = free.shape
            pieces.append(free.reshape(-1))
        self.learned = [p for p in self.model.parameters() if p.requires_grad]
        pieces += [p.detach().reshape(-1) for p in self.learned]
        if not pieces:
            raise InputError("model: it has no parameter with a prior, and none to be learned.")
        self.number = sum(shape.numel() for shape in self.shapes.values())
        # All is sought in units of the prior, since parameters have the units of the data.
        self.scale = np.ones(sum(piece.numel() for piece in pieces))
        self.scale[: self.number] = self._spread()
        self.start = torch.cat(pieces).numpy() / self.scale
        self.steps = 0
        self.points: Points | None = None
        self.trouble: WorkError | None = None

    def _transforms(self, values: Mapping[str, Tensor]) -> dict[str, Any]:
        """Return the way from the unconstrained scale to each parameter."""
        trace = self._prior(values)
        return {name: biject_to(trace.nodes[name]["fn"].support) for name in self.names}

    def _prior(self, values: Mapping[str, Tensor]) -> Any:
        """Trace the parameters at given values."""
        condition = pyro.poutine.condition(self.model.sample_globals, data=dict(values))
        return pyro.poutine.trace(condition).get_trace()

    def _spread(self) -> Any:
        """Return the spread of the prior of each parameter on the unconstrained scale.

        Half of the middle 68 %: a standard deviation that heavy tails do not reach.
        """
        rows = []
        with torch.no_grad(), torch.random.fork_rng():
            torch.manual_seed(0)
            for _ in range(PRIOR_DRAWS if self.names else 0):
                drawn = pyro.poutine.trace(self.model.sample_globals).get_trace().nodes
                parts = [self.transforms[name].inv(drawn[name]["value"]) for name in self.names]
                rows.append(torch.cat([part.reshape(-1).double() for part in parts]).numpy())
        if not rows:
            return np.ones(0)
        low, high = np.nanquantile(rows, [0.16, 0.84], axis=0)
        spread = 0.5 * (high - low)
        return np.where((spread > 0) & np.isfinite(spread), spread, 1.0)

    def values(self, free: Tensor) -> tuple[dict[str, Tensor], Tensor]:
        """Return the values of an unconstrained vector, and the log of the Jacobian."""
        values, place = {}, 0
        jacobian = free.new_zeros(())
        for name in self.names:
            shape = self.shapes[name]
            part = free[place : place + shape.numel()].reshape(shape)
            place += shape.numel()
            transform = self.transforms[name]
            values[name] = transform(part)
            jacobian = jacobian + transform.log_abs_det_jacobian(part, values[name]).sum()
        return values, jacobian

    def log_joint(self, free: Tensor) -> Tensor:
        """Return the log-density over the unconstrained scale, at the held points."""
        values, jacobian = self.values(free)
        prior = self._prior(values).log_prob_sum() if self.names else 0.0
        evidence = collapsed_evidence(
            self.model,
            self.batch,
            values,
            method=self.method,
            layout=self.layout,
            points=self.points,
            given=self.given,
        )
        return population_evidence(self.batch, evidence) + prior + jacobian

    def __call__(self, place: Any) -> tuple[float, Any]:
        """Return the negative log-density and its gradient, in units of the prior."""
        free = self._free(place).requires_grad_()
        self._learn(place)
        try:
            total = -self.log_joint(free)
        except WorkError as error:
            self.trouble = error
            return OUT_OF_BOUNDS, np.zeros_like(place)
        inputs = [*([free] if self.number else []), *self.learned]
        gradients = torch.autograd.grad(total, inputs, allow_unused=True)
        flat = [
            torch.zeros_like(value).reshape(-1) if gradient is None else gradient.reshape(-1)
            for value, gradient in zip(inputs, gradients, strict=True)
        ]
        value, gradient = float(total.detach()), torch.cat(flat).numpy() * self.scale
        if self.callback is not None:
            self.callback(self.steps, value, None)
        if not (math.isfinite(value) and np.isfinite(gradient).all()):
            return OUT_OF_BOUNDS, np.zeros_like(place)
        return value, gradient

    def _free(self, place: Any) -> Tensor:
        """Return the unconstrained parameters at a place."""
        return torch.from_numpy((place * self.scale)[: self.number])

    def _learn(self, place: Any) -> None:
        """Put the values of learned parameters into the model."""
        at = self.number
        with torch.no_grad():
            for parameter in self.learned:
                part = torch.from_numpy(place[at : at + parameter.numel()])
                parameter.copy_(part.reshape(parameter.shape))
                at += parameter.numel()

    def _move_points(self, place: Any) -> None:
        """Linearise at the most probable path of the present values."""
        if self.method == "iterated":
            self._learn(place)
            values, _ = self.values(self._free(place))
            self.points = linearization_points(
                self.model, self.batch, values, layout=self.layout, start=self.points
            )

    def solve(self, steps: int | None) -> Laplace:
        """Maximise, and measure the curvature."""
        place = self.start
        # Round 1 finds the neighbourhood; then the posterior's own standard deviation is the unit.
        unit = np.eye(len(place))
        self._move_points(place)
        if self(place)[0] >= OUT_OF_BOUNDS:
            raise self.trouble or WorkError("The evidence is not finite at the first values.")
        for rounds in range(1, ROUNDS + 1):
            most = FIRST_STEPS if rounds == 1 else STEPS
            most = most if steps is None else min(most, steps - self.steps)
            shift, gained = self._maximise(place, unit, most)
            place = place + unit @ shift
            still = bool((np.abs(shift[: self.number]) < SETTLED).all()) or gained < GAIN
            settled = rounds > 1 and still
            self._move_points(place)
            if settled or rounds == ROUNDS or (steps is not None and self.steps >= steps):
                break
            if rounds == 1:
                unit = self._unit(self._hessian(place, forward=True))
        return self._finish(place, unit, rounds)

    def _maximise(self, place: Any, unit: Any, steps: int) -> tuple[Any, float]:
        """Return how far the maximum at the held points is in the given unit, and how high."""

        def objective(shift: Any) -> tuple[float, Any]:
            value, gradient = self(place + unit @ shift)
            return value, unit.T @ gradient

        def taken(intermediate_result: scipy.optimize.OptimizeResult) -> None:
            self.steps += 1
            if self.callback is not None:
                free = self._free(place + unit @ intermediate_result.x)
                self.callback(self.steps, float(intermediate_result.fun), free)

        start = self(place)[0]
        # L-BFGS wants a change relative to the value.
        tolerance = 0.1 * GAIN / max(abs(start), 1.0)
        options = {"maxiter": steps, "ftol": tolerance, "gtol": 0.1 * SETTLED}
        found = scipy.optimize.minimize(  # type: ignore[call-overload]
            objective,
            np.zeros_like(place),
            jac=True,
            method="L-BFGS-B",
            options=options,
            callback=taken,
        )
        return found.x, start - float(found.fun)

    def _hessian(self, place: Any, *, forward: bool = False) -> Any:
        """Return the Hessian in the parameters with a prior, by differences of gradients."""
        rows = []
        here = self(place)[1] if forward else None
        for step in DIFFERENCE * np.eye(len(place))[: self.number]:
            ahead = self(place + step)[1]
            rows.append(ahead - (self(place - step)[1] if here is None else here))
        hessian = np.array(rows).reshape(self.number, len(place))[:, : self.number]
        width = DIFFERENCE if forward else 2.0 * DIFFERENCE
        return 0.5 * (hessian + hessian.T) / width

    def _unit(self, hessian: Any) -> Any:
        """Return the matrix that makes standard deviations out of units."""
        unit = np.eye(len(self.start))
        unit[: self.number, : self.number] = np.linalg.cholesky(_inverse(hessian))
        return unit

    def _finish(self, place: Any, unit: Any, rounds: int) -> Laplace:
        """Return the normal about the maximum or where it fits best, and leave learned parameters
        there.
        """
        found = None
        if self.refine and self.number:
            found = self._refined(place, unit[: self.number, : self.number])
        if found is None:
            value = self(place)[0]
            factor = np.linalg.cholesky(_inverse(self._hessian(place)))
            expected = value + 0.5 * self.number
        else:
            place, factor, expected = found
            value = self(place)[0]
        self._learn(place)
        mine = [p for p in self.original.parameters() if p.requires_grad]
        with torch.no_grad():
            for parameter, learned in zip(mine, self.learned, strict=True):
                parameter.copy_(learned)
            values, _ = self.values(self._free(place))
        factor = factor * self.scale[: self.number, None]
        # The entropy of the normal; of Laplace's, the expectation is half a nat a number.
        entropy = np.log(np.diag(factor)).sum()
        entropy += 0.5 * self.number * (1.0 + math.log(2.0 * math.pi))
        return Laplace(
            self.names,
            self._free(place),
            torch.from_numpy(factor),
            values,
            -value,
            float(entropy) - expected,
            self.points,
            rounds,
            self.steps,
        )

    def _refined(self, place: Any, factor: Any) -> tuple[Any, Any, float] | None:
        """Return mean, root of the covariance and expected negative log-density of the normal of
        the smallest divergence; ``None`` where the density breaks down within it.
        """
        number, reach = self.number, math.sqrt(3.0)
        for _ in range(REFINEMENTS):
            value, slope = self(place)
            expected, gradient = value, slope[:number].copy()
            bends = np.zeros((number, number))
            for k in range(number):
                step = np.zeros_like(place)
                step[:number] = reach * factor[:, k]
                ahead, behind = self(place + step), self(place - step)
                if max(ahead[0], behind[0]) >= OUT_OF_BOUNDS:
                    return None
                expected += (ahead[0] + behind[0] - 2.0 * value) / 6.0
                gradient += (ahead[1] + behind[1] - 2.0 * slope)[:number] / 6.0
                bends[:, k] = factor.T @ (ahead[1] - behind[1])[:number] / (2.0 * reach)
            # Now in units of the factor, in which a settled normal has the curvature 1.
            curvature = _inverse(_inverse(0.5 * (bends + bends.T)))
            shift = -np.linalg.solve(curvature, factor.T @ gradient)
            # Where the normal is far too wide or too narrow still, a step might be too long.
            shift *= min(1.0, 1.0 / max(np.abs(shift).max(), 1e-300))
            place = place.copy()
            place[:number] += factor @ shift
            factor = factor @ np.linalg.cholesky(np.linalg.inv(curvature))
            factor = np.linalg.cholesky(factor @ factor.T)
            width = np.abs(np.linalg.eigvalsh(curvature) - 1.0).max()
            if np.abs(shift).max() < REFINED and width < REFINED:
                break
        return place, factor, expected


def _inverse(hessian: Any) -> Any:
    """Return the inverse of a Hessian made positive definite."""
    values, vectors = np.linalg.eigh(hessian)
    values = np.maximum(np.abs(values), LEAST_CURVATURE)
    return (vectors / values) @ vectors.T


def _as_double(batch: SwarmBatch) -> SwarmBatch:
    """Return the batch with numbers of double precision."""
    adjacency = batch.adjacency
    return replace(
        batch,
        observations=batch.observations.double(),
        adjacency=adjacency.double() if isinstance(adjacency, Tensor) else adjacency,
        window_weight=batch.window_weight.double(),
        controls=None if batch.controls is None else batch.controls.double(),
    )
