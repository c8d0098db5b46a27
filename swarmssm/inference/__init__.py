"""Guides, fitting, forecasting and checkpoints."""
