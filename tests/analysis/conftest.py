"""A quick fit, evaluations with planted numbers, and a browser that notes what pages do."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr

from swarmssm import inference, simulate
from swarmssm.analysis import Evaluation
from swarmssm.inference import Fit

STEPS = 20
#: Browsers by which pages are opened.
NAMES = ("chromium", "chromium-browser", "google-chrome")
#: Milliseconds; a busy machine is slow.
PATIENCE = 60_000


@pytest.fixture(scope="session")
def boids() -> xr.Dataset:
    """Five boids in four trials of 60 frames, with the truth behind every step."""
    return simulate.simulate_boids(individuals=5, steps=60, trials=4, seed=0)


@pytest.fixture(scope="session")
def quick_fit(boids: xr.Dataset) -> Fit:
    """A fit of four epochs: what it predicts is poor, and fixed."""
    torch.set_num_threads(1)
    return inference.fit("graph-vae", boids, guide="encoder", epochs=4, seed=0)


@pytest.fixture
def planted() -> Callable[..., Evaluation]:
    """Return a function that makes an evaluation in which chosen scores have chosen values."""
    return plant


def plant(**scores: Any) -> Evaluation:
    """Make an evaluation of model, stay-put and constant velocity.

    Each keyword names a score and gives its values for the three; ``floor`` adds a noise floor
    with that MSE. Whatever is not named is 1 for all three, except that the truth's AMD and AVD
    are 1 and edge accuracies are 0.5.
    """
    methods = ["graph-vae", "stay-put", "constant-velocity"]
    titles = ["graph-vae", "stay put", "constant velocity"]
    floor = scores.pop("floor", None)
    if floor is not None:
        methods.append("noise-floor")
        titles.append("true rule (noise floor)")
    steps = np.arange(1, STEPS + 1)

    def values(name: str) -> list[float]:
        given = list(scores.get(name, (1.0, 1.0, 1.0)))
        return given if floor is None else [*given, floor]

    def curve(name: str) -> np.ndarray:
        given = values(name)
        return np.stack([np.broadcast_to(np.asarray(v, float), steps.shape) for v in given])

    over = ("method", "step")
    table = xr.Dataset(
        {
            "mse": ("method", values("mse")),
            "mae": ("method", values("mae")),
            "squared_error": (over, curve("squared_error")),
            "forecast_mse": (over, curve("squared_error")),
            "forecast_mae": (over, curve("squared_error")),
            "num_scored": ("step", np.full(STEPS, 10)),
        },
        {"method": methods, "title": ("method", titles), "step": steps},
    )
    collective = xr.Dataset(
        {
            name + suffix: (
                ("series", "time"),
                np.outer([1.0, *values(f"{name}_mean")], np.ones(5)),
            )
            for name in ("amd", "avd")
            for suffix in ("", "_low", "_high")
        }
        | {
            f"{name}_{kind}": (
                "series",
                [first, *values(f"{name}_{kind}")],
            )
            for name in ("amd", "avd")
            for kind, first in (("mean", 1.0), ("error", 0.0))
        },
        {
            "series": ["truth", *methods],
            "title": ("series", ["truth", *titles]),
            "time": np.arange(5) * 0.1,
        },
    )
    accuracy = np.asarray(scores.get("accuracy", (0.5, 0.5, 0.5, 0.5)), float)
    edges = xr.Dataset(
        {
            name: (
                ("predictor", "trial", "time"),
                np.broadcast_to(accuracy[:, None, None], (4, 1, 5)),
            )
            for name in ("accuracy", "precision", "recall", "auc")
        }
        | {"density": (("trial", "time"), np.full((1, 5), 0.5))},
        {
            "predictor": [*methods[:3], "commoner"],
            "title": (
                "predictor",
                [
                    "graph-vae",
                    "same graph as before",
                    "graph rule on constant velocity",
                    "no edge at all",
                ],
            ),
            "trial": ["0"],
            "time": np.arange(5) * 0.1,
        },
    )
    unit = scores.get("unit", "cm")
    history = xr.Dataset(
        {
            "loss": ("epoch", [4.0, 2.0, 1.0]),
            "validation_loss": ("epoch", [4.0, 1.0, 3.0]),
            "mse": ("epoch", [3.0, 2.0, 1.0]),
            "mae": ("epoch", [3.0, 2.0, 1.0]),
        },
        {"epoch": [1.0, 2.0, 3.0]},
    )
    settings = {
        "model": "graph-vae",
        "part": "test",
        "horizons": [1, 5, STEPS],
        "origins": 1,
        "free_run_steps": 4,
        "starts": 1,
        "draws": 1,
        "futures": 10,
        "seed": 0,
        "edges": "decoder",
        "fps": 10.0,
        "unit": unit,
        "thesis": "guppies",
        "L": 0.1,
        "scaler": {"kind": "minmax", "offset": [0.0] * 4, "scale": [1.0] * 4},
    }
    return Evaluation(
        planted_forecasts(methods, titles, [1, 5, STEPS], unit),
        table,
        collective,
        edges,
        moving_square(unit),
        square_graphs(unit),
        random_runs(unit),
        history,
        settings,
        tuple(scores.get("notes", ())),
    )


def planted_forecasts(
    methods: list[str], titles: list[str], horizons: list[int], unit: str
) -> xr.Dataset:
    """Scores of 60 origins: each method's CRPS is its place among them, from 1."""
    over = ("model", "origin", "horizon")
    shape = (len(methods), 60, len(horizons))
    values = np.broadcast_to(np.arange(1.0, len(methods) + 1)[:, None, None], shape)
    data: dict[str, object] = {
        name: (over, sign * values, {"units": units, "long_name": ""})
        for name, sign, units in (("log_score", -1, "nat"), ("crps", 1, unit), ("mse", 1, "1"))
    }
    covered = np.full((*shape, 1), 0.9)
    data["coverage"] = ((*over, "level"), covered, {"units": "1", "long_name": ""})
    data["number"] = (over[1:], np.full(shape[1:], 4))
    data["trained_on"] = ("model", [0] * len(methods))
    coords = {
        "model": methods,
        "title": ("model", titles),
        "fitted": ("model", [place == 0 for place in range(len(methods))]),
        "horizon": horizons,
        "ahead": ("horizon", np.array(horizons) / 10.0),
        "level": [0.9],
        "trial": ("origin", ["0"] * 60),
        "frame": ("origin", 5 * np.arange(60)),
    }
    return xr.Dataset(data, coords, {"unit": unit, "fps": 10.0, "notes": []})


def moving_square(unit: str = "cm") -> xr.Dataset:
    """Four individuals at the corners of a unit square that moves by (1, 0) a frame.

    The one-step imitation is (0, 0.5) off, the free run stands still.
    """
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    times = np.arange(6)
    true = corners + times[:, None, None] * np.array([1.0, 0.0])
    velocity = np.broadcast_to([10.0, 0.0], true.shape)
    dims = ("time", "individual", "space")
    single = true + np.array([0.0, 0.5])
    single[0] = np.nan
    free = np.broadcast_to(true[0], true.shape)
    names = (("true", true), ("one_step", single), ("free_run", free))
    data = {name: (dims, value) for name, value in names}
    data |= {f"{name}_velocity": (dims, velocity) for name, _ in names}
    return xr.Dataset(
        data,
        {"time": times * 0.1, "space": ["x", "y"], "individual": list("abcd")},
        {"trial": "0", "unit": unit},
    )


def square_graphs(unit: str = "cm") -> xr.Dataset:
    """Two snapshots of the square: a ring is true, and the ring but for one edge is predicted."""
    ring = np.zeros((4, 4), dtype=bool)
    ring[np.arange(4), (np.arange(4) + 1) % 4] = True
    ring |= ring.T
    probability = np.where(ring, 0.9, 0.1)
    probability[0, 1] = 0.2
    pairs = ("snapshot", "individual", "neighbor")
    position = moving_square()["true"].to_numpy()[:2]
    return xr.Dataset(
        {
            "position": (("snapshot", "individual", "space"), position),
            "true": (pairs, np.stack([ring, ring])),
            "probability": (pairs, np.stack([probability, probability])),
        },
        {
            "snapshot": [0.0, 0.1],
            "space": ["x", "y"],
            "individual": list("abcd"),
            "neighbor": list("abcd"),
        },
        {"unit": unit},
    )


def random_runs(unit: str = "cm") -> xr.Dataset:
    """Two runs in which a unit square shrinks to half its side."""
    square = moving_square()["true"].to_numpy()[0]
    position = np.stack([square * (1 - 0.1 * step) for step in range(6)])
    dims = ("run", "time", "individual", "space")
    return xr.Dataset(
        {
            "position": (dims, np.stack([position, position])),
            "velocity": (dims, np.ones((2, 6, 4, 2))),
        },
        {"time": np.arange(6) * 0.1, "space": ["x", "y"], "individual": list("abcd")},
        {"unit": unit},
    )


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium as the system has it, driven by Playwright."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no browser test: playwright is not installed"
    )
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip(f"no browser test: there is none of {', '.join(NAMES)}")
    # Chromium's own sandbox does not work for root, as in a container.
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=path, args=options, timeout=PATIENCE)
        yield running
        running.close()


Visit = Callable[..., Any]


@pytest.fixture
def visit(browser: Any, tmp_path: Path) -> Iterator[Visit]:
    """Open HTML as a file; fail the test if a page logs an error or asks for anything else."""
    contexts, complaints = [], []

    def open_page(text: str, **context: Any) -> Any:
        file = tmp_path / f"page{len(contexts)}.html"
        file.write_text(text, encoding="utf-8")
        contexts.append(browser.new_context(**context))
        page = contexts[-1].new_page()
        page.set_default_timeout(PATIENCE)
        own = file.as_uri()

        def note_request(request: Any) -> None:
            if request.url != own and not request.url.startswith("data:"):
                complaints.append(f"asked for {request.url}")

        def note_message(message: Any) -> None:
            if message.type in ("error", "warning"):
                complaints.append(f"logged {message.text}")

        page.on("request", note_request)
        page.on("console", note_message)
        page.on("pageerror", lambda error: complaints.append(f"raised {error}"))
        page.goto(own)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not complaints
