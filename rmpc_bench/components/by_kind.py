"""Designs by the name of their kind, for programs: built-in, registered and installed components."""

from __future__ import annotations

from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.designs import registered_design
from rmpc_bench.types import Controller, Estimator, Model, Plant


def plant(kind: str, *args: Any, **parameters: Any) -> Plant:
    """Design a plant by its name."""
    made: Plant = _made("plants", kind, args, parameters)
    return made


def model(kind: str, *args: Any, **parameters: Any) -> Model:
    """Design a model by its name: ``model("linear", n_steps=100, A=A, B=B, C=C, P_w=0.25, M_w=M_w)``."""
    made: Model = _made("models", kind, args, parameters)
    return made


def estimator(kind: str, *args: Any, **parameters: Any) -> Estimator:
    """Design an estimator by its name: ``estimator("kalman", model, n_steps=200, x0=x0, P0=P0)``."""
    made: Estimator = _made("estimators", kind, args, parameters)
    return made


def controller(kind: str, *args: Any, **parameters: Any) -> Controller:
    """Design a controller by its name."""
    made: Controller = _made("controllers", kind, args, parameters)
    return made


def _made(group: str, kind: str, args: tuple[Any, ...], parameters: dict[str, Any]) -> Any:
    return registry.checked(group, kind, registered_design(group, kind)(*args, **parameters), {})
