"""Metrics: one number per run, computed from its trajectories; one file per family.

tracking, input, estimation, consistency, sets, sample, cost, certificate, departures, reported, singular_poses hold the
metrics.  The other files contain functions that several families share: norms (averages and reductions of a signal),
burst_samples (samples in or outside bursts), estimate_checks (data that an estimator must provide, and its error) and
components (their choice, divisors and units).
"""
