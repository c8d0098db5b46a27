"""Simulated swarms: boids, Vicsek, Couzin and particles, with the truth behind every step."""

from swarmssm.simulate.boids import Boids, simulate_boids
from swarmssm.simulate.couzin import Couzin, simulate_couzin
from swarmssm.simulate.laws import law_of
from swarmssm.simulate.particles import Charged, Springs, simulate_charged, simulate_springs
from swarmssm.simulate.recording import Law
from swarmssm.simulate.truth import add_truth
from swarmssm.simulate.vicsek import Vicsek, simulate_vicsek

__all__ = [
    "Boids",
    "Charged",
    "Couzin",
    "Law",
    "Springs",
    "Vicsek",
    "add_truth",
    "law_of",
    "simulate_boids",
    "simulate_charged",
    "simulate_couzin",
    "simulate_springs",
    "simulate_vicsek",
]
