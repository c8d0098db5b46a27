"""Smoothing of one individual whose features all have noise."""

from dataclasses import dataclass

import torch
from torch import Tensor

from swarmssm.inference.guides.chains import (
    Chain,
    Law,
    NeighborTerm,
    Observations,
    Spread,
    Start,
    Steps,
    presence_transitions,
)

__all__ = ["FullChain"]


class FullChain(Chain):
    r"""States in which all features have noise: :math:`z' = J z + u + w`.

    Parameters
    ----------
    state_dim
        Features of a state.
    """

    def __init__(self, state_dim: int) -> None:
        self.state_dim = self.noise_dim = state_dim

    def _messages(
        self, sightings: Observations, law: Law, persists: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return precision and information of all that is seen from a frame on, for each frame."""
        (gain,) = law.gains
        gain = gain.expand(*law.drift.shape[:-1], *gain.shape[-2:])
        keep = persists.to(law.drift.dtype)
        seen = torch.diag_embed(sightings.precision)
        told = sightings.location * sightings.precision
        eye = torch.eye(self.state_dim, dtype=seen.dtype, device=seen.device)
        precision, information = seen[:, -1], told[:, -1]
        found = [(precision, information)]
        for t in range(persists.shape[1] - 1, -1, -1):
            root = law.noise[:, t]
            inner = root.mT @ precision @ root
            factor = torch.linalg.cholesky(eye + inner)
            # In the noise's own units; as a product of small terms, not a difference of large ones.
            share = torch.cholesky_solve(inner, factor)
            share = 0.5 * (share + share.mT)
            part = torch.linalg.solve_triangular(root, gain[:, t], upper=False)
            moved = torch.linalg.solve_triangular(root, law.drift[:, t].unsqueeze(-1), upper=False)
            mine = root.mT @ information.unsqueeze(-1)
            heard = torch.cholesky_solve(mine, factor) - share @ moved
            there = keep[:, t, :, None]
            precision = seen[:, t] + there.unsqueeze(-1) * (part.mT @ share @ part)
            information = told[:, t] + there * (part.mT @ heard).squeeze(-1)
            found.append((precision, information))
        found.reverse()
        precisions, informations = zip(*found, strict=True)
        return torch.stack(precisions, 1), torch.stack(informations, 1)

    def steps(
        self, sightings: Observations, law: Law, start: Start, present: Tensor
    ) -> "FullSteps":
        """Return the conditional distributions; see :meth:`Chain.steps`."""
        persists, enters = presence_transitions(present)
        precision, information = self._messages(sightings, law, persists)
        (gain,) = law.gains
        root, later = law.noise, precision[:, 1:]
        eye = torch.eye(self.state_dim, dtype=root.dtype, device=root.device)
        factor = torch.linalg.cholesky(eye + root.mT @ later @ root)
        # With C the factor, S = K K' and S Q^-1 = K (C^-1 L^-1), where K = L C^-T.
        scale = torch.linalg.solve_triangular(factor, root.mT, upper=False).mT
        unscaled = torch.linalg.solve_triangular(root, eye.expand_as(root), upper=False)
        unscaled = torch.linalg.solve_triangular(factor, unscaled, upper=False)
        share = scale @ unscaled
        offset = share @ law.drift.unsqueeze(-1)
        offset = offset + scale @ (scale.mT @ information[:, 1:].unsqueeze(-1))
        mean = start.mean.expand(sightings.location.shape)
        sure = start.variance.reciprocal().expand_as(mean)
        first = torch.linalg.cholesky(precision + torch.diag_embed(sure))
        told = (information + mean * sure).unsqueeze(-1)
        size = root.diagonal(dim1=-2, dim2=-1).log() - factor.diagonal(dim1=-2, dim2=-1).log()
        return FullSteps(
            persists=persists,
            enters=enters,
            first_factor=first,
            first_mean=torch.cholesky_solve(told, first).squeeze(-1),
            gain=share @ gain,
            share=share,
            offset=offset.squeeze(-1),
            scale=scale,
            log_size=size.sum(-1),
        )

    def spread(self, sightings: Observations, law: Law, start: Start, present: Tensor) -> Spread:
        """Return the scales of independent features; see :meth:`Chain.spread`."""
        persists, _ = presence_transitions(present)
        (gain,) = law.gains
        eye = torch.eye(self.state_dim, dtype=law.noise.dtype, device=law.noise.device)
        inverse = torch.linalg.solve_triangular(law.noise, eye.expand_as(law.noise), upper=False)
        own = inverse.square().sum(-2)
        before = (inverse @ gain).square().sum(-2) * persists.unsqueeze(-1)
        before = torch.cat([before, torch.zeros_like(before[:, :1])], 1)
        seen = sightings.precision
        first = seen + before + start.variance.reciprocal()
        return Spread(first.rsqrt(), (seen[:, 1:] + before[:, 1:] + own).rsqrt())

    def join(self, first: Tensor, free: Tensor, present: Tensor) -> Tensor:
        """Return the path; see :meth:`Chain.join`."""
        persists, enters = presence_transitions(present)
        first = torch.where(enters.unsqueeze(-1)[:, : first.shape[1]], first, 0.0)
        later = torch.where(
            persists.unsqueeze(-1), free, first[:, 1:] if first.shape[1] > 1 else 0.0
        )
        return torch.cat([first[:, :1], later], 1)


@dataclass(frozen=True)
class FullSteps(Steps):
    """Steps of a :class:`FullChain`.

    Attributes
    ----------
    first_factor, first_mean
        Cholesky factor of the precision, and mean, of a first state in each frame.
    gain, share, scale
        ``(batch, time - 1, individual, state, state)``: what the state before, and the law's own
        mean, do to the mean; and a square root of the covariance.
    offset
        ``(batch, time - 1, individual, state)``.
    log_size
        Logarithm of the determinant of ``scale``.
    """

    first_factor: Tensor
    first_mean: Tensor
    gain: Tensor
    share: Tensor
    offset: Tensor
    scale: Tensor
    log_size: Tensor

    def first(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return first states."""
        spread = torch.linalg.solve_triangular(
            self.first_factor.mT, noise.unsqueeze(-1), upper=True
        )
        size = -self.first_factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        return self.first_mean + spread.squeeze(-1), size

    def scaled(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return noise at its scale."""
        return (self.scale @ noise.unsqueeze(-1)).squeeze(-1), self.log_size

    def walk(self, first: Tensor, shift: Tensor | None, pull: NeighborTerm | None) -> Tensor:
        """Return the path, step by step."""
        offset = (self.offset if shift is None else self.offset + shift).unbind(1)
        gain, share = self.gain.unbind(1), self.share.unbind(1)
        persists = self.persists.unsqueeze(-1).unbind(1)
        arrived = torch.where(self.enters.unsqueeze(-1), first, 0.0).unbind(1)
        state = arrived[0]
        path = [state]
        for t, moved in enumerate(offset):
            following = moved + (gain[t] @ state.unsqueeze(-1)).squeeze(-1)
            if pull is not None:
                added = pull(t, state).unsqueeze(-1)
                following = following + (share[t] @ added).squeeze(-1)
            state = torch.where(persists[t], following, arrived[t + 1])
            path.append(state)
        return torch.stack(path, 1)
