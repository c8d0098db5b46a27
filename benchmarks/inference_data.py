"""Time and memory of 200 draws of 10 individuals and 1000 frames as an ArviZ object.

    python benchmarks/inference_data.py [--run RUN] [--draws 200] [--frames 1000] [--individuals 10]

Simulates boids seen with noise, fits them (or takes a run of boids with as many individuals), and
prints seconds of the processor, seconds on the clock and the greatest memory of
`to_inference_data`, then those of a NetCDF round trip and of `az.loo`.
"""

import argparse
import resource
import tempfile
import time
import warnings
from pathlib import Path

warnings.filterwarnings("ignore", category=FutureWarning)

import arviz as az  # noqa: E402

from swarmssm.analysis.posterior import to_inference_data  # noqa: E402
from swarmssm.inference import Fit, fit  # noqa: E402
from swarmssm.simulate import simulate_boids  # noqa: E402


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--individuals", type=int, default=10)
    options = parser.parse_args()
    sizes = options.individuals, options.frames, 1
    tracks = simulate_boids(*sizes, observation_noise=0.03, seed=5)
    if options.run is None:
        fitted = fit("boids", tracks.isel(time=slice(0, 300)), guide="linearized", seed=0)
    else:
        fitted = Fit.load(options.run)
    before = gigabytes()
    began = time.perf_counter(), time.process_time()
    idata = to_inference_data(fitted, tracks, options.draws)
    clock, processor = time.perf_counter() - began[0], time.process_time() - began[1]
    print(
        f"to_inference_data, {options.draws} draws of {options.individuals} individuals x "
        f"{options.frames} frames: {processor:.1f} s of the processor, {clock:.1f} s on the "
        f"clock; memory {gigabytes():.2f} GB at most ({before:.2f} before)"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fit.nc"
        began = time.perf_counter(), time.process_time()
        idata.to_netcdf(str(path))
        again = az.from_netcdf(str(path))
        print(
            f"NetCDF round trip: {time.process_time() - began[1]:.1f} s, "
            f"{path.stat().st_size / 1e6:.0f} MB"
        )
    began = time.perf_counter(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = az.loo(again)
    print(f"az.loo: {time.process_time() - began[1]:.1f} s, elpd {found.elpd_loo:.0f}")


def gigabytes() -> float:
    """Return the greatest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


if __name__ == "__main__":
    main()
