"""Comparison of plant and design model before any run."""
