"""Settings are refused in one sentence that names them, or stored so that they come back."""

import json

import numpy as np
import pytest

from swarmssm.errors import InputError
from swarmssm.inference import FitSettings, fit
from swarmssm.inference.settings import settings_from


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"epochs": 0}, r"epochs: Input should be greater than 0 \(given: 0\)"),
        ({"steps": 1.5}, r"steps: .*\(given: 1\.5\)"),
        ({"window": 1}, r"window: .*greater than or equal to 2, or 'auto' \(given: 1\)"),
        ({"window": "long"}, r"window: .* valid integer.*, or 'auto' \(given: 'long'\)"),
        ({"batch_windows": 0}, r"batch_windows: .*greater than 0, or 'auto' \(given: 0\)"),
        ({"lr": -1}, "lr: Input should be greater than 0"),
        ({"lr": float("inf")}, "lr: .*finite"),
        ({"lr": float("nan")}, "lr: "),
        ({"clip": float("nan")}, "clip: "),
        ({"schedule": "step"}, "schedule: .*'constant' or 'cosine'"),
        ({"seed": -1}, "seed: "),
        ({"seed": 2**63}, "seed: "),
        ({"scaler": "z"}, "scaler: .*'auto', 'minmax', 'isotropic' or 'none'"),
        ({"anneal": 0}, "anneal: Input should be greater than 0"),
        ({"draws": 0}, "draws: Input should be greater than 0"),
        ({"priors": {"gain": None}}, r"priors\.gain.*: Input should be a valid .* \(given: None\)"),
        ({"priors": "Normal(0, 1)"}, "priors: Input should be a valid dictionary"),
        ({"velocity": "guess"}, "velocity: "),
        ({"graph": "best:3"}, "graph: the kind 'best' is unknown"),
        ({"graph": "radius"}, "graph: a radius graph needs radius"),
        ({"split_by": "fish"}, "split_by: "),
        ({"fractions": (0.5, 0.5)}, "fractions"),
        ({"gap": -1}, "gap: "),
        ({"patience": 0}, "patience: "),
        ({"validate_every": 0}, "validate_every: "),
        ({"checkpoint_every": 0}, "checkpoint_every: "),
        ({"model": 3}, r"model: Input should be a valid string \(given: 3\)"),
        ({"guide": None}, r"guide: Input should be a valid string \(given: None\)"),
        ({"learning_rate": 0.1}, "learning_rate: there is no such setting; choose among model,"),
        ({"model_options": {"a": {1, 2}}}, r"model_options\.a: "),
        ({"guide_options": {"a": [print]}}, r"guide_options\.a"),
        ({"guide_options": 3}, "guide_options: "),
    ],
)
def test_a_wrong_setting_is_named(swarm, values, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        settings_from(values)
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(InputError, match=r"^fast\.toml: "):
        settings_from(values, "fast.toml")
    with pytest.raises((InputError, TypeError), match=sentence.split(":")[0]):
        fit(**{"model": "graph-vae", "tracks": swarm, **values})


def test_a_device_that_is_not_there_is_named(swarm):
    for name in ("gpu", "meta", "cuda:99", ""):
        with pytest.raises(InputError, match=r"device: .* is not available; choose cpu"):
            fit("graph-vae", swarm, device=name)


def test_options_come_back_as_json_has_them():
    """What Python and numpy write otherwise is stored plainly, and equal settings are equal."""
    given = {
        "widths": (8, np.int64(4)),
        "scale": np.float32(0.5),
        "grid": np.arange(3),
        "nested": {"limit": float("inf"), "names": ["a", None, True]},
    }
    settings = FitSettings(model_options=given, guide_options=given)
    plain = {
        "widths": [8, 4],
        "scale": 0.5,
        "grid": [0, 1, 2],
        "nested": {"limit": float("inf"), "names": ["a", None, True]},
    }
    assert settings.model_options == settings.guide_options == plain
    stored = json.loads(json.dumps(settings.model_dump(mode="json")))
    assert settings_from(stored) == settings


@pytest.mark.parametrize("graph", ["auto", "data", "radius:2.5", "k-nearest:6", "visual:1.2"])
def test_all_settings_come_back(graph):
    settings = FitSettings(
        steps=7, window=None, batch_windows=None, clip=None, fractions=(0.5, 0.5, 0), graph=graph
    )
    stored = json.loads(json.dumps(settings.model_dump(mode="json")))
    assert settings_from(stored) == settings
    with pytest.raises(ValueError, match="frozen"):
        settings.seed = 3
