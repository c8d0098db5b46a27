"""Fit a model and a guide to tracks."""

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import xarray as xr

from swarmssm import metrics
from swarmssm.errors import InputError, WorkError
from swarmssm.graphs.representation import represent
from swarmssm.inference.agreement import check_agreement
from swarmssm.inference.checkpoints import Checkpoint, read_checkpoint
from swarmssm.inference.collapsed_fit import fit_collapsed
from swarmssm.inference.data import Prepared, preparation_for, prepare, rule_for, windows_of
from swarmssm.inference.fitted import Fit
from swarmssm.inference.guides import LinearizedGuide, OneStepGuide, SwarmGuide
from swarmssm.inference.run_folder import (
    CHECKPOINT,
    Builders,
    Run,
    build_modules,
    check_names,
    check_run_output,
    finish_run,
    provenance_now,
    real_folder,
    replace_folder,
    write_config,
)
from swarmssm.inference.settings import FitSettings, settings_from
from swarmssm.inference.training import (
    TrainingData,
    TrainingProgress,
    batch_size,
    num_steps,
    quiet_pyro,
    train,
)
from swarmssm.io import Recordings, as_tracks
from swarmssm.models import (
    OneStepModel,
    Scales,
    StateSpaceModel,
    SwarmBatch,
    SwarmModel,
    scales_of,
)
from swarmssm.tracks.splits import Split, split, take

__all__ = ["fit"]

#: Settings that may change between an interrupted fit and its continuation.
FREE_ON_RESUME = {"device", "checkpoint_every"}


def fit(
    model: str | Callable[..., Any] = "boids",
    tracks: Recordings | None = None,
    *,
    guide: str | Callable[..., Any] = "auto",
    fps: float | None = None,
    unit: str | None = None,
    source: str | Path = "",
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    callbacks: Sequence[Callable[[TrainingProgress], None]] = (),
    **settings: Any,
) -> Fit:
    """Fit a model to tracks by stochastic variational inference.

    The tracks are split first; velocities, scaling and graph are then decided on the training
    part alone. The ELBO of mini-batches of windows is maximised with Adam, and the weights with
    the best ELBO on the validation part are kept.

    Parameters
    ----------
    model
        Registered name (:data:`swarmssm.models.MODELS`), ``module:attribute``, or the
        constructor itself: a callable from :class:`swarmssm.models.Scales` and options to a model.
    tracks
        Tracks; or a file, a DataFrame or an array ``(time, individual, space)`` from which
        :func:`swarmssm.io.as_tracks` makes them; or several of these in a list or a dictionary,
        which are pooled: each is a trial or more.
    guide
        Likewise (:data:`swarmssm.inference.GUIDES`): a callable from the model and options to a
        guide. ``"auto"`` is the model's default.
    fps, unit
        Frames per second and unit of length, where arrays or tables do not tell them.
    source
        File that the tracks were read from, noted in the provenance.
    out
        Run folder to write. With it, checkpoints are written during training, and a fit that was
        interrupted can be continued.
    resume
        Go on from the checkpoint in ``out`` if there is one. On one thread the weights are bit
        for bit those of an uninterrupted fit.
    overwrite
        Replace a run folder that is there; it stays as it was until the new one is finished.
    callbacks
        Called with a :class:`swarmssm.inference.training.TrainingProgress` after each epoch.
    **settings
        Any of :class:`swarmssm.inference.settings.FitSettings`: ``steps``, ``epochs``, ``window``,
        ``batch_windows``, ``lr``, ``seed``, ``device``, ``graph`` and so on.

    Returns
    -------
    The fit. Its draws, and global random states, do not depend on what ran before.

    Raises
    ------
    InputError
        If tracks, a setting or ``out`` is wrong.
    WorkError
        If the loss is NaN or explodes, or nothing can be written.
    """
    if tracks is None:
        raise InputError('tracks: none are given. Name the model first: fit("boids", tracks).')
    if not source and isinstance(tracks, str | Path):
        source = tracks
    tracks = as_tracks(tracks, fps=fps, unit=unit)
    builders = Builders(*(None if isinstance(part, str) else part for part in (model, guide)))
    names = {"model": _name(model), "guide": _name(guide)}
    wanted = settings_from({**names, **settings})
    device = _device(wanted.device)
    folder = None if out is None else Path(out)
    if folder is not None:
        check_names(wanted)
        check_run_output(folder, overwrite=overwrite or resume)
        folder = real_folder(folder)
    parts = split(tracks, wanted.split_by, wanted.fractions, wanted.gap)
    training = take(tracks, parts.train)
    scales = scales_of(training, rule_for(training, wanted.graph))
    with torch.random.fork_rng():
        torch.manual_seed(wanted.seed)
        wanted, own_model, own_guide = build_modules(wanted, scales, builders)
        run = _prepared_run(own_model, own_guide, wanted, training, scales, parts)
        prepared = prepare(training, run.preparation)
        windows, validation = _windows(run, prepared, tracks)
        for module in (run.model, run.guide):
            module.to(device)
        data = TrainingData(
            windows.to(device),
            None if validation is None else validation.to(device),
            _scores(run, prepared),
        )
        is_collapsed = isinstance(run.guide, LinearizedGuide)
        with quiet_pyro():
            check_agreement(run.model, run.guide, data.train, scored=not is_collapsed)
        digest = _digest(run, tracks)
        working, start = _working_folder(folder, resume, overwrite, digest, run)
        try:
            if is_collapsed:
                history = _sum_out(run, data, callbacks)
            else:
                with quiet_pyro():
                    history = train(
                        run.model,
                        run.guide,
                        data,
                        wanted,
                        start=start,
                        checkpoint_folder=None if working is None else working / CHECKPOINT,
                        digest=digest,
                        callbacks=callbacks,
                    )
        except WorkError:
            if working is not None and not any((working / CHECKPOINT).iterdir()):
                shutil.rmtree(working)
            raise
    for module in (run.model, run.guide):
        module.to("cpu").eval()
    facts = {
        "file": str(Path(source).resolve()) if source else "",
        "source_file": str(tracks.attrs.get("source_file", "")),
        "sha256": tracks_digest(tracks),
        "unit": str(tracks.attrs.get("unit", "")),
        "fps": float(tracks.attrs["fps"]),
        "trials": int(tracks.sizes.get("trial", 1)),
        "individuals": int(tracks.sizes["individual"]),
        "frames": int(tracks.sizes["time"]),
    }
    done = replace(run, history=pd.DataFrame(history), provenance=provenance_now(facts))
    if folder is not None and working is not None:
        finish_run(done, working)
        shutil.rmtree(working / CHECKPOINT, ignore_errors=True)
        if working != folder:
            replace_folder(working, folder)
    return Fit(**vars(done))


def tracks_digest(tracks: xr.Dataset) -> str:
    """Return a SHA-256 of the observations: positions, velocities, adjacency and labels."""
    digest = hashlib.sha256()
    for name in ("position", "velocity", "adjacency"):
        if name in tracks:
            values = np.ascontiguousarray(tracks[name].to_numpy())
            digest.update(f"{name}{values.shape}{values.dtype}".encode())
            digest.update(values.tobytes())
    digest.update(json.dumps([str(v) for v in tracks["individual"].values]).encode())
    digest.update(np.float64(tracks.attrs["fps"]).tobytes())
    return digest.hexdigest()


def _digest(run: Run, tracks: xr.Dataset) -> str:
    """Return what must be equal for a checkpoint to be continued: settings and data."""
    settings = run.settings.model_dump(mode="json", exclude=FREE_ON_RESUME)
    # An attribute of the tracks, such as a body length, may change the rule.
    rule = None if run.preparation.rule is None else run.preparation.rule.to_dict()
    facts = {"settings": settings, "data": tracks_digest(tracks), "rule": rule}
    return json.dumps(facts, sort_keys=True)


def _name(part: Any) -> Any:
    """Return the name by which a run folder can find a part again; what is no part, as it is."""
    if not callable(part):
        return part
    return f"{part.__module__}:{getattr(part, '__qualname__', type(part).__qualname__)}"


def _prepared_run(
    model: SwarmModel,
    guide: SwarmGuide,
    settings: FitSettings,
    training: xr.Dataset,
    scales: Scales,
    parts: Split,
) -> Run:
    """Decide how tracks are prepared; return a run that is not trained yet."""
    if isinstance(model, StateSpaceModel) and settings.scaler not in ("auto", "none"):
        raise InputError(
            f"scaler: {settings.model} is a state-space model and works in the tracks' own units; "
            "leave the scaler out, or choose none."
        )
    preparation, _ = preparation_for(
        training,
        scaler=model.scaler if settings.scaler == "auto" else settings.scaler,
        graph=settings.graph,
        velocity=settings.velocity,
        observes=model.observes,
    )
    return Run(model, guide, settings, scales, preparation, parts, pd.DataFrame())


def _windows(
    run: Run, prepared: Prepared, tracks: xr.Dataset
) -> tuple[SwarmBatch, SwarmBatch | None]:
    """Cut the training part and the validation part, if there is one, into windows."""
    model, window = run.model, run.settings.window
    assert window != "auto", "build_modules has asked the guide"
    share = not isinstance(model, StateSpaceModel) or model.emission.is_exact
    windows = _represented(windows_of(prepared, window, share_border=share), model)
    if not run.split.validation:
        return windows, None
    watched = prepare(take(tracks, run.split.validation), run.preparation)
    try:
        return windows, _represented(windows_of(watched, window, share_border=share), model)
    except InputError as error:
        raise InputError(
            "fractions: in the validation part nobody is seen in two consecutive frames, so that "
            "it can score nothing. Give it a larger share, or none."
        ) from error


def _represented(windows: SwarmBatch, model: SwarmModel) -> SwarmBatch:
    """Keep the graph of a large swarm as a list of edges."""
    if not isinstance(model, StateSpaceModel):
        return windows
    return replace(windows, adjacency=represent(windows.adjacency))


def _sum_out(
    run: Run, data: TrainingData, callbacks: Sequence[Callable[[TrainingProgress], None]]
) -> list[dict[str, float]]:
    """Fit the parameters with the latent states summed out; return the history.

    It takes a fraction of the time of a network and has no checkpoints: a fit that was interrupted
    begins anew, and ends where it would have.
    """
    assert isinstance(run.model, StateSpaceModel)
    assert isinstance(run.guide, LinearizedGuide)
    settings = run.settings
    size = batch_size(settings, len(data.train))

    # Laplace's method takes all windows in each step: a pass over them is one.
    by_laplace = run.guide.globals == "laplace"
    steps = settings.steps
    if settings.epochs is not None:
        steps = settings.epochs if by_laplace else num_steps(settings, run.model, len(data.train))
    elif not by_laplace:
        steps = steps or run.model.default_epochs

    def tell(step: int, total: int | None, loss: float) -> None:
        for callback in callbacks:
            callback(TrainingProgress(step, total, step, loss))

    return fit_collapsed(
        run.model,
        run.guide,
        data.train,
        validation=data.validation,
        steps=steps,
        batch_windows=size,
        lr=settings.lr,
        seed=settings.seed,
        callback=tell,
    )


def _scores(run: Run, prepared: Prepared) -> Callable[[], dict[str, float]]:
    """Return what scores predictions while a model is trained, where that is quickly told."""
    if isinstance(run.model, OneStepModel) and isinstance(run.guide, OneStepGuide):
        return _TrainingScores(prepared, run.model, run.guide)
    return dict


def _working_folder(
    folder: Path | None, resume: bool, overwrite: bool, digest: str, run: Run
) -> tuple[Path | None, Checkpoint | None]:
    """Return the folder to work in, and the checkpoint to start from.

    A folder that is to be overwritten stays as it is: its successor grows beside it.
    """
    if folder is None:
        if resume:
            raise InputError("resume: there is nothing to resume without out.")
        return None, None
    beside = folder.with_name(f".{folder.name}.new")
    working = beside if overwrite and folder.exists() else folder
    if not resume:
        shutil.rmtree(working, ignore_errors=True)
    elif (folder / "provenance.json").exists() and working == folder:
        hint = " Add overwrite=True to go on with the one that is to replace it."
        raise InputError(
            f"{folder}: this fit is finished; there is nothing to resume."
            + (hint if beside.exists() else "")
        )
    start = read_checkpoint(working / CHECKPOINT)
    if start is not None and start.state.get("digest") != digest:
        raise InputError(
            f"{working}: its checkpoint belongs to a fit with {_difference(start, digest)}. Resume "
            "with the same file and settings, or choose another folder."
        )
    if not working.exists() and not working.parent.is_dir():
        raise InputError(f"{folder}: the folder {folder.parent} does not exist. Make it first.")
    try:
        (working / CHECKPOINT).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WorkError(f"{working}: cannot be written ({error.strerror}).") from error
    write_config(run, working)
    return working, start


def _difference(start: Checkpoint, digest: str) -> str:
    """Say in what a checkpoint's fit differs from the one asked for."""
    try:
        old, new = json.loads(start.state["digest"]), json.loads(digest)
        names = [k for k, v in new["settings"].items() if old["settings"].get(k) != v]
    except (KeyError, TypeError, ValueError):
        return "other settings"
    return f"other settings ({', '.join(names)})" if names else "other tracks"


def _device(name: str) -> torch.device:
    """Return the device, ``"auto"`` being the first accelerator."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros((), device=device).item()
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device: {name!r} is not available; choose cpu.") from error
    return device


class _TrainingScores:
    """One-step errors on the training part at each row of the history (figs 4.9, 4.10)."""

    def __init__(self, prepared: Prepared, model: OneStepModel, guide: OneStepGuide) -> None:
        self.prepared, self.model, self.guide = prepared, model, guide
        self.truth = prepared.observations.masked_fill(~prepared.mask.unsqueeze(-1), torch.nan)

    def __call__(self) -> dict[str, float]:
        """Return MSE (4.2) and MAE (4.3) of scaled states, predicted at the posterior mean."""
        device = next(self.model.parameters()).device
        frames = self.prepared
        with torch.no_grad():
            posterior = self.guide.encode(
                frames.observations[:, :-1].to(device),
                frames.adjacency[:, :-1].to(device, torch.float32),
            )
            predicted = self.model.decode(posterior.mean).states.mean.cpu()
        predicted = predicted.masked_fill(~frames.mask[:, :-1].unsqueeze(-1), torch.nan)
        first = torch.full_like(self.truth[:, :1], torch.nan)
        whole = torch.cat([first, predicted], dim=1).numpy()
        truth = self.truth.numpy()
        return {"mse": metrics.mse(truth, whole), "mae": metrics.mae(truth, whole)}
