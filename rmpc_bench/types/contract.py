"""Checks of the object that a design function returns, the same for built-in, registered and installed components."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from inspect import isfunction
from typing import Any, cast

import numpy as np

from rmpc_bench.types.basics import declaring
from rmpc_bench.types.controller import Controller
from rmpc_bench.types.errors import DesignError
from rmpc_bench.types.estimator import Estimator
from rmpc_bench.types.exogenous import InputSignal, Noise, Reference
from rmpc_bench.types.figure import Figure
from rmpc_bench.types.metric import Metric
from rmpc_bench.types.model import Model
from rmpc_bench.types.plant import Plant

BASES: Mapping[str, type] = {
    "plants": Plant,
    "models": Model,
    "estimators": Estimator,
    "controllers": Controller,
    "references": Reference,
    "inputs": InputSignal,
    "noises": Noise,
    "metrics": Metric,
    "figures": Figure,
}
"""Group of the registry -> base class of its components."""

REQUIRED: Mapping[str, tuple[str, ...]] = {
    "plants": ("nx", "nu", "ny", "Ts", "draw", "step", "output"),
    "models": ("at",),
    "estimators": ("init", "correct", "predict"),
    "controllers": ("init", "control"),
    "references": ("sample",),
    "inputs": ("sample",),
    "noises": ("draw",),
    "metrics": ("evaluate",),
    "figures": ("draw",),
}
"""Group of the registry -> attributes and methods that a component must define.

Its methods are marked as abstract for type checkers alone.  A size may be a field of a dataclass, which `abc` does not
see, and a component that lacks one is reported like every other error of a configuration, at its place and with all
names.
"""


def checked(group: str, kind: str, made: Any, provided: Mapping[str, Any]) -> Any:
    """Return a design after checking its class, what it defines, and its sizes where `provided` has them."""
    base = BASES[group]
    name = f"the {group.removesuffix('s')} {kind!r}"
    if not isinstance(made, base):
        found = f"the class {made.__name__}" if isinstance(made, type) else f"an object of type {type(made).__name__}"
        raise DesignError(f"{name} is {found}; a design function must return an instance of {base.__name__}", "kind")
    missing = [each for each in REQUIRED[group] if _is_missing(made, base, each)]
    if missing:
        raise DesignError(f"{name} does not define {', '.join(missing)}", "kind")
    wrong = next(_CHECKS[group](made, provided), None) if group in _CHECKS else None
    if wrong is not None:
        raise DesignError(f"{name}: {wrong}", "kind")
    model: Any = provided.get("model") if group == "estimators" else None
    if not getattr(model, "feedthrough", False):
        return made
    if not cast("Estimator", made).takes_input:
        model.at(0)  # a DesignError where there is no D
    return declaring(made, fed=model)


def undefined_methods(group: str, kind: type) -> list[str]:
    """Return the methods that a class derived from the base class of a group would have to define, and does not."""
    own = vars(BASES[group])
    return [name for name in REQUIRED[group] if isfunction(own.get(name)) and _defined(kind, name) is own[name]]


def _is_missing(made: Any, base: type, name: str) -> bool:
    """Whether a required method or attribute is still the one of the base class, which raises NotImplementedError."""
    is_inherited = name not in vars(made) and _defined(type(made), name) is _defined(base, name)
    # The sizes of a plant are those of its signals if these have names.
    return is_inherited and not (name in ("nx", "nu", "ny") and made.signals is not None)


def _defined(kind: type, name: str) -> Any:
    """Find what a class or one of its bases defines under a name."""
    return next((vars(each)[name] for each in kind.__mro__ if name in vars(each)), None)


def _plant(plant: Plant, provided: Mapping[str, Any]) -> Iterator[str]:
    # Recorded runs may have no state.
    least_nx = 1 if plant.recorded is None else 0
    for name, least in (("nx", least_nx), ("nu", 0), ("ny", 1), ("nw", 0), ("nv", 0)):
        yield from _count(name, getattr(plant, name), least)
    if not (isinstance(plant.Ts, float | int) and plant.Ts > 0.0):
        yield f"Ts must be a positive number of seconds (got {plant.Ts!r})"
    for name, value in plant.nominal.items():
        if not isinstance(value, float | int):
            yield f"the nominal value of {name} must be a number (got {value!r})"


def _model(model: Model, provided: Mapping[str, Any]) -> Iterator[str]:
    for name, least in (("nx", 1), ("nu", 0), ("ny", 1)):
        yield from _count(name, getattr(model, name), least)
    yield from _shape("Q_w", model.Q_w, (model.nx, model.nx))
    yield from _shape("R_v", model.R_v, (model.ny, model.ny))


def _estimator(estimator: Estimator, provided: Mapping[str, Any]) -> Iterator[str]:
    yield from _reports(estimator.reports)
    yield from _count("Ne", estimator.Ne, 0)
    model = provided.get("model")
    if model is None:
        return
    if estimator.x0 is not None:
        yield from _shape("x0", estimator.x0, (model.nx,))
    for name, matrices in (("P", estimator.P), ("M", estimator.M)):
        if matrices is not None:
            yield from _shape(name, matrices, (len(matrices), model.nx, model.nx))
    schedule = estimator.gain_schedule
    if schedule is None:
        return
    n, nu, ny = model.nx, model.nu, model.ny
    for name, matrices, shape in (
        ("F", schedule.F, (n, n)),
        ("B", schedule.B, (n, nu)),
        ("C", schedule.C, (ny, n)),
        ("K", schedule.K, (n, ny)),
        ("L", schedule.L, (n, ny)),
    ):
        yield from _shape(f"{name} of its gain schedule", matrices, (len(matrices), *shape))


def _controller(controller: Controller, provided: Mapping[str, Any]) -> Iterator[str]:
    yield from _reports(controller.reports)
    yield from _count("preview", controller.preview, 0)
    law, model = controller.linear_law(), provided.get("model")
    if law is None or model is None:
        return
    rows = max(controller.preview - 1, 0) * model.ny
    yield from _shape("K_x of its linear law", law.K_x, (model.nu, model.nx))
    yield from _shape("K_u of its linear law", law.K_u, (model.nu, model.nu))
    yield from _shape("K_r of its linear law", law.K_r, (model.nu, rows))
    if law.state is None:
        return
    n, sizes = len(law.state.A_s), (model.nu, model.nx, model.ny)
    for name, matrix, shape in zip(
        law.state._fields,
        law.state,
        ((sizes[0], n), (sizes[0], sizes[2]), (n, n), (n, sizes[1]), (n, sizes[2])),
        strict=True,
    ):
        yield from _shape(f"{name} of the state of its linear law", matrix, shape)


def _reference(reference: Reference, provided: Mapping[str, Any]) -> Iterator[str]:
    if "ny" in provided:
        yield from _shape("sample(2)", reference.sample(2), (2, provided["ny"]))


def _input(signal: InputSignal, provided: Mapping[str, Any]) -> Iterator[str]:
    if "nu" in provided:
        n = min(2, provided.get("n_steps", 2))
        yield from _shape(f"sample([0, 1], {n})", signal.sample([0, 1], n), (2, n, provided["nu"]))


def _noise(noise: Noise, provided: Mapping[str, Any]) -> Iterator[str]:
    n = provided.get("ny" if noise.alters_output else "n")
    if n is None:
        return
    yield from _shape("a draw of 2 samples", noise.draw(np.random.Generator(np.random.PCG64(0)), 2), (2, n))
    if noise.mean is not None:
        yield from _shape("mean", noise.mean, (n,))
    if noise.cov is not None:
        yield from _shape("cov", noise.cov, (n, n))


_CHECKS: Mapping[str, Callable[[Any, Mapping[str, Any]], Iterator[str]]] = {
    "plants": _plant,
    "models": _model,
    "estimators": _estimator,
    "controllers": _controller,
    "references": _reference,
    "inputs": _input,
    "noises": _noise,
}


def _count(name: str, value: Any, least: int) -> Iterator[str]:
    if not isinstance(value, int | np.integer) or value < least:
        yield f"{name} must be an integer of {least} or more (got {value!r})"


def _shape(name: str, value: Any, shape: tuple[int, ...]) -> Iterator[str]:
    if np.shape(value) != shape:
        yield f"{name} has shape {np.shape(value)}; {shape} fits"


def _reports(reports: Mapping[str, tuple[int, ...]]) -> Iterator[str]:
    for name, shape in reports.items():
        if not isinstance(shape, tuple) or not all(isinstance(size, int | np.integer) for size in shape):
            yield f"reports must map {name!r} to the shape of the entry of one run, a tuple (got {shape!r})"
