"""The models of this package as methods of a benchmark, with the settings of each."""

from swarmssm.benchmark.inferred_edges_method import InferredEdgesMethod
from swarmssm.benchmark.model_method import ModelMethod

__all__ = ["MODELS"]

#: Walls that are inferred from where animals happened to be push them out of the rest of the tank.
ANIMALS = {"relaxation": True, "limits": False, "walls": False, "noise": "additive"}
MODELS: dict[str, ModelMethod] = {
    one.name: one
    for one in (
        ModelMethod(
            "graph-vae",
            "graph VAE of the thesis",
            "graph-vae",
            exact_settings={"epochs": 300},
            noisy_settings={"epochs": 300},
        ),
        ModelMethod(
            "boids",
            "boids, gains inferred",
            "boids",
            exact={"observed": "states"},
            noisy=ANIMALS,
            exact_settings={"epochs": 150, "lr": 0.02},
            knows_boids=True,
        ),
        ModelMethod(
            "linear",
            "linear forces, solved exactly",
            "linear",
            exact={"observed": "states"},
            exact_settings={"epochs": 100, "lr": 0.02},
        ),
        ModelMethod(
            "kernel",
            "kernels of distance, inferred",
            "kernel",
            exact={"observed": "states", "noise": "multiplicative", "repulsion": True},
            noisy={"angular": 2, **ANIMALS},
            exact_settings={"epochs": 100, "lr": 0.02},
        ),
        ModelMethod(
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
            knows_boids=True,
        ),
    )
}
