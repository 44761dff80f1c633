"""Metrics: one number per run, computed from its trajectories."""
