"""Tracks by name: what comes with the package, recordings in a folder, simulated swarms."""

from swarmssm.datasets.named import DATASETS, NamedDataset, load_dataset
from swarmssm.datasets.sunbleak import load_sunbleak, load_sunbleak_groups

__all__ = [
    "DATASETS",
    "NamedDataset",
    "load_dataset",
    "load_sunbleak",
    "load_sunbleak_groups",
]
