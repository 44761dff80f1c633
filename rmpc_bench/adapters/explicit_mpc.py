"""Explicit MPC: a piecewise affine law that was computed before the run, by any code for multiparametric programs.

Law     u(k) = the first entries of A theta + b in the region E theta <= f, with theta = [x_hat(k); u(k-1); r(k); ..].
        Regions are objects with the attributes A, b, E and f, as the `critical_regions` of a solution of ppopt are.
Fails   Outside of all regions the run is `infeasible`; a step can be held.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.components.designs import class_around
from rmpc_bench.types import Array, Count, SolverError

OUTSIDE = 1e-8
"""Relative distance up to which a point is inside; rounding may put a point on a facet outside of both neighbours."""


def explicit_controller(function: Callable[..., Any] | None = None, **declared: Any) -> Any:
    """Turn a function that returns the regions of a law into a controller with the further key `preview`.

    Parameters
    ----------
    function : its arguments are standard names and keys; it is called once in every process
    declared : attributes of the class, such as ``deviation=True``
    """
    if function is None:
        return lambda each: explicit_controller(each, **declared)
    asked = signature(function, eval_str=True).parameters.values()

    def prepare(cls: type, /, **given: Any) -> Regions:
        return stacked(function(**given))

    named = [each.replace(kind=Parameter.KEYWORD_ONLY) for each in asked]
    prepare.__signature__ = Signature([Parameter("cls", Parameter.POSITIONAL_ONLY), *named])  # type: ignore[attr-defined]
    keys = wraps(function)(lambda **given: None)
    return class_around(ExplicitController, keys, prepare=classmethod(prepare), **declared)


class Regions(NamedTuple):
    """The regions, stacked: rows of E have length 1; `first` is the first row of every region."""

    A: list[Array]
    b: list[Array]
    E: Array
    f: Array
    first: Array


def stacked(regions: Any) -> Regions:
    """Stack regions with the attributes A, b, E and f."""
    every = [*regions]
    E, f = np.vstack([each.E for each in every]), np.concatenate([np.ravel(each.f) for each in every])
    length = np.where(E.any(axis=1), np.linalg.norm(E, axis=1), 1.0)
    A, b = [each.A for each in every], [np.ravel(each.b) for each in every]
    first = np.cumsum([0, *[len(each.E) for each in every[:-1]]])
    return Regions(A, b, E / length[:, None], f / length, first)


class ExplicitController:
    """The law of one run; `prepared` are its regions, the same for all runs."""

    def __init__(self, made: None, prepared: Regions, model: Any, preview: Count = 1) -> None:
        self.regions, self.u_op, self.n = prepared, model.u_op, prepared.E.shape[1]
        if self.n not in (sizes := np.cumsum([model.nx, model.nu, model.ny * preview])):
            raise ValueError(f"the regions have {self.n} parameters; x_hat, u(k-1) and {preview} r have {sizes[-1]}")

    def control(self, x_hat: Array, u_previous: Array | None, r: Array) -> Array:
        """Return u(k) of the region that contains theta."""
        theta = np.concatenate([x_hat, self.u_op if u_previous is None else u_previous, np.ravel(r)])[: self.n]
        outside = np.maximum.reduceat(self.regions.E @ theta - self.regions.f, self.regions.first)
        j = int(outside.argmin())
        if not outside[j] <= OUTSIDE * (1.0 + np.abs(theta).max()):
            raise SolverError(f"theta is outside of all regions, by {outside[j]:.3g}", infeasible=True)
        return np.asarray(self.regions.A[j] @ theta + self.regions.b[j])[: len(self.u_op)]
