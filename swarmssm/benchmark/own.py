"""The models of this package as methods of a benchmark, with the settings of each."""

from swarmssm.benchmark.own_edges import InferredEdgesMethod
from swarmssm.benchmark.own_method import OwnMethod

__all__ = ["OWN"]

#: Walls that are inferred from where animals happened to be push them out of the rest of the tank.
ANIMALS = {"relaxation": True, "limits": False, "walls": False, "noise": "additive"}
OWN: dict[str, OwnMethod] = {
    one.name: one
    for one in (
        OwnMethod(
            "graph-vae",
            "graph VAE of the thesis",
            "graph-vae",
            exact_settings={"epochs": 300},
            noisy_settings={"epochs": 300},
        ),
        OwnMethod(
            "boids",
            "boids, gains inferred",
            "boids",
            exact={"observed": "states"},
            noisy=ANIMALS,
            exact_settings={"epochs": 150, "lr": 0.02},
            told=True,
        ),
        OwnMethod(
            "linear",
            "linear forces, solved exactly",
            "linear",
            exact={"observed": "states"},
            exact_settings={"epochs": 100, "lr": 0.02},
        ),
        OwnMethod(
            "kernel",
            "kernels of distance, inferred",
            "kernel",
            exact={"observed": "states", "noise": "multiplicative", "repulsion": True},
            noisy={"angular": 2, **ANIMALS},
            exact_settings={"epochs": 100, "lr": 0.02},
        ),
        OwnMethod(
            "graph-ssm",
            "graph state-space model",
            "graph-ssm",
            exact={
                "observed": "states",
                "symmetries": "square",
                "noise": "constant",
                "tails": "gaussian",
                "weight_prior": None,
            },
            exact_settings={"window": 10, "batch_windows": 32, "lr": 0.02, "epochs": 80},
            # Where the test part lies elsewhere in the tank, places say nothing.
            noisy={"positions": False},
            noisy_settings={"epochs": 300},
        ),
        InferredEdgesMethod(
            "boids-edges",
            "boids, edges inferred",
            "boids",
            exact={"observed": "states"},
            noisy=ANIMALS,
            exact_settings={"lr": 0.02, "window": 15, "batch_windows": 16},
            noisy_settings={"guide": "markov"},
            edge_settings={"lr": 0.01, "batch_windows": 8, "edge_options": {"sparsity": 0.5}},
            told=True,
        ),
    )
}
