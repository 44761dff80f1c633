"""From what a user has written to a design function: single-run components, batch classes and functions.

A *single-run component* is a class or a function marked with `single_run`.  A method gets the arguments that its
signature names:

=============  ====================================================================================================
estimator      ``update(y, u_previous)``, or ``predict(u)`` and ``correct(y)``: return x_hat, (x_hat, P) or
               (x_hat, P, {"name": number}).  `predict` gets u(k-1), before `correct` gets y(k).
controller     ``control(x_hat, r)``: return u, or (u, {"name": number}).
plant          ``step(u, w)``: return x(k+1); ``output(x)``: return y(k) without measurement noise.  A `step` that
               has no argument ``w`` has no process noise; an `output` with ``v`` adds the noise itself.
metric         ``evaluate(y, u, r)``: return one number; the arguments are trajectories with axis 0 = k.
=============  ====================================================================================================

`start` is called once before the first sample.  There is one object per run and method.  An estimator or a controller
with ``deviation = True`` works in deviations from the operating point of the design model.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

from rmpc_bench.components.user_class import (
    COMMON_KEYS,
    HELD,
    METHODS,
    UserClass,
    a_component,
    methods_of,
    metric_design,
    user_class,
)
from rmpc_bench.types import DesignError
from rmpc_bench.types.contract import BASES

MARK = "__rmpc_bench_single_run__"
Marked = TypeVar("Marked", bound=Callable[..., Any])


def single_run(component: Marked) -> Marked:
    """Mark a class as a component written for one run; a law without memory or a metric may be a function.

    Parameters
    ----------
    component : a class with `update` (or `predict` and `correct`), `control`, `step` and `output`, or `evaluate`

    Returns
    -------
    The same class.

    Examples
    --------
    >>> @single_run
    ... class Proportional:
    ...     def __init__(self, K: float = 2.0):
    ...         self.K = K
    ...     def control(self, x_hat, r):
    ...         return self.K * (r - x_hat)
    >>> Proportional(K=3.0).control(1.0, 2.0)
    3.0
    """
    if not callable(component):
        raise DesignError(f"single_run marks a class or a function (got {component!r:.60})")
    setattr(component, MARK, component)
    return component


def is_single_run(component: Any) -> bool:
    """Whether a class or function itself is marked; a class derived from a marked one counts as marked, too."""
    marked = getattr(component, MARK, None)
    return marked is not None and (marked is component or isinstance(component, type))


def design_function(group: str, component: Any) -> Callable[..., Any]:
    """Return the design function of a component, whose signature gives the keys of the configuration."""
    if is_single_run(component):
        return _single_run_design(group, component)
    if isinstance(component, type):
        if not issubclass(component, BASES[group]):
            raise DesignError(_not_marked(group, component), "kind")
        return metric_design(component) if group == "metrics" else component
    if callable(component):
        return cast("Callable[..., Any]", component)
    found = type(component).__name__
    raise DesignError(f"{a_component(group)} is a class or a function; this is an object of type {found}", "kind")


def _not_marked(group: str, component: type) -> str:
    base, noun = BASES[group].__name__, group.removesuffix("s")
    other = next((each for each, kind in BASES.items() if issubclass(component, kind)), None)
    if other is not None:
        other_base = BASES[other].__name__
        article = "an" if other_base[0] in "AEIOU" else "a"
        return f"{component.__qualname__} is {article} {other_base}, no {noun}"
    if methods_of(group, component):
        return (
            f"{component.__qualname__} is not marked: write @single_run above the class if it is written for one run, "
            f"or derive it from rmpc_bench.{base} if axis 0 of its arrays is the run"
        )
    return f"{component.__qualname__} is no {noun}: mark it with @single_run, or derive it from rmpc_bench.{base}"


def _single_run_design(group: str, component: Any) -> Callable[..., Any]:
    if group not in METHODS:
        known = ", ".join(METHODS)
        raise DesignError(f"single_run marks {known}; {group} are written as classes or functions without it", "kind")
    user = user_class(group, component)
    signature = user.signature()

    def design(*args: Any, **keywords: Any) -> Any:
        bound = signature.bind(*args, **keywords)
        bound.apply_defaults()
        return _made(user, bound.arguments)

    design.__signature__ = signature  # type: ignore[attr-defined]
    design.__doc__ = _documented(inspect.getdoc(component) or "", user)
    design.__name__, design.__qualname__ = component.__name__, component.__qualname__
    design.__module__ = component.__module__
    init = getattr(component, "__init__", None) if isinstance(component, type) else component
    if inspect.isfunction(init):
        # Annotations written as text are evaluated in the module of the function that has them.
        design.__wrapped__ = init  # type: ignore[attr-defined]
    return design


def _documented(text: str, user: UserClass) -> str:
    """Add the common keys to the parameters of a docstring."""
    heading = "Parameters\n----------\n"
    if user.group not in HELD:
        return text
    entries = "".join(f"{name} : {meaning}\n" for name, meaning in COMMON_KEYS.items())
    before, found, after = text.partition(heading)
    return f"{before}{found}{entries}{after}" if found else f"{text}\n\n{heading}{entries}"


def _made(user: UserClass, given: Mapping[str, Any]) -> Any:
    # The designs are imported here, so that a file with a marked class is loaded without NumPy's companions.
    if user.group == "estimators":
        from rmpc_bench.components.single_estimator import SingleRunEstimator

        return SingleRunEstimator(user, given)
    if user.group == "controllers":
        from rmpc_bench.components.single_controller import SingleRunController

        return SingleRunController(user, given)
    if user.group == "plants":
        from rmpc_bench.components.single_plant import SingleRunPlant

        return SingleRunPlant(user, given)
    from rmpc_bench.components.single_controller import SingleRunMetric

    keys = {name: value for name, value in given.items() if name in user.keys}
    return SingleRunMetric(name=given["name"], user=user, keys=keys)
