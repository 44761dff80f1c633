"""Keys of estimators that have no default, for tests of all kinds; a new kind with such a key gets a line here."""

from typing import Any

REQUIRED: dict[str, dict[str, Any]] = {
    "directional-kalman": {"q": 0.01, "direction": 1.0},
    "fading-kalman": {"alpha": 1.01},
    "h-infinity": {"fraction": 0.5},
    "risk-sensitive": {"theta": 0.01},
    "robust-h-infinity": {"alpha": 0.1},
    "robust-kalman": {"c": 0.1},
    "wasserstein-kalman": {"radius": 0.01},
}


def in_yaml(kind: str) -> str:
    """Return the required keys of an estimator as a part of a mapping in YAML."""
    return ", ".join(f"{key}: {value}" for key, value in REQUIRED.get(kind, {}).items())
