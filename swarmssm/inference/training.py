"""The training loop: mini-batches of windows, validation, checkpoints."""

import contextlib
import itertools
import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyro
import torch

from swarmssm.errors import InputError, WorkError
from swarmssm.inference.agreement import evaluating
from swarmssm.inference.bounds import Bound, annealing
from swarmssm.inference.checkpoints import Checkpoint, write_checkpoint
from swarmssm.inference.convergence import add_distances
from swarmssm.inference.guides import PathGuide, SwarmGuide
from swarmssm.inference.settings import FitSettings
from swarmssm.models import StateSpaceModel, SwarmBatch, SwarmModel

__all__ = ["TrainingData", "TrainingProgress", "num_epochs", "quiet_pyro", "train"]

#: A loss this many times the first one's size (at least one nat) has exploded.
EXPLODED = 1000.0
HISTORY_ROWS = 100
#: Steps in a pass over all windows, where mini-batches are left to us.
AUTO_STEPS = 10


@dataclass(frozen=True)
class TrainingProgress:
    """What a callback is told after each epoch.

    Attributes
    ----------
    epoch, num_epochs, step
        Counted from 1; ``num_epochs`` is ``None`` where nobody knows how many it takes.
    loss
        Negative ELBO per observed coordinate, in nats, averaged over the epoch's mini-batches.
    row
        The epoch's row of the history, if it has one.
    """

    epoch: int
    num_epochs: int | None
    step: int
    loss: float
    row: dict[str, float] | None = None


@dataclass(frozen=True)
class TrainingData:
    """Windows to learn from and windows to watch.

    Attributes
    ----------
    train, validation
        All windows of each part; there may be none to validate on.
    scores
        Called at each row of the history; returns named numbers to store beside the losses.
    """

    train: SwarmBatch
    validation: SwarmBatch | None
    scores: Callable[[], dict[str, float]] = field(default=dict)


def num_coordinates(windows: SwarmBatch, model: SwarmModel) -> int:
    """Return how many observed coordinates of the windows are scored."""
    if isinstance(model, StateSpaceModel) and not model.emission.is_exact:
        return int(windows.mask.sum()) * windows.observations.shape[-1]
    both_ends = windows.mask[:, 1:] & windows.mask[:, :-1]
    return int(both_ends.sum()) * windows.observations.shape[-1]


def batch_size(settings: FitSettings, num_windows: int) -> int:
    """Return the number of windows in a mini-batch."""
    if settings.batch_windows == "auto":
        return math.ceil(num_windows / AUTO_STEPS)
    return min(settings.batch_windows or num_windows, num_windows)


def steps_per_epoch(settings: FitSettings, num_windows: int) -> int:
    """Return the number of mini-batches in a pass over all windows."""
    return math.ceil(num_windows / batch_size(settings, num_windows))


def num_epochs(settings: FitSettings, model: SwarmModel, num_windows: int) -> int:
    """Return how many passes over the windows the settings ask for, the last one maybe partial."""
    if settings.steps is not None:
        return math.ceil(settings.steps / steps_per_epoch(settings, num_windows))
    return settings.epochs or model.default_epochs


def num_steps(settings: FitSettings, model: SwarmModel, num_windows: int) -> int:
    """Return how many steps of the optimiser the settings ask for."""
    if settings.steps is not None:
        return settings.steps
    return num_epochs(settings, model, num_windows) * steps_per_epoch(settings, num_windows)


@contextlib.contextmanager
def quiet_pyro() -> Iterator[None]:
    """Let Pyro keep parameters in the modules, and leave it to us to look for what is not a number.

    Its global switches are put back on leaving.
    """
    with (
        pyro.settings.context(module_local_params=True),
        pyro.validation_enabled(False),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", "Encountered", UserWarning)
        yield


def train(
    model: SwarmModel,
    guide: SwarmGuide,
    data: TrainingData,
    settings: FitSettings,
    *,
    start: Checkpoint | None = None,
    checkpoint_folder: Path | None = None,
    digest: str = "",
    callbacks: Sequence[Callable[[TrainingProgress], None]] = (),
) -> list[dict[str, float]]:
    """Maximise the ELBO with Adam; the model and the guide keep the best weights.

    The global random state of torch is used, and left where training left it: the caller forks
    it. A run continued from a checkpoint takes the very steps that an uninterrupted one takes.

    Parameters
    ----------
    model, guide
        Changed in place.
    data
        On the device of the model.
    settings
        How to train.
    start
        Where to go on.
    checkpoint_folder
        Where to write checkpoints; absent, none are written.
    digest
        Stored with each checkpoint, to tell whether it belongs to a fit.
    callbacks
        Called after each epoch.

    Returns
    -------
    The history: a row for about every hundredth part of the run, with ``epoch``, ``step``,
    ``loss``, ``validation_loss`` (NaN without validation part), ``gradient_norm``, ``seconds``,
    the scores of ``data``, and, if parameters have a posterior, ``distance``: how far they are from
    the end, in posterior standard deviations.

    Raises
    ------
    InputError
        If the checkpoint is of another network.
    WorkError
        If the loss is NaN or explodes: says at which step and what to try. Checkpoints are only
        written when all is well, so that the last good one is kept.
    """
    run = _Run(model, guide, data, settings, digest)
    if start is not None:
        try:
            run.restore(start)
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise InputError(
                f"{checkpoint_folder}: the checkpoint does not fit model and guide; has their code "
                "changed? Start anew (overwrite=True)."
            ) from error
    last_saved = run.step
    while not run.is_over():
        loss = run.one_epoch()
        finished = run.epoch == run.num_epochs
        row = run.record(loss) if finished or run.epoch % run.record_every == 0 else None
        for callback in callbacks:
            # Whoever watches may draw without changing what is drawn in training.
            with torch.random.fork_rng():
                callback(TrainingProgress(run.epoch, run.num_epochs, run.step, loss, row))
        due = run.step - last_saved >= settings.checkpoint_every
        if due or run.is_over():
            run.check_weights()
            if checkpoint_folder is not None:
                write_checkpoint(checkpoint_folder, run.checkpoint())
                last_saved = run.step
    _, sd = run._unconstrained()
    add_distances(run.history, run.places, sd)
    run.keep_best()
    return run.history


class _Run:
    """The moving parts of one training run."""

    def __init__(
        self,
        model: SwarmModel,
        guide: SwarmGuide,
        data: TrainingData,
        settings: FitSettings,
        digest: str,
    ) -> None:
        self.data, self.settings, self.digest = data, settings, digest
        self.modules: dict[str, torch.nn.Module] = {"model": model, "guide": guide}
        self.bound = Bound(model, guide, settings.draws)
        self.parameters = list(self.bound.parameters())
        self.optimizer = torch.optim.Adam(self.parameters, lr=settings.lr, fused=True)
        self.steps_per_epoch = steps_per_epoch(settings, len(data.train))
        self.num_epochs = num_epochs(settings, model, len(data.train))
        self.num_steps = num_steps(settings, model, len(data.train))
        self.record_every = settings.validate_every or math.ceil(self.num_epochs / HISTORY_ROWS)
        self.model = model
        self.coordinates = num_coordinates(data.train, model)
        self.epoch = self.step = 0
        self.seconds = 0.0
        self.first_loss = math.nan
        self.gradient_norm = math.nan
        self.history: list[dict[str, float]] = []
        self.places: list[torch.Tensor] = []
        self.best_loss = math.inf
        self.best: dict[str, torch.Tensor] = {}
        self.rows_since_best = 0

    def is_over(self) -> bool:
        """Return whether all epochs are done, or the validation loss has not fallen for too long.

        A run that was killed after its last checkpoint is over when it is continued.
        """
        patience = self.settings.patience
        stopped = patience is not None and bool(self.best) and self.rows_since_best >= patience
        return stopped or self.epoch >= self.num_epochs

    def one_epoch(self) -> float:
        """Step through all mini-batches; return the mean loss."""
        began = time.perf_counter()
        batches = itertools.islice(self._batches(self.epoch), self.num_steps - self.step)
        # One transfer an epoch: reading each loss would stall an accelerator at every step.
        steps = torch.stack([self._step(batch) for batch in batches])
        values, norms = steps.double().T.tolist()
        loss = float(sum(values)) / len(values)
        if math.isnan(self.first_loss):
            self.first_loss = values[0]
        for offset, (value, norm) in enumerate(zip(values, norms, strict=True)):
            step = self.step - len(values) + offset + 1
            if not value < EXPLODED * max(abs(self.first_loss), 1.0):
                what = "is not a number" if math.isnan(value) else f"exploded to {value:.3g}"
                self._give_up(step, f"the loss {what}")
            if not math.isfinite(norm):
                self._give_up(step, "the gradient is not finite")
        self.gradient_norm = norms[-1]
        self.epoch += 1
        self.seconds += time.perf_counter() - began
        return loss

    def _batches(self, epoch: int) -> Iterator[SwarmBatch]:
        """Yield the windows once, in an order that depends on seed and epoch only."""
        windows = self.data.train
        size = batch_size(self.settings, len(windows))
        if size >= len(windows):
            yield windows
            return
        order = torch.Generator().manual_seed((self.settings.seed * 1_000_003 + epoch) % 2**63)
        shuffled = torch.randperm(len(windows), generator=order)
        for part in torch.split(shuffled.to(windows.mask.device), size):
            yield windows.select(part)

    def _step(self, batch: SwarmBatch) -> torch.Tensor:
        """Take one step of Adam; return loss and norm of the gradient, not read yet."""
        if self.settings.schedule == "cosine":
            done = self.step / self.num_steps
            for group in self.optimizer.param_groups:
                group["lr"] = self.settings.lr * 0.5 * (1.0 + math.cos(math.pi * done))
        self.optimizer.zero_grad(set_to_none=True)
        batch = self.model.augmented(batch)
        weight = annealing(self.step, self.settings.anneal or 0)
        loss = self.bound(batch, weight) / self.coordinates
        loss.backward()
        clip = math.inf if self.settings.clip is None else self.settings.clip
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, clip)
        self.optimizer.step()
        self.step += 1
        return torch.stack([loss.detach(), norm.detach()])

    def check_weights(self) -> None:
        """Refuse weights that the last step has spoilt, which no loss has seen yet."""
        if not all(weight.isfinite().all() for weight in self.parameters):
            self._give_up(self.step, "a weight is no longer finite")

    def _give_up(self, step: int, what: str) -> None:
        """Say at which step the fit was lost, and what to try."""
        epoch = (step - 1) // self.steps_per_epoch + 1
        raise WorkError(
            f"training: {what} at step {step} (epoch {epoch}). Try a smaller "
            f"learning rate than {self.settings.lr:g}, a smaller clip, or another seed; the last "
            "good checkpoint, if there is one, is kept."
        )

    def record(self, loss: float) -> dict[str, float]:
        """Add a row to the history and remember the best weights."""
        began = time.perf_counter()
        row = {"epoch": float(self.epoch), "step": float(self.step), "loss": loss}
        with evaluating(*self.modules.values()):
            row["validation_loss"] = self._validate()
            row["gradient_norm"] = self.gradient_norm
            row.update(self.data.scores())
        self.seconds += time.perf_counter() - began
        row["seconds"] = self.seconds
        self.history.append(row)
        self.places.append(self._unconstrained()[0])
        if row["validation_loss"] < self.best_loss:
            self.best_loss, self.rows_since_best = row["validation_loss"], 0
            self.best = {name: value.clone() for name, value in self._weights().items()}
        else:
            self.rows_since_best += 1
        return row

    def _unconstrained(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and standard deviation of the parameters with a prior, if there are any."""
        guide = self.modules["guide"]
        if not isinstance(guide, PathGuide):
            return torch.empty(0), torch.empty(0)
        return guide.parameters_guide.unconstrained()

    def _validate(self) -> float:
        """Return the validation loss, with the same noise each time and no trace of it left."""
        windows = self.data.validation
        if windows is None:
            return math.nan
        with torch.random.fork_rng(), torch.no_grad():
            torch.manual_seed(self.settings.seed)
            return float(self.bound(windows) / num_coordinates(windows, self.model))

    def keep_best(self) -> None:
        """Give the modules the weights with the best validation loss, if there were any."""
        if self.best:
            self._load_weights(self.best)

    def _weights(self) -> dict[str, torch.Tensor]:
        """Return the weights of model and guide by name."""
        return {
            f"{part}.{name}": value.detach()
            for part, module in self.modules.items()
            for name, value in module.state_dict().items()
        }

    def _load_weights(self, weights: dict[str, torch.Tensor]) -> None:
        """Undo :meth:`_weights`."""
        for part, module in self.modules.items():
            start = f"{part}."
            own = {k.removeprefix(start): v for k, v in weights.items() if k.startswith(start)}
            module.load_state_dict(own)

    def checkpoint(self) -> Checkpoint:
        """Return everything that the next step depends on."""
        tensors = {f"weights.{name}": value for name, value in self._weights().items()}
        tensors |= {f"best.{name}": value for name, value in self.best.items()}
        for index, fields in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{index}.{name}": value for name, value in fields.items()}
        tensors["rng"] = torch.get_rng_state()
        tensors |= {f"places.{number}": place for number, place in enumerate(self.places)}
        state = {
            "digest": self.digest,
            "epoch": self.epoch,
            "step": self.step,
            "seconds": self.seconds,
            "first_loss": self.first_loss,
            "best_loss": self.best_loss,
            "rows_since_best": self.rows_since_best,
            "history": self.history,
        }
        return Checkpoint(tensors, state)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Undo :meth:`checkpoint`."""
        self._load_weights(checkpoint.group("weights"))
        self.best = checkpoint.group("best")
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in checkpoint.group("optimizer").items():
            index, _, moment = name.partition(".")
            moments.setdefault(int(index), {})[moment] = value
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": moments, "param_groups": groups})
        torch.set_rng_state(checkpoint.tensors["rng"])
        state = checkpoint.state
        self.epoch, self.step = int(state["epoch"]), int(state["step"])
        self.seconds, self.first_loss = float(state["seconds"]), float(state["first_loss"])
        self.best_loss = float(state["best_loss"])
        self.rows_since_best = int(state["rows_since_best"])
        self.history = [dict(row) for row in state["history"]]
        places = checkpoint.group("places")
        self.places = [places[str(number)] for number in range(len(self.history))]
