"""Simulated swarms: boids, Vicsek, Couzin and particles, with the truth behind every step."""

from swarmssm.simulate.boids import Boids, simulate_boids
from swarmssm.simulate.couzin import Couzin, simulate_couzin
from swarmssm.simulate.dynamics import dynamics_of
from swarmssm.simulate.particles import Charged, Springs, simulate_charged, simulate_springs
from swarmssm.simulate.recording import Dynamics
from swarmssm.simulate.truth import add_truth
from swarmssm.simulate.vicsek import Vicsek, simulate_vicsek

__all__ = [
    "Boids",
    "Charged",
    "Couzin",
    "Dynamics",
    "Springs",
    "Vicsek",
    "add_truth",
    "dynamics_of",
    "simulate_boids",
    "simulate_charged",
    "simulate_couzin",
    "simulate_springs",
    "simulate_vicsek",
]
