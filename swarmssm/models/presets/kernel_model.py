"""Kernels of distance, to be inferred: ``swarmssm fit FILE --model kernel``."""

import math
from collections.abc import Mapping
from typing import Any, Literal, get_args

import pyro.distributions as dist
import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.models.presets.self_terms import (
    Observed,
    check_choice,
    positive,
    self_term_priors,
    state_space_model,
    true_speed,
    view_priors,
)
from swarmssm.models.scales import Scales
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.force import Noise
from swarmssm.models.transitions.kernel import Aggregation, KernelTransition
from swarmssm.models.transitions.radial_basis import SplineBasis

__all__ = ["Influence", "kernel", "smoothing_prior"]

Influence = Literal["individual", "pair"]
#: Height of a kernel in its unit: what turns an individual within the distance to its neighbour.
HEIGHT = 3.0
#: Standard deviation of each weight of the angular modulation.
MODULATION = 0.5
#: Standard deviation of the logarithm of how much an individual counts.
UNLIKE = 0.5


def kernel(
    scales: Scales,
    *,
    splines: int = 10,
    reach: float | None = None,
    smoothness: float = 0.3,
    repulsion: bool = False,
    angular: int = 0,
    influence: Influence | None = None,
    responsiveness: bool = False,
    aggregation: Aggregation = "mean",
    noise: Noise = "additive",
    walls: bool = True,
    limits: bool = True,
    relaxation: bool = False,
    radius: float | Literal["infer"] | None = None,
    edges: str | None = None,
    observed: Observed = "positions",
    priors: Mapping[str, Any] | None = None,
) -> StateSpaceModel:
    r"""Return the law of kernels with a smoothing prior in the units of the tracks.

    Let U be the typical speed (tracking noise taken off), l the distance to the nearest neighbour.
    :math:`U^2 / l` turns an individual within that distance: it is the unit of attraction and
    repulsion, U / l that of alignment. In these, the coefficients of each kernel, which are about
    its values at the heights of the splines, have the prior

    .. math:: p(c) \propto \exp\Bigl(-\tfrac{1}{2\sigma^2}\bigl(|c|^2 +
       |D c|^2 / s^2\bigr)\Bigr),

    with D the second differences, s the smoothness, and :math:`\sigma = 3`. Where there are no data
    the band of a kernel is that of this prior. All else has the priors of
    :func:`swarmssm.models.presets.boids`.

    Parameters
    ----------
    scales
        Of the training tracks.
    splines
        Number of basis functions of each kernel.
    reach
        Distance of the last knot; absent, the radius of the edges' rule or of the view, or else the
        98th percentile of the distance between two individuals.
    smoothness
        s: small for smooth kernels.
    repulsion
        Whether a further kernel is summed over the neighbours, where attraction and alignment are
        averaged, as separation is in boids. It can be told from attraction only where the number
        of neighbours changes.
    angular
        Number of cosines in the modulation by the angle at which a neighbour is seen, each weight
        Normal(0, 0.5); 0, none.
    influence
        ``"individual"``: each moves others with a weight of its own; ``"pair"``: each other with
        another. LogNormal(0, 0.5).
    responsiveness
        Whether each is moved with a weight of its own, likewise.
    aggregation
        See :class:`~swarmssm.models.transitions.KernelTransition`.
    noise
        As in ``boids``, but additive unless told: animals stand still now
        and then, and a noise that is in proportion to their speed would have none of that.
    walls, limits, relaxation, radius, edges, observed, priors
        As there.

    Raises
    ------
    InputError
        If an option is none of the above, or there is no parameter of a name in ``priors``.
    """
    check_choice("observed", observed, get_args(Observed))
    check_choice("influence", influence, (None, *get_args(Influence)))
    if not isinstance(angular, int) or angular < 0:
        raise InputError(f"angular: it must be a number of cosines, 0 or more, not {angular!r}.")
    if not 0.0 < smoothness < math.inf:
        raise InputError(f"smoothness: it must be positive, not {smoothness!r}.")
    view = view_priors(scales, radius)
    spacing, speed = positive(scales.spacing), true_speed(scales)
    units = (speed**2 / spacing, speed / spacing)
    basis = SplineBasis(_reach(scales, reach, radius, edges), 0.5 * spacing, splines)

    curve = smoothing_prior(basis, HEIGHT, smoothness)
    options: dict[str, Any] = {}
    if repulsion:
        options["repulsion"] = curve
    if angular:
        options["modulation"] = dist.Normal(torch.zeros(angular), MODULATION).to_event(1)
    number = scales.individuals
    if influence is not None:
        shape = (number,) if influence == "individual" else (number, number)
        options["influence"] = dist.LogNormal(torch.zeros(shape), UNLIKE).to_event(len(shape))
    if responsiveness:
        options["responsiveness"] = dist.LogNormal(torch.zeros(number), UNLIKE).to_event(1)
    transition = KernelTransition(
        scales.space,
        scales.dt,
        basis=basis,
        units=units,
        attraction=curve,
        alignment=curve,
        aggregation=aggregation,
        noise=noise,
        **options,
        **view,
        **self_term_priors(
            scales,
            form="acceleration",
            noise=noise,
            walls=walls,
            limits=limits,
            relaxation=relaxation,
            observed=observed,
        ),
    )
    return state_space_model(
        scales,
        transition,
        observed=observed,
        edges=edges,
        infer_radius=radius == "infer",
        priors=priors,
    )


def smoothing_prior(
    basis: SplineBasis, height: float, smoothness: float
) -> dist.MultivariateNormal:
    r"""Return the prior of a kernel's coefficients, see :func:`kernel`.

    Parameters
    ----------
    basis
        Of the kernel.
    height
        :math:`\sigma`.
    smoothness
        s.
    """
    rough = basis.roughness()
    precision = torch.eye(basis.size, dtype=rough.dtype) + rough.T @ rough / smoothness**2
    root: Tensor = torch.linalg.cholesky(height**2 * torch.linalg.inv(precision))
    dtype = torch.get_default_dtype()
    return dist.MultivariateNormal(torch.zeros(basis.size), scale_tril=root.to(dtype))


def _reach(
    scales: Scales,
    given: float | None,
    radius: float | Literal["infer"] | None,
    edges: str | None,
) -> float:
    """Return the distance beyond which nobody is seen."""
    if given is not None:
        return given
    if isinstance(radius, int | float):
        return float(radius)
    if edges is not None and edges.startswith("radius:"):
        return float(edges.removeprefix("radius:"))
    return positive(scales.apart or 2.0 * scales.length)
