"""Metrics: one number per run, computed from its trajectories; one file per family.

tracking, input, estimation, consistency, sets, sample, cost, certificate, departures, reported, singular_poses hold the
metrics.  The other files contain functions that several families share: means (averages over time), burst_samples
(samples in or outside bursts), norms (reductions of a signal), error_size (an error relative to a matrix),
estimate_checks (data that an estimator must provide) and components (their choice, divisors and units).
"""
