"""Whether posteriors are as wide as they should be: simulation-based calibration."""

from swarmssm.analysis.diagnostics.calibration.ranks import (
    calibration_of_ranks,
    calibration_sentence,
    calibration_table,
)
from swarmssm.analysis.diagnostics.calibration.simulation import simulation_based_calibration
from swarmssm.analysis.diagnostics.calibration.uniformity import ecdf_band, uniformity_p_value

__all__ = [
    "calibration_of_ranks",
    "calibration_sentence",
    "calibration_table",
    "ecdf_band",
    "simulation_based_calibration",
    "uniformity_p_value",
]
