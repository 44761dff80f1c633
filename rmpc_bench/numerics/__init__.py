"""Numerical algorithms on arrays; no plant, model, estimator or controller is imported here."""
