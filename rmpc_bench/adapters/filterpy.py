"""Filters of filterpy, and other objects with `predict` and `update`, as estimators of single runs.

A filter computes what filterpy computes.  Sigma points, zero before the first `predict`, are computed from x0 and P0,
for y(0) comes first.  An ensemble draws from the generator of its run.  u and y are columns where x is one: otherwise
NumPy makes an n x n state without an error.  With ``on_failure: hold`` a prediction that has failed is made with the
next one.  `mu` of an `IMMEstimator` has the modes one sample before y(0).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from inspect import Parameter, signature
from typing import Any
from warnings import warn

import numpy as np

from rmpc_bench.components.designs import class_around
from rmpc_bench.components.user_runs import drawing_from
from rmpc_bench.extras import library

SET_MATRICES = "set F = model.A and B = model.B, or derive a class whose predict_x(u) sets F and x"


def filterpy_estimator(function: Callable[..., Any] | None = None, /, **declared: Any) -> Any:
    """Make a single-run estimator of a function that returns a new filter.

    Parameters
    ----------
    function : takes x0 and P0, at which the filter starts, further standard names and keys; it returns the filter, or
        the filter and further arguments of its `update`, such as ``ekf, {"HJacobian": model.H, "Hx": model.h}``
    declared : attributes of the class, such as ``deviation=True``
    """
    return class_around(FilterpyEstimator, function, needs=("x0", "P0"), **declared)


class FilterpyEstimator:
    """Runs a filter: `update` with y(0), then `predict` with u(k-1) and `update` with y(k)."""

    returns = "a filter with `predict` and `update`, or the filter and a mapping of arguments of its `update`"

    @staticmethod
    def fits(made: Any) -> bool:
        """Whether a function has returned a filter."""
        first, further = made if isinstance(made, tuple) and len(made) == 2 else (made, {})
        return hasattr(first, "predict") and hasattr(first, "update") and isinstance(further, Mapping)

    @staticmethod
    def owned(made: Any) -> list[Any]:
        """Return the objects that no other run may have: the filter and those of a bank."""
        first = made[0] if isinstance(made, tuple) else made
        return [first, *getattr(first, "filters", ())]

    def __init__(self, made: Any, model: Any, x0: Any, P0: Any, rng: np.random.Generator, Ts: Any = None) -> None:
        self.filter, further = made if isinstance(made, tuple) else (made, {})
        self._update: Callable[..., Any] = partial(self.filter.update, **further)
        self._inputs: list[Any] = []
        for each in (*getattr(self.filter, "filters", ()), self.filter):
            self._predict = _predict_of(each, model, in_bank=each is not self.filter)
            _refuse_ignored_measurement(each, further)
            dt = getattr(each, "_dt", getattr(each, "dt", Ts))
            other = [f"has dt = {dt}, the sampling time is {Ts} s"] if None not in (dt, Ts) and dt != Ts else []
            for text in (*_kept_defaults(each, model, x0, P0, further), *other):
                warn(f"{type(each).__name__} {text}", stacklevel=2)
            if hasattr(each, "points_fn"):
                each.sigmas_f = each.points_fn.sigma_points(each.x, each.P)
            elif hasattr(each, "sigmas_f"):  # cubature points; the state is a column after `predict`
                each.x = np.reshape(each.x, (-1, 1))
                each.sigmas_f = library("filterpy", "kalman").spherical_radial_sigmas(each.x, each.P)
        if hasattr(self.filter, "sigmas"):  # an ensemble
            self._predict, self._update = drawing_from(rng, self._predict), drawing_from(rng, self._update)
        self._is_column = np.ndim(self.filter.x) == 2
        self._gives_P = hasattr(self.filter, "P") and not _is_h_infinity(self.filter)

    def update(self, y: Any, u_previous: Any) -> Any:
        """Return x_hat(k) and, where the filter has it, P; a prediction that has failed is made with the next one."""
        if u_previous is not None:
            self._inputs.append(u_previous[:, None] if self._is_column else u_previous)
        while self._inputs:
            self._predict(u=self._inputs[0])
            del self._inputs[0]
        self._update(y[:, None] if self._is_column else y)
        x_hat = self.filter.x[:, 0] if self._is_column else self.filter.x
        return (x_hat, self.filter.P) if self._gives_P else x_hat


def _is_h_infinity(made: Any) -> bool:
    return any(each.__module__.startswith("filterpy.hinfinity") for each in type(made).__mro__)


def _refuse_ignored_measurement(made: Any, further: Mapping[str, Any]) -> None:
    """Refuse a filter of filterpy with a matrix of zeros, its default, with which it does not use y."""
    if not type(made).__module__.startswith("filterpy."):
        return
    for name, of_model in (("H", "model.C"), ("V", "model.R_v")):
        matrix = getattr(made, name, None)
        if name not in further and matrix is not None and not np.any(matrix):
            raise ValueError(f"{type(made).__name__} has the default {name} = 0 and ignores y: set {name} = {of_model}")


def _kept_defaults(made: Any, model: Any, x0: Any, P0: Any, further: Mapping[str, Any]) -> Iterator[str]:
    """Say which defaults of filterpy stand in place of numbers of the experiment; each may be meant."""
    if _is_h_infinity(made):
        yield "is not the Kalman filter with gamma = 0: F enters twice; its P is that of k + 1, which is not reported"
    elif type(made).__module__.startswith("filterpy."):
        Q, R = getattr(model, "Q_w", None), getattr(model, "R_v", None)
        inverse = {"P_inv": ("P0", P0), "R_inv": ("model.R_v", R)}
        wanted = {"x": ("x0", x0), "P": ("P0", P0), "Q": ("model.Q_w", Q), "R": ("model.R_v", R), **inverse}
        for name, (text, value) in wanted.items():
            own = getattr(made, name, None)
            if name in further or own is None or value is None or np.size(own) != np.size(value):
                continue
            default = np.zeros(np.size(value)) if name == "x" else np.eye(len(value)).ravel()
            if np.array_equal(np.ravel(own), default) and not np.array_equal(np.ravel(value), default):
                yield f"has the default {name} = {'0' if name == 'x' else 'I'} in place of {text}"


def _predict_of(made: Any, model: Any, in_bank: bool) -> Callable[..., Any]:
    """Return `predict` as a function of the input u; sigma points take it as an argument of `fx`."""
    arguments, name = signature(made.predict).parameters, type(made).__name__
    if in_bank and next(iter(arguments), "u") != "u":
        raise ValueError(f"a bank gives the input to the first argument of {name}.predict: derive one whose first is u")
    if "fx_args" in arguments and (taken := _input_of(made.fx)):
        if arguments["fx_args"].kind is Parameter.VAR_KEYWORD:
            return lambda u: made.predict(**{taken: u})
        if [*signature(made.fx).parameters][2] != taken:
            raise ValueError(f"{name} gives the input to the third argument of fx: make {taken} the third")
        return lambda u: made.predict(fx_args=(u.ravel(),))
    if "u" not in arguments:
        if np.any(getattr(model, "B", 1)):
            raise ValueError(
                f"the input does not reach {name}: give fx the third argument u, or predict the argument u"
            )
        return lambda u: made.predict()
    # A filter of filterpy with F is linear and has no constant parts; a class derived from it may add the rest.
    if type(made).__module__.startswith("filterpy.") and hasattr(made, "F"):
        if not hasattr(model, "A"):
            raise ValueError(f"{name} is linear, the model is not: derive a class whose predict(u) sets F, x and P")
        if np.any(model.f0) or (hasattr(made, "H") and np.any(model.d0)):
            raise ValueError(f"{name} ignores f0 and d0 of the model: write @filterpy_estimator(deviation=True)")
        if np.array_equal(made.F, np.eye(len(model.A))) and not np.array_equal(made.F, model.A):
            raise ValueError(f"{name} has the default F = I and ignores A of the model: {SET_MATRICES}")
        if np.any(model.B) and not np.any(made.B):
            raise ValueError(f"{name} ignores the input: {SET_MATRICES}")
    return made.predict  # type: ignore[no-any-return]


def _input_of(fx: Callable[..., Any]) -> str:
    """Return the argument of fx(x, dt, ..) that is the input: u, or the only one without a default; else ""."""
    further = [*signature(fx).parameters.values()][2:]
    needed = [each.name for each in further if each.default is Parameter.empty]
    return "u" if any(each.name == "u" for each in further) else needed[0] if len(needed) == 1 else ""
