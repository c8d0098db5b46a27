"""Rivals to hold a model against: the simplest forecasts that anybody would try first."""

from swarmssm.baselines.base import Baseline
from swarmssm.baselines.constant_velocity import ConstantVelocity
from swarmssm.baselines.stay_put import StayPut

__all__ = ["BASELINES", "Baseline", "ConstantVelocity", "StayPut"]

BASELINES: dict[str, type[Baseline]] = {
    baseline.name: baseline for baseline in (StayPut, ConstantVelocity)
}
