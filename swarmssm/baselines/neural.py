"""What the neural baselines share: how they are trained, run over a history, and rolled out."""

import copy
import itertools
import math
import time
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.baselines.step_network import Memory, Setting, StepNetwork
from swarmssm.baselines.windows import (
    Trials,
    Windows,
    carried_forward,
    graphs_of,
    standardiser,
)
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array
from swarmssm.tracks.scaling import Scaler

__all__ = ["Memory", "NeuralBaseline", "Setting", "StepNetwork"]

Numbers = npt.NDArray[np.int64]

#: Scaled states are kept within so many standard deviations, so that no path becomes infinite.
FARTHEST = 100.0
#: Individuals of all frames, or pairs of them, that are looked at together when nothing is learned.
ROWS_AT_ONCE = 100_000
PAIRS_AT_ONCE = 200_000
#: Windows of the validation part by which the best weights are chosen, individuals and pairs in all
#: of them, and how far they go.
JUDGED_WINDOWS = 256
JUDGED_ROWS = 5_000
JUDGED_PAIRS = 50_000
JUDGED_STEPS = 20


class NeuralBaseline(Baseline):
    r"""A baseline whose next state comes from a network.

    A subclass writes :meth:`build`. States are standardised by the training part. Gaps are filled
    at constant velocity for the memory's sake, up to :attr:`order` frames; what was filled is
    neither scored nor seen by others.

    Windows of ``order + ahead`` frames are drawn at random. Over the first ``order`` frames the
    network is given the truth and predicts each next frame; from then on it goes on by itself. With
    :math:`e_k` the error k steps ahead of the last known frame and :math:`s_k` the root mean square
    of what a feature changes by in k frames, the loss is

    .. math:: \overline{(e_1 / s_1)^2} + \overline{(e_k / s_k)^2}_{k = 2 .. ahead}

    with the first mean over all known frames. Adam, with gradients clipped; the learning rate rises
    over the first twentieth and then falls as a cosine to 0 over the processor time that the
    training allows, or else over :attr:`epochs`. With a validation part those weights are kept
    whose rollouts over 20 steps have the least error there, in the same units. With ``seconds`` the
    number of steps, and so the result, depends on the machine; with epochs it follows the seed.

    Attributes
    ----------
    order
        Frames of the history that are looked at, at most.
    ahead
        Steps that a window goes on by itself while training.
    epochs
        Passes over as many windows as the training part holds side by side.
    learning_rate, clip
        Of Adam; greatest norm of the gradient.
    rows, pairs
        Greatest number of individuals, and of pairs of them, in the windows of one batch.
    pairwise
        Whether work and memory grow with the pairs rather than with the individuals.
    everybody
        Whether the method lets everybody see everybody, whatever the graph of the training says.
    network, scaler, graph
        What was learned, with what it needs; ``None`` before :meth:`fit`, except that the graph may
        stay so: then everybody sees everybody.
    """

    is_random: ClassVar[bool] = True
    order: int = 20
    ahead: ClassVar[int] = 6
    epochs: ClassVar[int] = 100
    learning_rate: ClassVar[float] = 3e-3
    clip: ClassVar[float] = 1.0
    rows: ClassVar[int] = 80
    pairs: ClassVar[int] = 800
    pairwise: ClassVar[bool] = False
    everybody: ClassVar[bool] = False

    def __init__(self) -> None:
        super().__init__()
        #: Share of the training that is behind, for losses that change on the way.
        self.done = 0.0
        self.network: StepNetwork | None = None
        self.scaler: Scaler | None = None
        self.graph: GraphRule | None = None

    def build(self, setting: Setting) -> StepNetwork:
        """Return the network with random weights, drawn from torch's own generator."""
        raise TypeError(f"{type(self).__name__} must define build(setting)")

    @property
    def num_parameters(self) -> int:
        """How many weights the network has."""
        if self.network is None:
            return 0
        return sum(weight.numel() for weight in self.network.parameters() if weight.requires_grad)

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Train the network on states ``(trial, time, individual, state)``."""
        self.graph = None if self.everybody else training.graph
        self.scaler = standardiser(states)
        trials = self._trials(states, fps, self.ahead)
        typical = _typical_changes(trials, max(self.ahead, JUDGED_STEPS))
        setting = Setting(states.shape[-1], typical[0], self.scaler, fps)
        # What never changes is scored in standard deviations, and a residual leaves it alone.
        typical = torch.where(typical > 1e-6, typical, 1.0)
        held = (
            None
            if training.validation is None
            else self._trials(training.validation, fps, JUDGED_STEPS)
        )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.network = self.build(setting)
            self._train(self.network, trials, held, typical, training)

    def loss(self, network: StepNetwork, windows: Windows, typical: Tensor) -> Tensor:
        """Return the loss of windows of ``order + ahead`` frames.

        Parameters
        ----------
        network
            Being trained.
        windows
            A batch.
        typical
            Root mean square change of each scaled feature over 1, 2, ... frames: ``(k, state)``.
        """
        past = windows.first(self.order)
        expected, memory = network.run(past.states, past.seen, past.graph)
        truth, here = windows.states[:, 1 : self.order + 1], windows.known[:, 1 : self.order + 1]
        loss = masked_square((truth - expected) / typical[0], here & past.known)
        there = past.known[:, -1]
        states, ahead = expected[:, -1], []
        for k in range(1, self.ahead):
            frame = self.order - 1 + k
            states, memory = network.step(states, there, windows.graph[:, frame], memory)
            error = (windows.states[:, frame + 1] - states) / typical[k]
            ahead.append(masked_square(error, windows.known[:, frame + 1] & there))
        return loss + torch.stack(ahead).mean() if ahead else loss

    def one_step(self, states: Array, fps: float) -> Array:
        """Predict each frame from the :attr:`order` frames before it, or half as many at least.

        Parameters
        ----------
        states
            Shape ``(..., time, individual, state)``.
        fps
            Frames per second.

        Returns
        -------
        Same shape; NaN in the first frame, and where the frame before is unknown.
        """
        network, scaler = self._learned()
        frames, individuals, features = states.shape[-3:]
        rows = states.reshape(-1, frames, individuals, features)
        predicted = np.full(rows.shape, np.nan)
        # Blocks of frames beside each other instead of one long loop: each is warmed up anew, and
        # no memory becomes older than in training.
        block = (self.order + 1) // 2
        warm = self.order - block
        count = -(-(frames - 1) // block) if frames > 1 else 0
        outside = ((0, 0), (warm, count * block - (frames - 1)), (0, 0), (0, 0))
        padded = np.pad(rows[:, : max(frames - 1, 0)], outside, constant_values=np.nan)
        for some in _portions(np.arange(len(rows) * count), self._at_once(individuals, self.order)):
            row, first = some[:, None] // count, some[:, None] % count * block
            window = padded[row, first + np.arange(self.order)]
            past = self._windows(window, fps)
            with torch.no_grad():
                expected, _ = network.run(past.states, past.seen, past.graph)
            found = scaler.inverse(expected[:, warm:].double().numpy())
            found[~known(window[:, warm:])] = np.nan
            target = first + 1 + np.arange(block)
            inside = target < frames
            predicted[np.broadcast_to(row, target.shape)[inside], target[inside]] = found[inside]
        return predicted.reshape(states.shape)

    def predict(
        self,
        states: Array,
        horizon: int,
        fps: float,
        generator: np.random.Generator | None = None,
    ) -> Array:
        """Go on from the last frame, as :meth:`Baseline.predict` does.

        The network runs over the last :attr:`order` frames once and then over its own steps; the
        graph is made anew from the forecast positions at each step. Drawn errors are fed back.
        """
        if horizon < 1:
            raise InputError(f"horizon: it must be at least 1, and it is {horizon}.")
        network, scaler = self._learned()
        noise = None
        if generator is not None:
            noise = _drawing(self._noise_root() / np.asarray(scaler.scale)[:, None], generator)
        # Draws come as one history repeated: it is looked at once.
        again = states.shape[0] if states.ndim > 3 and states.strides[0] == 0 else 1
        once = states[0] if again > 1 else states
        rows = once.reshape(-1, *states.shape[-3:])[:, -self.order :]
        path = np.empty((again, len(rows), horizon, *states.shape[-2:]))
        limit = self._at_once(states.shape[-2], self.order)
        for some in _portions(np.arange(len(rows)), limit):
            past = self._windows(rows[some], fps)
            there = past.known[:, -1]
            with torch.no_grad():
                following, memory = network.remember(past.states, past.seen, past.graph)
                for copies in _portions(np.arange(again), max(1, limit // len(some))):
                    many = {k: _repeated(part, len(copies)) for k, part in memory.items()}
                    mask = _repeated(there, len(copies))
                    steps = self._steps(_repeated(following, len(copies)), mask, many, noise)
                    scaled = torch.stack(list(itertools.islice(steps, horizon)), dim=1).double()
                    found = scaler.inverse(scaled.numpy())
                    found[~np.broadcast_to(mask.numpy()[:, None], found.shape[:-1])] = np.nan
                    path[np.ix_(copies, some)] = found.reshape(
                        len(copies), len(some), *found.shape[1:]
                    )
        return path.reshape(*states.shape[:-3], horizon, *states.shape[-2:])

    def _steps(
        self,
        expected: Tensor,
        mask: Tensor,
        memory: Memory,
        noise: Callable[[Tensor], Tensor] | None = None,
    ) -> Iterator[Tensor]:
        """Go on by itself from the first expected state; yield scaled states without end."""
        network, scaler = self._learned()
        while True:
            states = expected if noise is None else expected + noise(expected)
            states = (states * mask[..., None]).clamp(-FARTHEST, FARTHEST)
            yield states
            graph = graphs_of(scaler.inverse_tensor(states), mask, self.graph).float()
            expected, memory = network.step(states, mask, graph, memory)

    def _train(
        self,
        network: StepNetwork,
        trials: Trials,
        held: Trials | None,
        typical: Tensor,
        training: Training,
    ) -> None:
        individuals = trials.states.shape[-2]
        size = self._batch(individuals, self.rows, self.pairs)
        frames = self.order + self.ahead
        batches = max(1, math.ceil(len(trials.origins) / (frames * size)))
        random = torch.Generator().manual_seed(training.seed)
        optimiser = torch.optim.Adam(network.parameters(), lr=self.learning_rate)
        judge = None if held is None or not len(held.origins) else self._judge(held, typical)
        best, kept = math.inf, None
        cost = looked = 0.0
        for count in itertools.count():
            done = count / (self.epochs * batches)
            if training.seconds is not None:
                done = training.progress
            self.done = done
            ends = done >= 1.0 and count > 0
            due = count % batches == 0 and count > 0
            if training.seconds is not None:
                # Judging takes a tenth of the time at most.
                due = count > 0 and training.spent - looked >= max(9 * cost, training.seconds / 40)
            if judge is not None and (due or ends):
                began = time.process_time()
                score = judge(network)
                if score < best:
                    best, kept = score, copy.deepcopy(network.state_dict())
                cost, looked = time.process_time() - began, training.spent
            if ends:
                break
            for group in optimiser.param_groups:
                group["lr"] = self.learning_rate * schedule(done)
            picked = torch.randint(len(trials.origins), (size,), generator=random)
            loss = self.loss(network, trials.windows(trials.origins[picked]), typical)
            optimiser.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            norm = nn.utils.clip_grad_norm_(network.parameters(), self.clip)
            if torch.isfinite(norm):
                optimiser.step()
        if kept is not None:
            network.load_state_dict(kept)
        network.eval()

    def _judge(self, held: Trials, typical: Tensor) -> Callable[[StepNetwork], float]:
        """Return the function that scores a network by its rollouts."""
        individuals = held.states.shape[-2]
        most = min(JUDGED_WINDOWS, self._batch(individuals, JUDGED_ROWS, JUDGED_PAIRS))
        places = np.linspace(0, len(held.origins) - 1, min(most, len(held.origins)))
        limit = self._at_once(individuals, self.order)
        origins = held.origins[torch.from_numpy(np.unique(places.astype(np.int64)))]
        parts = [held.windows(some) for some in torch.split(origins, limit)]

        def score(network: StepNetwork) -> float:
            network.eval()
            squares = torch.zeros(JUDGED_STEPS)
            counts = torch.zeros(JUDGED_STEPS)
            with torch.no_grad():
                for windows in parts:
                    past = windows.first(self.order)
                    following, memory = network.remember(past.states, past.seen, past.graph)
                    there = past.known[:, -1]
                    steps = self._steps(following, there, memory)
                    for k, states in enumerate(itertools.islice(steps, JUDGED_STEPS)):
                        here = windows.known[:, self.order + k] & there
                        error = (windows.states[:, self.order + k] - states) / typical[k]
                        squares[k] += (error[here] ** 2).mean(-1).sum()
                        counts[k] += here.sum()
            network.train()
            value = float((squares[counts > 0] / counts[counts > 0]).mean())
            return value if math.isfinite(value) else math.inf

        return score

    def _trials(self, states: Array, fps: float, after: int) -> Trials:
        return Trials(states, fps, self._scaler(), self.graph, self.order, after)

    def _windows(self, states: Array, fps: float) -> Windows:
        """Return histories ``(window, time, individual, state)`` as the network takes them."""
        scaler = self._scaler()
        here = torch.from_numpy(known(states))
        filled, seen = carried_forward(states, fps, self.order)
        scaled = np.where(seen[..., None], scaler.transform(filled), 0.0)
        graph = graphs_of(torch.from_numpy(filled).float(), here, self.graph).float()
        return Windows(torch.from_numpy(scaled).float(), here, torch.from_numpy(seen), graph)

    def _at_once(self, individuals: int, frames: int = 1) -> int:
        """Return how many windows of so many frames are looked at together."""
        return self._batch(individuals, ROWS_AT_ONCE // frames, PAIRS_AT_ONCE // frames)

    def _batch(self, individuals: int, rows: int, pairs: int) -> int:
        """Return how many windows hold so many individuals, and pairs where those count."""
        most = rows // individuals
        if self.pairwise:
            most = min(most, pairs // individuals**2)
        return max(1, most)

    def _scaler(self) -> Scaler:
        if self.scaler is None:
            raise InputError(f"{self.name}: fit it first; before that it knows nothing.")
        return self.scaler

    def _learned(self) -> tuple[StepNetwork, Scaler]:
        if self.network is None:
            raise InputError(f"{self.name}: fit it first; before that it knows nothing.")
        return self.network, self._scaler()


def schedule(done: float) -> float:
    """Return the part of the learning rate at a share of the training between 0 and 1."""
    rise = min(1.0, 0.02 + done / 0.05)
    return rise * 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0)))


def masked_square(errors: Tensor, mask: Tensor) -> Tensor:
    """Return the mean square of errors ``(..., state)`` where the mask ``(...)`` is true."""
    square = torch.where(mask, (errors**2).mean(-1), 0.0)
    return square.sum() / mask.sum().clamp(min=1)


def _typical_changes(trials: Trials, most: int) -> Tensor:
    """Return the root mean square change over 1 to ``most`` frames, ``(most, state)``."""
    changes: list[Tensor] = []
    for k in range(1, most + 1):
        both = trials.known[:, k:] & trials.known[:, :-k]
        change = (trials.states[:, k:] - trials.states[:, :-k])[both]
        found = change.square().mean(0).sqrt() if len(change) else changes[-1]
        changes.append(found)
    return torch.stack(changes)


def _drawing(root: Array, generator: np.random.Generator) -> Callable[[Tensor], Tensor]:
    """Return what draws scaled errors for states of any shape."""

    def draw(states: Tensor) -> Tensor:
        return torch.from_numpy(generator.standard_normal(states.shape) @ root.T).float()

    return draw


def _repeated(part: Tensor, times: int) -> Tensor:
    """Return the batch several times over, one after the other."""
    return part.repeat(times, *(1,) * (part.dim() - 1)) if times > 1 else part


def _portions(rows: Numbers, size: int) -> Iterator[Numbers]:
    """Return the rows in portions."""
    return (rows[start : start + size] for start in range(0, len(rows), size))
