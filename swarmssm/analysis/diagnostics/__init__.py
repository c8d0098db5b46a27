"""Whether a fit can be believed: predictive checks, calibration, recovery of known parameters."""
