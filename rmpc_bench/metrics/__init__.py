"""Metrics: one number per run, computed from its trajectories; one file per family.

tracking, input, estimation, consistency, sets, sample, cost, certificate, departures, reported, singular_poses hold the
metrics.  The files below them hold what several families share: means (averages over time), burst_samples (samples in
or outside bursts), error_size (an error relative to a matrix), estimate_checks (what an estimator must provide) and
output_choice (components and units of outputs).
"""
