"""Scores, pictures and reports of fitted models."""
