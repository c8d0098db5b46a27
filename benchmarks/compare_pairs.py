"""Does `compare` rank the true model first? Pairs of models that differ by a whole force.

    python benchmarks/compare_pairs.py [--pairs 100] [--method lfo] [--reverse]

Simulates a swarm on springs that align, fits the same law with and without alignment, and compares
the two on the frames that come after those of the fit. `--reverse`: of swarms that do not align,
where the richer model holds the true one, so that only what it learned in vain tells them apart.
Prints a line a pair, and how often the true model is first.
"""

import argparse
import time
import warnings

import numpy as np
import torch
import xarray as xr

from swarmssm.analysis.scoring import compare
from swarmssm.inference import Fit, fit
from swarmssm.models import InitialStates, PositionEmission, Scales, StateSpaceModel
from swarmssm.models.parameters import assign
from swarmssm.models.presets import linear
from swarmssm.models.transitions import LinearForceTransition
from swarmssm.tracks import make_tracks

FPS, INDIVIDUALS, FRAMES = 10.0, 6, 120
ALIGNMENT = 1.0


def aligned(scales: Scales) -> StateSpaceModel:
    """Return the law with alignment, its gain to be inferred."""
    return linear(scales, homing=False)


def unaligned(scales: Scales) -> StateSpaceModel:
    """Return the law without."""
    model = linear(scales, homing=False)
    assign(model.transition, "alignment_gain", 0.0)
    return model


def simulate(seed: int, alignment: float) -> xr.Dataset:
    """Return one swarm, everybody seeing everybody."""
    law = StateSpaceModel(
        InitialStates(torch.zeros(4), torch.tensor([1.0, 1.0, 0.5, 0.5])),
        LinearForceTransition(
            2,
            1.0 / FPS,
            cohesion_gain=0.5,
            alignment_gain=alignment,
            damping=0.3,
            process_noise=0.3,
        ),
        PositionEmission(2, 0.02),
    )
    graph = (1.0 - torch.eye(INDIVIDUALS)).expand(FRAMES, -1, -1)
    drawn = law.simulate(FRAMES, INDIVIDUALS, graph=graph, seed=seed)
    adjacency = graph.numpy().astype(np.uint8)
    return make_tracks(drawn.observations[0].numpy(), fps=FPS, adjacency=adjacency)


def fitted(tracks: xr.Dataset, seed: int) -> dict[str, Fit]:
    """Fit both laws to the first half of the frames."""
    options = {"split_by": "time", "fractions": (0.5, 0.0, 0.5), "seed": seed}
    return {
        name: fit(model, tracks, guide="linearized", **options)
        for name, model in (("aligned", aligned), ("unaligned", unaligned))
    }


def main() -> None:
    """Run the pairs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--method", choices=["lfo", "loo", "held-out"], default="lfo")
    parser.add_argument("--reverse", action="store_true")
    options = parser.parse_args()
    warnings.filterwarnings("ignore", category=FutureWarning)
    truth = "unaligned" if options.reverse else "aligned"
    began, right, sure = time.process_time(), 0, 0
    for seed in range(options.pairs):
        tracks = simulate(seed, 0.0 if options.reverse else ALIGNMENT)
        fits = fitted(tracks, seed)
        more = {} if options.method == "held-out" else {"draws": 200, "window": 5}
        result = compare(fits, tracks, method=options.method, seed=seed, **more).data
        names = [str(name) for name in result["model"].values if str(name) in fits]
        behind = result.sel(model=names[1])
        margin, error = float(behind["difference"]), float(behind["difference_se"])
        right += names[0] == truth
        sure += names[0] != truth and margin > 2.0 * error
        print(
            f"pair {seed}: {names[0]} first by {margin:.3g} (standard error {error:.2g}); "
            f"true model first in {right} of {seed + 1}, wrong by more than two standard errors "
            f"in {sure}; {time.process_time() - began:.0f} CPU s",
            flush=True,
        )


if __name__ == "__main__":
    main()
