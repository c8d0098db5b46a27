"""Run folders: a fit on disk, in files that cannot run.

=====================  ===========================================================
``config.json``        resolved settings, preparation and split
``weights.safetensors``  weights of model and guide
``history.csv``        the course of training
``checkpoint/``        where training stood, while it runs
``provenance.json``    versions, data, and a digest of each of the files above
=====================  ===========================================================

``provenance.json`` is written last: a folder without it holds a fit that is not finished.
"""

import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy
import pandas as pd
import pyro
import torch
import xarray

import swarmssm
from swarmssm.errors import InputError, WorkError
from swarmssm.files import file_digest, write_beside
from swarmssm.graphs import GraphRule
from swarmssm.inference.checkpoints import read_tensors, write_tensors
from swarmssm.inference.data import Preparation
from swarmssm.inference.guides import GUIDES, SwarmGuide, default_guide, find_guide
from swarmssm.inference.settings import FitSettings, settings_from
from swarmssm.models import MODELS, Scales, SwarmModel, find_model
from swarmssm.models.presets import EDGES, with_edges
from swarmssm.tracks.scaling import Scaler
from swarmssm.tracks.splits import Split

__all__ = [
    "CHECKPOINT",
    "Builders",
    "Run",
    "build_modules",
    "check_names",
    "check_run_output",
    "finish_run",
    "load_run",
    "provenance_now",
    "real_folder",
    "replace_folder",
    "save_run",
    "write_config",
]

CONFIG, WEIGHTS, HISTORY = "config.json", "weights.safetensors", "history.csv"
PROVENANCE, CHECKPOINT = "provenance.json", "checkpoint"
#: Of what a run folder holds, and how its settings and parameters are called.
LAYOUT = 2


@dataclass(frozen=True)
class Run:
    """What a run folder holds.

    Attributes
    ----------
    model, guide
        Fitted modules.
    settings
        What they were fitted with.
    scales
        Typical sizes in the training part, with which the model was built.
    preparation
        Scaler, velocities and graph, as decided on the training part.
    split
        Which frames of the tracks trained, validated and test.
    history
        A row for about every hundredth part of the training run, see
        :func:`swarmssm.inference.training.train`.
    provenance
        Versions, time, and name and digest of the tracks.
    """

    model: SwarmModel
    guide: SwarmGuide
    settings: FitSettings
    scales: Scales
    preparation: Preparation
    split: Split
    history: pd.DataFrame
    provenance: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Builders:
    """Constructors of model and guide that were given as such, in place of those named.

    Attributes
    ----------
    model, guide
        Callables; absent, the settings' names are looked up.
    """

    model: Callable[..., Any] | None = None
    guide: Callable[..., Any] | None = None


def build_modules(
    settings: FitSettings, scales: Scales, builders: Builders | None = None
) -> tuple[FitSettings, SwarmModel, SwarmGuide]:
    """Build model and guide as the settings name them; return the settings with no "auto" in them.

    A model is built by a callable that takes scales and options, or by a class with a method
    ``for_scales`` of these; a guide likewise from the model (``for_model``).

    Raises
    ------
    InputError
        If a name is unknown or an option does not fit its constructor.
    """
    builders = Builders() if builders is None else builders
    # Parameters that stay in their module, instead of Pyro's global store, have to be so from
    # the module's construction on.
    with pyro.settings.context(module_local_params=True):
        builder = find_model(builders.model or settings.model)
        model = _build(builder, "model", settings.model, scales, settings.model_options)
        if not isinstance(model, SwarmModel):
            raise InputError(
                f"model: {settings.model} built a {type(model).__name__}, which is no SwarmModel. "
                "Derive it from OneStepModel, StateSpaceModel or SwarmModel of swarmssm.models."
            )
        # The type of the windows, whatever torch's default type is.
        model = model.to(torch.float32)
        if settings.priors:
            from swarmssm.models.priors import with_priors

            model = with_priors(model, settings.priors)
        model = _with_edges(model, settings, scales)
        if settings.guide == "auto":
            settings = settings.model_copy(update={"guide": default_guide(model)})
        builder = find_guide(builders.guide or settings.guide)
        guide = _build(builder, "guide", settings.guide, model, settings.guide_options)
    if settings.window == "auto":
        settings = settings.model_copy(update={"window": guide.window})
    return settings, model, guide.to(torch.float32)


def _with_edges(model: SwarmModel, settings: FitSettings, scales: Scales) -> SwarmModel:
    """Return the model with the edges that the settings name."""
    if settings.edges != "auto":
        options = settings.edge_options
        return with_edges(model, scales, settings.edges, settings.edge_types, options)
    if settings.edge_types is not None or settings.edge_options:
        raise InputError(
            f"edges: types and options are those of inferred edges; choose {' or '.join(EDGES)}."
        )
    return model


def _build(builder: Any, what: str, name: str, first: Any, options: Mapping[str, Any]) -> Any:
    """Call a constructor, and say in one sentence if its options are wrong."""
    try:
        built = builder(first, **options)
    except InputError:
        raise
    except Exception as error:  # the constructor may be the user's own
        reason = str(error).rstrip(".") or type(error).__name__
        raise InputError(
            f"{what}: {name} cannot be built with {dict(options)}: {reason}."
        ) from error
    if not isinstance(built, torch.nn.Module):
        raise InputError(f"{what}: {name} built no torch module, but {type(built).__name__}.")
    return built


def provenance_now(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return versions, time and the given facts of the data."""
    versions = {
        module.__name__: module.__version__ for module in (swarmssm, torch, pyro, numpy, xarray)
    }
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version(), **versions},
        "platform": platform.platform(),
        "data": dict(data),
    }


def save_run(run: Run, folder: Path, *, overwrite: bool = False) -> None:
    """Write a run folder beside and rename it.

    Raises
    ------
    InputError
        If the folder exists and ``overwrite`` is false, or it is something else than a run.
    WorkError
        If it cannot be written; what was there before is then unchanged.
    """
    check_names(run.settings)
    check_run_output(folder, overwrite=overwrite)
    folder = real_folder(folder)
    try:
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise WorkError(f"{folder}: cannot be written ({error.strerror}).") from error
    try:
        temporary.chmod(0o755)
        finish_run(run, temporary)
        replace_folder(temporary, folder)
    except OSError as error:
        raise WorkError(f"{folder}: could not be written ({error.strerror or error}).") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_names(settings: FitSettings) -> None:
    """Refuse to store a model or guide that no other process could find again.

    Raises
    ------
    InputError
        If one is a lambda, or is defined inside a function.
    """
    for what, name in (("model", settings.model), ("guide", settings.guide)):
        if "<" in name:
            raise InputError(
                f"{what}: a run folder stores its name, and {name.partition(':')[2]} cannot be "
                "imported by that. Define it at the top of a module, or write no run folder."
            )


def check_run_output(folder: Path, *, overwrite: bool) -> None:
    """Refuse a run folder that must not be written."""
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: the folder {folder.parent} does not exist. Make it first.")
    if not folder.exists():
        return
    if not overwrite:
        raise InputError(
            f"{folder}: exists already and was left as it is. Choose another name, add "
            "overwrite=True, or resume=True to go on with an interrupted fit."
        )
    if not _is_run(folder):
        raise InputError(
            f"{folder}: it is not a run folder, and is not overwritten. Choose another name."
        )


def real_folder(folder: Path) -> Path:
    """Return the folder itself where a link or dots stand for it, so that it can be replaced."""
    dots = folder.name in ("", "..")
    return folder.resolve() if dots or folder.is_symlink() else folder


def _is_run(folder: Path) -> bool:
    """Return whether a folder is empty or holds a fit, finished or not, and nothing else's config.

    Many programs write a ``config.json``: a folder is not given up for the name alone.
    """
    if not folder.is_dir():
        return False
    if not any(folder.iterdir()):
        return True
    try:
        config = read_json(folder / CONFIG)
    except InputError:
        return False
    return {"settings", "preparation", "split"} <= config.keys()


def replace_folder(source: Path, target: Path) -> None:
    """Put a finished folder in the place of another, which is removed only afterwards.

    Raises
    ------
    WorkError
        If the system refuses; the target is then as it was.
    """
    old = target.with_name(f".{target.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    try:
        if target.exists():
            target.rename(old)
        source.rename(target)
    except OSError as error:
        if old.exists() and not target.exists():
            old.rename(target)
        raise WorkError(f"{target}: cannot be replaced ({error.strerror}).") from error
    shutil.rmtree(old, ignore_errors=True)


def write_config(run: Run, folder: Path) -> None:
    """Write what decides the fit; it is there before training starts."""
    preparation = run.preparation
    config = {
        "layout": LAYOUT,
        "settings": run.settings.model_dump(mode="json"),
        "preparation": {
            "scaler": {
                "kind": preparation.scaler.kind,
                "offset": list(preparation.scaler.offset),
                "scale": list(preparation.scaler.scale),
            },
            "velocity": preparation.velocity,
            "rule": None if preparation.rule is None else preparation.rule.to_dict(),
            "own_graph": preparation.own_graph,
            "observes": preparation.observes,
        },
        "scales": run.scales.to_dict(),
        "split": run.split.to_dict(),
    }
    _write_json(folder / CONFIG, config)


def finish_run(run: Run, folder: Path) -> None:
    """Write all files of a finished fit into an existing folder, provenance last."""
    write_config(run, folder)
    weights = {f"model.{name}": value for name, value in run.model.state_dict().items()}
    weights |= {f"guide.{name}": value for name, value in run.guide.state_dict().items()}
    write_tensors(folder / WEIGHTS, weights)
    with write_beside(folder / HISTORY, overwrite=True) as temporary:
        run.history.to_csv(temporary, index=False)
    digests = {name: file_digest(folder / name) for name in (CONFIG, WEIGHTS, HISTORY)}
    _write_json(folder / PROVENANCE, {**run.provenance, "files": digests})


def load_run(folder: Path, *, trust_code: bool = False) -> Run:
    """Read a run folder.

    Parameters
    ----------
    folder
        As :func:`save_run` and ``swarmssm fit`` write it.
    trust_code
        Whether a model or guide named as ``module:attribute`` may be imported, which runs that
        module's code. The ready-made ones need no trust.

    Raises
    ------
    InputError
        If a file is missing, damaged or was altered, the fit is not finished, or code would have
        to be trusted.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such run folder.")
    if not (folder / PROVENANCE).is_file():
        if (folder / CHECKPOINT).is_dir():
            raise InputError(
                f"{folder}: this fit is not finished. Go on with the same fit and resume=True."
            )
        raise InputError(f"{folder}: it is not a run folder; {PROVENANCE} is missing.")
    provenance = read_json(folder / PROVENANCE)
    digests = provenance.get("files")
    for name in (CONFIG, WEIGHTS, HISTORY):
        path = folder / name
        if not path.is_file():
            raise InputError(
                f"{path}: this file of the run is missing. Fit again, or copy it back."
            )
        if not isinstance(digests, dict) or digests.get(name) != file_digest(path):
            raise InputError(
                f"{path}: it is not the file that the fit wrote ({PROVENANCE} tells another "
                "digest). Fit again, or copy it back."
            )
    config = read_json(folder / CONFIG)
    if config.get("layout", 1) != LAYOUT:
        raise InputError(
            f"{folder}: this run was written by another version of swarmssm (layout "
            f"{config.get('layout', 1)}, and this one reads {LAYOUT}). Fit again."
        )
    settings = settings_from(_table(config, "settings", folder), str(folder / CONFIG))
    for name, ready in ((settings.model, MODELS), (settings.guide, GUIDES)):
        if name not in ready and ":" in name and not trust_code:
            raise InputError(
                f"{folder}: the run names the code {name}, which loading it would execute. If you "
                "trust that code, say so (trust_code=True)."
            )
    try:
        preparation = _preparation(_table(config, "preparation", folder))
        scales = Scales.from_dict(_table(config, "scales", folder))
        _check_preparation(preparation, scales, folder)
        split = Split.from_dict(_table(config, "split", folder))
        # By way of text: pandas' own reading of numbers may miss the last digit.
        history = pd.read_csv(folder / HISTORY, dtype=str).astype(numpy.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder}: {CONFIG} or {HISTORY} cannot be understood ({error})."
        ) from error
    try:
        settings, model, guide = build_modules(settings, scales)
    except InputError as error:
        raise InputError(f"{folder / CONFIG}: {error}") from error
    weights, _ = read_tensors(folder / WEIGHTS)
    for part, module in (("model", model), ("guide", guide)):
        start = f"{part}."
        own = {k.removeprefix(start): v for k, v in weights.items() if k.startswith(start)}
        try:
            module.load_state_dict(own)
        except RuntimeError as error:
            raise InputError(
                f"{folder / WEIGHTS}: the weights do not fit the {part} {getattr(settings, part)}."
            ) from error
        module.eval()
    return Run(model, guide, settings, scales, preparation, split, history, provenance)


def _preparation(values: dict[str, Any]) -> Preparation:
    """Undo what :func:`write_config` did to a preparation."""
    scaler = values["scaler"]
    numbers = (tuple(float(x) for x in scaler[name]) for name in ("offset", "scale"))
    rule = values["rule"]
    return Preparation(
        Scaler(str(scaler["kind"]), *numbers),
        str(values["velocity"]),
        None if rule is None else GraphRule.from_dict(rule),
        bool(values["own_graph"]),
        str(values["observes"]),
    )


def _check_preparation(preparation: Preparation, scales: Scales, folder: Path) -> None:
    """Refuse a preparation that could not have been decided on tracks of these scales."""
    features = len(preparation.scaler.offset)
    if features != scales.state_dim:
        raise InputError(
            f"{folder / CONFIG}: the scaler has {features} features, and the states of the tracks "
            f"have {scales.state_dim}. Fit again, or copy the file back."
        )
    if preparation.observes not in ("positions", "states"):
        raise ValueError(f"observes is {preparation.observes!r}")


def _table(config: dict[str, Any], name: str, folder: Path) -> dict[str, Any]:
    """Return a table of the configuration."""
    value = config.get(name)
    if not isinstance(value, dict):
        raise InputError(f"{folder / CONFIG}: the table {name} is missing.")
    return value


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: it is not readable JSON ({error}).") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: it holds no JSON object.")
    return value


def _write_json(path: Path, value: Any) -> None:
    """Write JSON as a whole."""
    with write_beside(path, overwrite=True) as temporary:
        temporary.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")
