"""Gains from noisy positions alone: 8 flocks of 10 boids, 200 frames, noise 0.03.

    python benchmarks/gain_recovery.py [--seeds 1] [--method iterated|extended] [--given 15]

Prints posterior means with 90 % intervals beside the truth, the regression on finite differences,
and the time.
"""

import argparse
import time

import numpy as np
import torch
from flocks import GAINS, TRUTH, finite_differences, flock_model, simulate, windows

from swarmssm.inference.laplace_method import laplace


def main() -> None:
    """Fit, and print the posterior beside the truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--method", choices=["iterated", "extended"], default="iterated")
    parser.add_argument("--given", type=int, default=15, help="frames that are not scored")
    options = parser.parse_args()
    for seed in range(options.seeds):
        tracks = simulate(TRUTH, seed, 8, 200)
        gains, _, noise = finite_differences(tracks)
        rival = dict(zip(GAINS, gains, strict=True)) | {"transition.process_noise": noise}
        began = time.perf_counter()
        found = laplace(flock_model(), windows(tracks), method=options.method, given=options.given)
        seconds = time.perf_counter() - began
        deviation = found.scale_tril.square().sum(-1).sqrt()
        generator = torch.Generator().manual_seed(seed)
        draws = torch.randn(4000, len(found.names), dtype=torch.float64, generator=generator)
        draws = (found.loc + draws @ found.scale_tril.mT).exp().numpy()
        print(f"seed {seed}: {seconds:.1f} s ({options.method})")
        print(f"{'':28s} truth  mean   5 %    95 %   z      off     differences")
        for index, name in enumerate(found.names):
            low, high = np.quantile(draws[:, index], [0.05, 0.95])
            mean, truth = draws[:, index].mean(), TRUTH[name]
            z = float((found.loc[index] - np.log(truth)) / deviation[index])
            other = f"{rival[name]:.3f}" if name in rival else "-"
            print(
                f"{name:28s} {truth:.3f}  {mean:.3f}  {low:.3f}  {high:.3f}  {z:+.2f}"
                f"  {mean / truth - 1:+.1%}  {other}"
            )


if __name__ == "__main__":
    main()
