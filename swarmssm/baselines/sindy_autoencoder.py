r"""SINDy autoencoder: coordinates in which the motion of an individual is a sparse polynomial."""

import copy
import itertools
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.baselines.gaps import fill_gaps
from swarmssm.baselines.selection import rollout_error
from swarmssm.baselines.social_terms import social_terms
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array
from swarmssm.tracks.scaling import Scaler, fit_scaler

__all__ = ["SindyAutoencoder", "SparseAutoencoder", "TangentNetwork"]

ROWS_AT_ONCE = 2**14
#: Scaled inputs are kept within so many standard deviations.
FARTHEST = 20.0
#: Shares of the training after which small coefficients are dropped; then nothing is dropped any
#: more, and the penalty on coefficients is lifted.
THRESHOLDED_AT = tuple(0.1 * part for part in range(1, 8))
REFINED_FROM = 0.75
#: How often the weights are judged by rollouts while they are refined.
JUDGED = 6
JUDGED_TRIALS = 4


@dataclass(frozen=True)
class Sizes:
    """How large the parts of the network are.

    Attributes
    ----------
    observed
        Numbers that the encoder sees.
    latent
        Coordinates that it makes of them.
    controls
        Numbers that enter the library as they are.
    widths
        Of the hidden layers of the encoder; those of the decoder are the same backwards.
    """

    observed: int
    latent: int
    controls: int
    widths: tuple[int, ...]


class TangentNetwork(nn.Module):
    """Layers with sigmoids between them, which carry a velocity along with each point."""

    def __init__(self, widths: tuple[int, ...]) -> None:
        super().__init__()
        pairs = itertools.pairwise(widths)
        self.layers = nn.ModuleList(nn.Linear(first, second) for first, second in pairs)
        for layer in self.layers:
            if isinstance(layer, nn.Linear):
                nn.init.xavier_uniform_(layer.weight)
                nn.init.zeros_(layer.bias)

    def forward(self, point: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Return where the point goes and, by the chain rule, how fast: ``(..., feature)`` each."""
        for number, layer in enumerate(self.layers):
            if not isinstance(layer, nn.Linear):
                raise TypeError("every layer is linear")
            point = layer(point)
            velocity = nn.functional.linear(velocity, layer.weight)
            if number + 1 < len(self.layers):
                point = torch.sigmoid(point)
                velocity = point * (1.0 - point) * velocity
        return point, velocity


class SparseAutoencoder(nn.Module):
    """Encoder, decoder and the sparse law of the latent coordinates between them."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        inner = (sizes.observed, *sizes.widths, sizes.latent)
        self.encoder = TangentNetwork(inner)
        self.decoder = TangentNetwork(inner[::-1])
        latent = range(sizes.latent)
        self.products = [
            torch.tensor(list(itertools.combinations_with_replacement(latent, degree)))
            for degree in (2, 3)
        ]
        count = 1 + sizes.latent + sum(len(part) for part in self.products) + sizes.controls
        self.coefficients = nn.Parameter(0.1 * torch.randn(count, sizes.latent))
        self.active: Tensor
        self.register_buffer("active", torch.ones(count, sizes.latent))

    def library(self, latent: Tensor, controls: Tensor) -> Tensor:
        """Return 1, products of up to three latent coordinates, and the controls."""
        products = [
            math.prod((latent[:, factor] for factor in part.unbind(-1)), start=latent.new_ones(()))
            for part in self.products
        ]
        return torch.cat([torch.ones_like(latent[:, :1]), latent, *products, controls], -1)

    def velocity(self, latent: Tensor, controls: Tensor) -> Tensor:
        """Return the velocity of latent coordinates that the sparse law gives."""
        return self.library(latent, controls) @ (self.active * self.coefficients)

    def forward(self, observed: Tensor, controls: Tensor) -> Tensor:
        """Return the velocity of what was observed, decoded from that of the latent coordinates."""
        latent, _ = self.encoder(observed, observed)
        decoded: Tensor = self.decoder(latent, self.velocity(latent, controls))[1]
        return decoded


class SindyAutoencoder(Baseline):
    r"""A delay-coordinate SINDy autoencoder of each individual, driven by its neighbours.

    An encoder :math:`\varphi` makes latent coordinates *z* of *x*, the last five states of an
    individual in a row; a decoder :math:`\psi` makes *x* of *z*; and the latent coordinates move as

    .. math:: \dot z = \Theta(z, u)\, \Xi, \qquad
        \Theta = [1, z, \text{products of two and three of } z, u]

    with *u* cohesion, separation and alignment, (3.16) to (3.18) of the thesis with exponent 1,
    among the neighbours. The loss is that of Champion et al.,

    .. math:: \lVert x - \psi(z) \rVert^2
        + \lambda_1 \lVert \dot x - \nabla\psi(z)\, \Theta \Xi \rVert^2
        + \lambda_2 \lVert \nabla\varphi(x)\, \dot x - \Theta \Xi \rVert^2
        + \lambda_3 \lVert \Xi \rVert_1

    with the difference to the next frame for :math:`\dot x`. A forecast adds the decoded velocity
    of the newest frame, :math:`\nabla\psi(z)\, \Theta \Xi`, to the last velocity, and moves the
    position by the new one. Coefficients below the threshold are dropped for good from time to
    time, and in the last quarter the rest is refined without the penalty; with a validation part
    the weights with the best rollouts there are kept from that quarter.

    The Lorenz example of the original has 3 latent coordinates, sigmoids in layers of 64 and 32,
    third-order polynomials, :math:`\lambda_1 = 10^{-4}, \lambda_2 = 0, \lambda_3 = 10^{-5}`,
    threshold 0.1 every 500 of 5,000 epochs, 1,000 more to refine, Adam with rate 0.001 and batches
    of 1,024. Here there are 3 latent coordinates for each dimension of space, and both *x* and
    :math:`\dot x` are brought to unit variance, so that :math:`\lambda_1 = 1`; :math:`\lambda_2 =
    10^{-2}`, :math:`\lambda_3 = 10^{-5}`, the threshold is 0.02, and the rate begins at 0.01 and
    falls as a cosine. States before an individual was first seen are filled by
    :func:`~swarmssm.baselines.gaps.fill_gaps`.

    Attributes
    ----------
    steps
        Of the optimiser, where the training has no time limit.
    """

    name: ClassVar[str] = "sindy-autoencoder"
    title: ClassVar[str] = "SINDy autoencoder"
    paper: ClassVar[str] = "Champion, Lusch, Kutz and Brunton 2019, doi:10.1073/pnas.1906995116"
    is_random: ClassVar[bool] = True
    order: int = 5
    steps: ClassVar[int] = 4000
    batch: ClassVar[int] = 1024
    widths: ClassVar[tuple[int, ...]] = (64, 32)
    latent_per_dimension: ClassVar[int] = 3
    learning_rate: ClassVar[float] = 1e-2
    decoded_weight: ClassVar[float] = 1.0
    encoded_weight: ClassVar[float] = 1e-2
    sparsity_weight: ClassVar[float] = 1e-5
    threshold: ClassVar[float] = 0.02

    def __init__(self) -> None:
        super().__init__()
        self.network: SparseAutoencoder | None = None
        self.graph: GraphRule | None = None
        self.scaler: Scaler | None = None
        self.control_spread = self.velocity_spread = np.empty(0)

    @property
    def num_parameters(self) -> int:
        """Weights of encoder and decoder, and coefficients that are not 0."""
        if self.network is None:
            return 0
        parts = (self.network.encoder, self.network.decoder)
        weights = sum(weight.numel() for part in parts for weight in part.parameters())
        return weights + int(self.network.active.sum())

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Train by minibatches, over the time that the training allows."""
        self.graph = training.graph
        self.scaler = fit_scaler(states[known(states)], "isotropic")
        observed, controls, velocity = self._examples(states, fps)
        size = Sizes(
            observed.shape[-1],
            self.latent_per_dimension * (states.shape[-1] // 2),
            controls.shape[-1],
            self.widths,
        )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.network = SparseAutoencoder(size)
        data = [torch.from_numpy(part).float() for part in (observed, controls, velocity)]
        self._train(self.network, data, fps, training)

    def step(self, window: Array, fps: float) -> Array:
        """Return the last state, its velocity changed by what was decoded."""
        if self.network is None:
            raise InputError(f"{self.name}: fit it first; it has learned nothing yet.")
        last = window[..., -1, :, :]
        present = known(last)
        observed, controls = self._inputs(window, fps)
        observed, controls = observed[present], controls[present]
        size = observed.shape[-1] // self.order
        found = np.empty((len(observed), size))
        for start in range(0, len(observed), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            rows = [torch.from_numpy(rows[part]).float() for rows in (observed, controls)]
            with torch.no_grad():
                found[part] = self.network(*rows)[:, -size:].double().numpy()
        # Only the change of velocity is used: the position moves by the new velocity.
        change = (found * self._pace)[:, size // 2 :]
        change = change * np.asarray(self._scaler().scale)[size // 2 :]
        position, velocity = np.split(last[present], 2, axis=-1)
        velocity = velocity + change
        following = np.full_like(last, np.nan)
        following[present] = np.concatenate([position + velocity / fps, velocity], axis=-1)
        return following

    @property
    def _pace(self) -> float:
        """Typical change of a scaled observed number in one frame."""
        return float(np.sqrt((self.velocity_spread**2).mean()))

    def _scaler(self) -> Scaler:
        """Return the scaler."""
        if self.scaler is None:
            raise InputError(f"{self.name}: fit it first; it has learned nothing yet.")
        return self.scaler

    def _inputs(self, window: Array, fps: float) -> tuple[Array, Array]:
        """Return what encoder and library see, ``(..., individual, feature)``."""
        filled = np.moveaxis(self._scaler().transform(fill_gaps(window, fps)), -3, -2)
        # A path that leaves all bounds is held where the network still answers to it.
        observed = np.clip(filled, -FARTHEST, FARTHEST).reshape(*filled.shape[:-2], -1)
        social = social_terms(window[..., -1, :, :], self.graph)
        spread = self.control_spread if len(self.control_spread) else np.ones(social.shape[-1])
        return observed, np.clip(social / spread, -FARTHEST, FARTHEST)

    def _examples(self, states: Array, fps: float) -> tuple[Array, Array, Array]:
        """Return inputs and scaled velocities of them, ``(row, feature)``, and set the scales."""
        before = np.full((len(states), self.order - 1, *states.shape[2:]), np.nan)
        padded = np.concatenate([before, states], axis=1)
        windows = np.lib.stride_tricks.sliding_window_view(padded, self.order + 1, axis=1)
        windows = np.moveaxis(windows, -1, -3)
        usable = known(windows[..., -1, :, :]) & known(windows[..., -2, :, :])
        self.control_spread = np.empty(0)
        observed, controls = self._inputs(windows[..., :-1, :, :], fps)
        following = np.moveaxis(self._scaler().transform(fill_gaps(windows, fps)), -3, -2)
        change = (following[..., 1:, :] - following[..., :-1, :])[usable]
        observed, controls = observed[usable], controls[usable]
        change = change.reshape(len(change), -1)
        self.control_spread = _spread(controls)
        self.velocity_spread = _spread(change)
        return observed, controls / self.control_spread, change / self.velocity_spread

    def _train(
        self, network: SparseAutoencoder, data: list[Tensor], fps: float, training: Training
    ) -> None:
        """Minimise the loss, dropping coefficients on the way."""
        random = torch.Generator().manual_seed(training.seed)
        optimiser = torch.optim.Adam(network.parameters(), lr=self.learning_rate)
        thresholds, judgements = (
            list(THRESHOLDED_AT),
            list(np.linspace(REFINED_FROM, 1.0, JUDGED + 1)[1:]),
        )
        best, kept = math.inf, None
        for count in itertools.count(1):
            picked = torch.randint(len(data[0]), (self.batch,), generator=random)
            done = training.progress if training.seconds is not None else count / self.steps
            for group in optimiser.param_groups:
                group["lr"] = self.learning_rate * (0.51 + 0.49 * math.cos(math.pi * done))
            loss = self._loss(network, [part[picked] for part in data], done < REFINED_FROM)
            optimiser.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            while thresholds and done >= thresholds[0]:
                thresholds.pop(0)
                large = network.coefficients.detach().abs() >= self.threshold
                network.active.mul_(large)
            due = False
            while judgements and done >= judgements[0]:
                judgements.pop(0)
                due = True
            if due and training.validation is not None:
                score = rollout_error(self, training.validation[:JUDGED_TRIALS], fps, self.order)
                if score < best:
                    best, kept = score, copy.deepcopy(network.state_dict())
            if done >= 1.0:
                break
        if kept is not None:
            network.load_state_dict(kept)

    def _loss(self, network: SparseAutoencoder, data: list[Tensor], sparse: bool) -> Tensor:
        """Return the loss of Champion et al. on a batch."""
        observed, controls, velocity = data
        # Time is counted so that what is observed changes by about 1: so do latent coordinates.
        relative = torch.from_numpy(self.velocity_spread / self._pace).float()
        latent, encoded = network.encoder(observed, velocity * relative)
        law = network.velocity(latent, controls)
        again, decoded = network.decoder(latent, law)
        loss = (observed - again).square().mean()
        loss = loss + self.decoded_weight * (velocity - decoded / relative).square().mean()
        loss = loss + self.encoded_weight * (encoded - law).square().mean()
        if sparse:
            loss = loss + self.sparsity_weight * (network.active * network.coefficients).abs().sum()
        whole: Tensor = loss
        return whole


def _spread(rows: Array) -> Array:
    """Return the root mean square of each column, 1 where there is none."""
    size = np.sqrt((rows**2).mean(axis=0))
    return np.asarray(np.where(size > 0.0, size, 1.0))
