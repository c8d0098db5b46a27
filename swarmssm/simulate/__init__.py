"""Simulated swarms: boids, Vicsek and Couzin, with the truth behind every step."""

from swarmssm.simulate.boids import Boids, simulate_boids
from swarmssm.simulate.couzin import Couzin, simulate_couzin
from swarmssm.simulate.laws import law_of
from swarmssm.simulate.recording import Law
from swarmssm.simulate.vicsek import Vicsek, simulate_vicsek

__all__ = [
    "Boids",
    "Couzin",
    "Law",
    "Vicsek",
    "law_of",
    "simulate_boids",
    "simulate_couzin",
    "simulate_vicsek",
]
