"""Keys without a default, for tests of all estimators and controllers; a new kind with such a key gets a line here."""

import inspect
import json
from typing import Any

from rmpc_bench import registry

REQUIRED: dict[str, dict[str, Any]] = {
    "directional-kalman": {"q": 0.01, "direction": 1.0},
    "fading-kalman": {"alpha": 1.01},
    "h-infinity": {"fraction": 0.5},
    "risk-sensitive": {"theta": 0.01},
    "robust-h-infinity": {"alpha": 0.1},
    "robust-kalman": {"c": 0.1},
    "wasserstein-kalman": {"radius": 0.01},
    "gpc": {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1},
    "mpc": {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1},
    "minimax-lq": {"horizon": 3, "Q_x": 1.0, "R_u": 0.1},
    "lqr": {"horizon": 7, "Q_x": 1.0, "R_u": 0.1},
    "control-lqr": {"Q_x": 1.0, "R_u": 0.1},
    "tube-mpc": {"horizon": 3, "Q_x": 1.0, "R_u": 0.1, "limits": {"u": (-1.0, 1.0)}, "W": 0.1},
    "game-gain": {"horizon": 7, "Q_x": 1.0, "R_u": 0.1},
    "lqg": {"Q_x": 1.0, "Q_i": 0.1, "R_u": 0.1},
    "pid": {"Kp": 1.0},
}


def sampled(kind: str) -> dict[str, float]:
    """Return a sampling time if the design of this estimator takes one."""
    return {"Ts": 0.1} if "Ts" in inspect.signature(registry.get("estimators", kind)).parameters else {}


def in_yaml(kind: str) -> str:
    """Return the required keys of a kind as a part of a mapping in YAML."""
    return ", ".join(f"{key}: {json.dumps(value)}" for key, value in REQUIRED.get(kind, {}).items())
