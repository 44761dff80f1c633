"""A small experiment with the key `calibration`: filters that are right, overconfident, without P, and with a bound."""

import yaml

A = [[1.0, 0.1], [0.0, 0.9]]
LINEAR = {"kind": "linear", "A": A, "B": [[0.0], [0.1]], "C": [[1.0, 0.0]]}


def model(scale=1.0):
    """Return the design model with all covariances times a number."""
    return {**LINEAR, "P_w": [[0.01 * scale, 0.0], [0.0, 0.05 * scale]], "P_v": 0.1 * scale}


def keys(**others):
    """Return the keys of the configuration; None leaves one out."""
    found = {
        "version": 1,
        "name": "calibrated",
        "seed": 3,
        "runs": 60,
        "time": {"steps": 60},
        "plant": LINEAR,
        "model": model(),
        "noise": "same",
        "initial": {"x": {"gaussian": {"cov": 1.0}}, "P": 1.0},
        "methods": {
            "KF": {"estimator": {"kind": "kalman"}},
            "small": {"model": model(1 / 2.25), "estimator": {"kind": "kalman"}},
            "none": {"estimator": {"kind": "h-infinity", "theta": 0.01}},
        },
        "metrics": ["estimation_mse"],
        "figures": [],
        "calibration": True,
    } | others
    return {name: value for name, value in found.items() if value is not None}


def write(directory, **others):
    """Write the configuration and return its path."""
    path = directory / "calibrated.yaml"
    path.write_text(yaml.safe_dump(keys(**others), sort_keys=False), encoding="utf-8")
    return path
