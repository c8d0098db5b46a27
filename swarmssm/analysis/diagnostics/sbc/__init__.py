"""Simulation-based calibration: whether posterior intervals cover as often as they claim."""

from swarmssm.analysis.diagnostics.sbc.ranks import Calibration, calibration_of_ranks
from swarmssm.analysis.diagnostics.sbc.uniformity import ecdf_band, uniformity_p_value

__all__ = ["Calibration", "calibration_of_ranks", "ecdf_band", "uniformity_p_value"]
