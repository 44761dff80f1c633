"""`plant`, `model`, `estimator` and `controller` of a program: designs by their names, checked as in a configuration.

Values of keys pass the checks of `component`.  What the bench provides to a configuration, such as `model`, `n_steps`
and `x0`, is an argument here, and is checked as the keys `time` and `initial` are.  Every mistake is a `DesignError`
(a ValueError) with the name of the argument.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import BaseModel

from rmpc_bench import registry
from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.components.designs import is_built_in, registered_design
from rmpc_bench.components.user_class import MEANINGS
from rmpc_bench.config_file.component import plain_data, read_component
from rmpc_bench.config_file.keys import PROVIDED, PROVIDED_TO_OWN, keys_of, validate
from rmpc_bench.config_file.tree import Map, Mark, Problems
from rmpc_bench.simulation.scenario import initial_covariance, initial_state
from rmpc_bench.types import ConfigError, Controller, DesignError, Estimator, Matrix, Model, Plant, PlantInfo, Positive
from rmpc_bench.types.basics import Steps
from rmpc_bench.types.errors import Problem, unknown

_HERE = Mark("", 1, 1)  # place of a value in a program: its text counts from the current directory
_CLASSES: Mapping[str, tuple[type, str]] = {
    "model": (Model, "a design model, such as LinearModel(A, B, C, Q_w, R_v) or model(kind, ..)"),
    "estimator": (Estimator, "an estimator, such as estimator(kind, ..)"),
    "plant": (Plant, "a plant, such as plant(kind, ..)"),
    "plant_info": (PlantInfo, "a plant"),
}  # argument -> its class, and what is valid
_NUMBERS: Mapping[str, tuple[Any, Callable[[Any, int], Any]]] = {
    "x0": (float | list[float], initial_state),
    "P0": (Matrix, initial_covariance),
    "M0": (Matrix, initial_covariance),
}  # argument of an estimator -> annotation of a short form, and what expands it to the size of the model


def plant(kind: str, *args: Any, **parameters: Any) -> Plant:
    """Design a plant by its name; a mistake is a `DesignError`, a ValueError.

    Examples
    --------
    >>> plant("servo-linear", Ts=0.1).nx
    4
    """
    return cast("Plant", _made("plants", kind, args, parameters))


def model(kind: str, *args: Any, **parameters: Any) -> Model:
    """Design a model by its name.

    Examples
    --------
    >>> model("linear", n_steps=100, A=[[0.9]], C=[[1.0]], P_w=0.1, P_v=0.2).nx
    1
    """
    return cast("Model", _made("models", kind, args, parameters))


def estimator(kind: str, *args: Any, **parameters: Any) -> Estimator:
    """Design an estimator by its name.

    `x0` is a number, for all states, or one per state; `P0` and `M0` are numbers, diagonals or matrices.  Without
    `n_steps`, `filter_data` takes the estimator, and the number of samples from the data.

    Examples
    --------
    >>> from rmpc_bench import LinearModel
    >>> estimator("kalman", LinearModel(0.9, [[1]], [[1]], 0.01, 0.04), n_steps=5, x0=0, P0=1).form
    'filter'
    """
    if len(args) < 2 and "n_steps" not in parameters and registry.is_known("estimators", kind):
        if "n_steps" in inspect.signature(registered_design("estimators", kind)).parameters:
            return UnsizedEstimator(partial(estimator, kind, *args, **parameters))
    return cast("Estimator", _made("estimators", kind, args, parameters))


class UnsizedEstimator(Estimator):
    """An estimator whose number of control periods is that of the data to come."""

    def __init__(self, sized: Callable[..., Estimator]) -> None:
        self._sized = sized
        # A mistake is reported at once.
        self.sized(1)

    def sized(self, n_steps: int) -> Estimator:
        """Return the estimator for a number of control periods."""
        return self._sized(n_steps=n_steps)

    def init(self, *given: Any, **named: Any) -> Any:
        """Refuse every call: only `filter_data` knows how many samples there are."""
        raise DesignError("'n_steps' is missing (number of control periods): give it to `estimator`", "n_steps")

    correct = predict = init


def controller(kind: str, *args: Any, **parameters: Any) -> Controller:
    """Design a controller by its name.

    `plant_info` is the plant whose limits the law is to have, `model` also a discrete `StateSpace` of python-control.

    Examples
    --------
    >>> from rmpc_bench import LinearModel
    >>> controller("mpc", LinearModel(0.9, [[1]], [[1]], 0.01, 0.04), Hp=20, Hu=5, Q=1.0, R=0.1).preview
    21
    """
    return cast("Controller", _made("controllers", kind, args, parameters))


def _made(group: str, kind: str, args: tuple[Any, ...], given: dict[str, Any]) -> Any:
    """Return the checked design; a DesignError with all problems."""
    if not isinstance(kind, str) or not registry.is_known(group, kind):
        raise DesignError(f"kind: {registry.unknown_kind(str(kind), group)}", "kind")
    problems, design = Problems(), registered_design(group, kind)
    named = _by_name(inspect.signature(design), args, given, problems)
    own = frozenset() if is_built_in(group, kind) else PROVIDED_TO_OWN.get(group, frozenset())
    names = PROVIDED[group] | own
    provided = _provided(group, {name: value for name, value in named.items() if name in names}, design, problems)
    keys = _as_written(keys_of(group, kind, design), {n: value for n, value in named.items() if n not in names})
    tree = Map({"kind": kind, **keys}, mark=_HERE)
    component = problems.tried(read_component, group, tree, [], mark=_HERE, access=CodeAccess(Path.cwd()))
    made = None
    if component is not None and not problems:
        # Exceptions of a component of the user stay what they are.
        is_own = not component.is_built_in
        made = component.made(provided) if is_own else problems.tried(component.build, **provided)
    if problems:
        lines = [each.message if each.file or each.path in ("", "kind") else str(each) for each in problems]
        text = "; ".join(dict.fromkeys(lines))
        raise DesignError(f"{registry.singular(group)} {kind!r}: {text}", problems[0].path)
    return made


def _by_name(
    signature: inspect.Signature, args: tuple[Any, ...], given: Mapping[str, Any], problems: Problems
) -> dict[str, Any]:
    """Return all arguments by their names; those that are unknown, given twice or missing are problems."""
    every = signature.parameters.items()
    known = {name: each for name, each in every if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)}
    places = [name for name, each in known.items() if each.kind is not each.KEYWORD_ONLY]

    def note(name: str, message: str) -> None:
        problems.append(Problem(*_HERE, name, message))

    if len(args) > len(places):
        note("", f"takes at most {len(places)} arguments without a name: {', '.join(places)} (got {len(args)})")
    named = dict(zip(places, args, strict=False))
    aliases = {name.rstrip("_"): name for name in known}
    for name, value in given.items():
        if aliases.get(name.rstrip("_")) is None:
            note("", unknown(name, aliases, "argument"))
        elif name in named:
            note(name, "is given twice, with and without its name")
        else:
            named[aliases[name.rstrip("_")]] = value
    for name, each in known.items():
        if each.default is each.empty and name not in named:
            meaning = f" ({MEANINGS[name]})" if name in MEANINGS else ""
            note("", f"{name!r} is missing{meaning}")
    return named


def _as_written(keys: type[BaseModel], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return values as a configuration would have them, arrays as lists; those of any type stay as they are."""
    found = {}
    for name, value in given.items():
        field = keys.model_fields.get(name)
        kind: Any = None if field is None else field.annotation
        is_open = kind is Any or isinstance(kind, type) and not issubclass(kind, BaseModel | int | float | str)
        found[name.rstrip("_")] = value if is_open else plain_data(value)
    return found


def _provided(group: str, given: dict[str, Any], design: Callable[..., Any], problems: Problems) -> dict[str, Any]:
    """Check what the bench provides to a configuration; None that is the default stays."""
    parameters = inspect.signature(design).parameters
    left = {name: value for name, value in given.items() if value is not None or parameters[name].default is not None}
    for name, annotation in (("n_steps", Steps), ("Ts", Positive)):
        if name in left:
            left[name] = problems.tried(validate, annotation, plain_data(left[name]), [name], mark=_HERE)
    if isinstance(left.get("plant_info"), Plant):
        left["plant_info"] = PlantInfo.of(left["plant_info"])
    for name, (kind, valid) in _CLASSES.items():
        if name in left and not isinstance(left[name], kind):
            left[name] = problems.tried(_at, name, _converted, group, left[name], valid)
    for name in _NUMBERS if isinstance(left.get("model"), Model) else ():
        if name in left:
            left[name] = problems.tried(_at, name, _sized, name, left[name], left["model"].nx)
    return {**given, **left}


def _at(name: str, convert: Callable[..., Any], *given: Any) -> Any:
    """Convert an argument; a DesignError becomes an error at its name."""
    try:
        return convert(*given)
    except DesignError as error:
        raise ConfigError([Problem(*_HERE, name, str(error))]) from None


def _converted(group: str, value: Any, valid: str) -> Any:
    """Return a system of python-control as the design model of a controller; a DesignError for anything else."""
    if type(value).__module__.partition(".")[0] != "control":
        raise DesignError(f"must be {valid} (got {type(value).__name__})")
    way_out = "model('control', Ts=.., control=system, noise={'process': .., 'measurement': ..})"
    if group != "controllers":
        raise DesignError(f"a {type(value).__name__} has no covariances of the noises; write {way_out}")
    if value.dt is None or value.dt is True or not value.dt > 0:
        raise DesignError(f"must have a sampling time (got dt = {value.dt}); sample it with control.c2d")
    return model("control", Ts=value.dt, control=value, noise={"process": 0.0, "measurement": 0.0})


def _sized(name: str, value: Any, n: int) -> Any:
    """Expand a start of the estimator to the size of the model."""
    annotation, expand = _NUMBERS[name]
    # The numbers of an array are checked with its shape, which takes less time than one after the other.
    if not (isinstance(value, np.ndarray) and value.dtype.kind in "fiu"):
        value = validate(annotation, plain_data(value), [name], mark=_HERE)
    return expand(value, n)
