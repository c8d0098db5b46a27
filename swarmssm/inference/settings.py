"""Everything that decides a fit, in one validated and storable object."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule

__all__ = ["FitSettings", "read_config", "settings_from"]


def _plain(value: Any) -> Any:
    """Return a value as JSON would give it back: tuples as lists, numpy's numbers as Python's."""
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value


def _prior(name: str, value: Any) -> Any:
    """Return a prior as a run folder stores it: text, a number or a list."""
    if not hasattr(value, "log_prob"):
        return _plain(value)
    # Only who has a distribution has loaded torch already.
    from swarmssm.models.prior_text import exact_text

    try:
        return exact_text(value)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


#: Settings that are tables themselves.
NESTED = ("model_options", "guide_options", "priors", "edge_options")
Options = dict[str, Annotated[pydantic.JsonValue, pydantic.BeforeValidator(_plain)]]


class FitSettings(pydantic.BaseModel):
    """Settings of :func:`swarmssm.inference.fit`, as stored in a run folder.

    Attributes
    ----------
    model, guide
        Registered name or ``module:attribute``. The guide ``"auto"`` is the model's default.
    model_options, guide_options
        Named arguments of their constructors: values that JSON can hold.
    priors
        Priors in place of the model's own: name of a parameter -> a distribution of Pyro's or
        torch's, its text such as ``"LogNormal(-1, 0.5)"``, or a number at which it is held, see
        :func:`swarmssm.models.priors.with_priors`.
    edges
        ``"auto"``, the model's own; or those that take their place: ``"relational"``,
        ``"dynamic-relational"``, ``"observed"``, or a rule such as ``"radius:2.5"``, see
        :func:`swarmssm.models.presets.with_edges`.
    edge_types, edge_options
        Number of types of inferred edges, the one that is no edge included (absent, 2), and named
        arguments of their constructor.
    epochs
        Passes over all training windows; absent, those of the model (300 for the thesis's).
    steps
        Steps of the optimiser; given, it takes the place of ``epochs``. The last pass over the
        windows may then be partial.
    window
        Frames in a window; ``None``, whole trials; ``"auto"``, as many as the guide likes. Each
        step of the recording is in one window; for a state-space model with noisy observations
        each frame is.
    batch_windows
        Windows in a mini-batch; ``None``, all of them; ``"auto"``, a tenth, so that a pass
        over few data takes about as many steps of the optimiser as one over many.
    lr
        Learning rate of Adam.
    schedule
        ``"cosine"``: falls to zero at the last step; or ``"constant"``.
    anneal
        Steps in which the weight of the latent sites in the ELBO rises from 0 to 1; absent, it is
        1 throughout.
    draws
        Draws of the latent states for each step: with more than one, the importance weighted bound
        is maximised, which is tighter than the ELBO.
    clip
        Largest norm of the gradient of the loss per observed coordinate; absent, unbounded.
    seed
        Of initial weights, mini-batches and draws.
    device
        ``"cpu"``, ``"cuda"``, or ``"auto"``.
    scaler
        See :func:`swarmssm.tracks.scaling.fit_scaler`; ``"auto"``, as the model likes.
    graph
        ``"auto"``: that of the tracks, else :func:`swarmssm.graphs.default_rule`; ``"data"``: that
        of the tracks; else a rule as :meth:`swarmssm.graphs.GraphRule.parse` reads it, which
        replaces the tracks' own.
    velocity
        ``"auto"``: that of the tracks, else differences; or ``"difference"``, ``"kalman"``, see
        :func:`swarmssm.tracks.kinematics.add_velocity`.
    split_by, fractions, gap
        See :func:`swarmssm.tracks.splits.split`.
    validate_every
        Epochs between two rows of the history; absent, such that there are about a hundred.
    patience
        Rows of the history without a better validation loss after which training stops; absent,
        it goes on to the end. Either way the weights with the best validation loss are kept.
    checkpoint_every
        Steps between two checkpoints, rounded up to whole epochs.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, protected_namespaces=())

    model: str = "boids"
    model_options: Options = {}
    guide: str = "auto"
    guide_options: Options = {}
    priors: dict[str, str | float | list[Any]] = {}
    edges: str = "auto"
    edge_types: pydantic.PositiveInt | None = None
    edge_options: Options = {}
    epochs: pydantic.PositiveInt | None = None
    steps: pydantic.PositiveInt | None = None
    window: Annotated[int, pydantic.Field(ge=2)] | Literal["auto"] | None = "auto"
    batch_windows: pydantic.PositiveInt | Literal["auto"] | None = "auto"
    lr: pydantic.PositiveFloat = pydantic.Field(0.005, allow_inf_nan=False)
    schedule: Literal["constant", "cosine"] = "cosine"
    anneal: pydantic.PositiveInt | None = None
    draws: pydantic.PositiveInt = 1
    clip: pydantic.PositiveFloat | None = 1.0
    seed: int = pydantic.Field(0, ge=0, lt=2**63)
    device: str = "cpu"
    scaler: Literal["auto", "minmax", "isotropic", "none"] = "auto"
    graph: str = "auto"
    velocity: Literal["auto", "difference", "kalman"] = "auto"
    split_by: Literal["auto", "time", "trial"] = "auto"
    fractions: tuple[float, float, float] = (0.7, 0.15, 0.15)
    gap: pydantic.NonNegativeInt = 0
    validate_every: pydantic.PositiveInt | None = None
    patience: pydantic.PositiveInt | None = None
    checkpoint_every: pydantic.PositiveInt = 200

    @pydantic.field_validator("priors", mode="before")
    @classmethod
    def _distributions_become_text(cls, values: Any) -> Any:
        if not isinstance(values, Mapping):
            return values
        return {name: _prior(name, value) for name, value in values.items()}

    @pydantic.field_validator("graph")
    @classmethod
    def _graph_can_be_read(cls, value: str) -> str:
        if value not in ("auto", "data"):
            GraphRule.parse(value)
        return value


def read_config(path: Path) -> dict[str, Any]:
    """Read settings from a TOML file, in which 0 windows or frames mean all.

    Raises
    ------
    InputError
        Naming the file and the line, if it cannot be read, a key is unknown or a value is wrong.
    """
    try:
        text = path.read_text(encoding="utf-8")
        values = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: it cannot be read ({error}).") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: it is not TOML: {error}.") from error
    for name in ("window", "batch_windows"):
        if values.get(name) == 0:
            values[name] = None
    try:
        settings_from(values)
    except InputError as error:
        cause = error.__cause__
        loc = cause.errors()[0]["loc"] if isinstance(cause, pydantic.ValidationError) else ()
        raise InputError(f"{path}, line {_line_of(loc, text)}: {error}") from error
    return values


def _line_of(place: Sequence[int | str], text: str) -> int:
    """Return the line of a file at which a setting stands, counted from 1."""
    lines = text.splitlines()
    found = 0
    for name in place[:2]:
        key = rf"\s*(?:\[\s*)?[\"']?{re.escape(str(name))}[\"']?\s*[]=.]"
        below = [n for n in range(found, len(lines)) if re.match(key, lines[n])]
        found = below[0] if below else found
    return found + 1


def settings_from(values: Mapping[str, Any], where: str = "") -> FitSettings:
    """Return settings, or say in one sentence which is wrong.

    Parameters
    ----------
    values
        Names and values of :class:`FitSettings`.
    where
        Put before the sentence: the file they come from.

    Raises
    ------
    InputError
        Naming the setting, its value and what is allowed.
    """
    prefix = f"{where}: " if where else ""
    try:
        return FitSettings(**values)
    except pydantic.ValidationError as error:
        first, *rest = error.errors()
        # Of a value of several types there is an error for each, with the type behind the name.
        place = first["loc"] if first["loc"][0] in NESTED else first["loc"][:1]
        name = ".".join(str(part) for part in place)
        reason = str(first["msg"]).removeprefix("Value error, ")
        if name not in NESTED:
            others = [str(one["msg"]) for one in rest if one["loc"][0] == name]
            reason = ", or ".join([reason, *(m.removeprefix("Input should be ") for m in others)])
        if first["type"] == "extra_forbidden":
            reason = f"there is no such setting; choose among {', '.join(FitSettings.model_fields)}"
        shown = "" if "graph:" in reason else f" (given: {first['input']!r})"
        raise InputError(f"{prefix}{name}: {reason}{shown}.".replace("..", ".")) from error
