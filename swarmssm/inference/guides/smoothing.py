"""A guide with an independent Gaussian for each free feature of each step."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from swarmssm.inference.guides.chains import normal_terms, presence_transitions
from swarmssm.inference.guides.following import ModelInformedGuide
from swarmssm.models import SwarmBatch

__all__ = ["SmoothingGuide"]


class SmoothingGuide(ModelInformedGuide):
    r"""Graph encoder and recurrence both ways in time; a diagonal Gaussian for each step.

    .. math:: q(z_{1:T} \mid x) = \prod_i q(z_{1,i} \mid x) \prod_{t>1} q(f_{t,i} \mid x)

    where f are the features that noise moves: of a kinematic transition the velocities, from which
    the positions follow. Means are those of a smoother that the network corrects
    (``ModelInformedGuide``); scales start at the best that
    independence allows. Errors of velocities add up in positions, so that the scales are much
    narrower than the posterior's: where that matters, use
    :class:`~swarmssm.inference.guides.MarkovGuide`.

    The model's law is taken as it stands when the bound is differentiated: through it, the bound
    of a fitted guide does not change to first order, and the model's step is remembered but once.
    """

    differentiates_law: ClassVar[bool] = False

    def path(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Draw a path for each window; see :meth:`PathGuide.path`."""
        known = self.setting(batch, values)
        parts = known.sightings, known.law, known.start, batch.present
        mean = self.chain.mean(*parts)
        spread = self.chain.spread(*parts)
        free = self.model.transition.stochastic_features
        persists, enters = presence_transitions(batch.present)
        # An individual comes or stays, never both: one draw of noise serves either.
        noise = torch.randn_like(mean)
        # Later frames have first states only if somebody comes in one.
        frames = slice(None) if bool(enters[:, 1:].any()) else slice(1)
        log_scale_correction = known.correction
        first_noise, free_noise = noise[:, frames], free(noise)[:, 1:]
        first_log = spread.first[:, frames].log() + log_scale_correction[:, frames]
        free_log = spread.free.log() + free(log_scale_correction)[:, 1:]
        off = self.chain.join(
            mean[:, frames] + first_log.exp() * first_noise,
            free(mean)[:, 1:] + free_log.exp() * free_noise,
            batch.present,
        )
        density = normal_terms(first_noise, first_log.sum(-1), enters[:, frames])
        density = density + normal_terms(free_noise, free_log.sum(-1), persists)
        return known.reference + off, density
