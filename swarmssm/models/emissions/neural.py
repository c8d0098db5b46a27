"""A network between the state and what is seen of it."""

from collections.abc import Sequence
from typing import Any, Self

import torch

from swarmssm.errors import InputError
from swarmssm.models.emissions.base import Observes
from swarmssm.models.emissions.noisy import NoisyEmission, Tails
from swarmssm.models.layers import check_sizes, multilayer_perceptron
from swarmssm.models.scales import Scales

__all__ = ["NeuralEmission"]


class NeuralEmission(NoisyEmission):
    r"""Observations that are a learned function of the state, with noise.

    .. math:: x_i = c + u \odot f\bigl((z_i - m) / w\bigr) + s\, \epsilon_i

    with :math:`f` fully connected. For states that are no positions and velocities.

    Parameters
    ----------
    state_dim
        Features of a state.
    observation_dim
        Features of what is observed: those of ``observes``.
    widths
        Widths of the hidden layers of :math:`f`.
    noise
        :math:`s`: a number or one for each feature ``(observation_dim,)``; a prior; or a
        parameter.
    observes
        Which features of the tracks these are, ``"positions"`` or ``"states"``.
    state_centre, state_scale
        :math:`m` and :math:`w`, of which size states are: numbers, or one for each feature.
    centre, unit
        :math:`c` and :math:`u`, of which size observations are.
    tails, excess_degrees
        See :class:`swarmssm.models.emissions.NoisyEmission`.

    Raises
    ------
    ValueError
        If a size or width is no positive whole number, or a scale does not fit.
    """

    def __init__(
        self,
        state_dim: int,
        observation_dim: int,
        widths: Sequence[int],
        noise: Any,
        *,
        observes: Observes = "positions",
        state_centre: Any = 0.0,
        state_scale: Any = 1.0,
        centre: Any = 0.0,
        unit: Any = 1.0,
        tails: Tails = "gaussian",
        excess_degrees: Any = 2.0,
    ) -> None:
        check_sizes(state_dim=state_dim, observation_dim=observation_dim)
        super().__init__(noise, observation_dim, tails, excess_degrees)
        if observes not in ("positions", "states"):
            raise InputError(f"observes: it must be 'positions' or 'states', not {observes!r}.")
        self.observes = observes
        self.observation_dim = observation_dim
        for name, value, size in (
            ("state_centre", state_centre, state_dim),
            ("state_scale", state_scale, state_dim),
            ("centre", centre, observation_dim),
            ("unit", unit, observation_dim),
        ):
            tensor = torch.as_tensor(value, dtype=torch.get_default_dtype())
            if tuple(tensor.shape) not in ((), (size,)):
                raise InputError(
                    f"{name}: it must be a number or ({size},) in shape, and it is "
                    f"{tuple(tensor.shape)}."
                )
            self.register_buffer(name, tensor.expand(size).clone())
        self.network = multilayer_perceptron([state_dim, *widths, observation_dim])

    @classmethod
    def for_scales(
        cls,
        scales: Scales,
        state_dim: int,
        widths: Sequence[int],
        noise: Any,
        *,
        observes: Observes = "positions",
        **options: Any,
    ) -> Self:
        """Return an emission whose results are of the size of the tracks.

        Parameters
        ----------
        scales
            Those of the training tracks.
        state_dim, widths, noise, observes
            As in the class.
        options
            Further ones of the class.
        """
        centre, unit = list(scales.centre), [scales.length] * scales.space
        if observes == "states":
            centre += [0.0] * scales.space
            unit += [scales.speed] * scales.space
        return cls(
            state_dim,
            len(centre),
            widths,
            noise,
            observes=observes,
            centre=centre,
            unit=unit,
            **options,
        )

    def location(self, states: torch.Tensor) -> torch.Tensor:
        """Return what the network makes of the states."""
        made = self.network((states - self.state_centre) / self.state_scale)
        location: torch.Tensor = self.centre + self.unit * made
        return location
