"""CasADi functions of a nonlinear design model, for controllers and estimators that optimise with CasADi.

Method  The user's functions rhs and output are called with CasADi symbols.  x(k+1) takes the same steps of the
        Runge-Kutta method as f of the model with `substeps`.  Without them it takes half of the largest number of
        steps per sample in the trial runs of the plant, at most 50, or 10 where it is not known.  About half of the
        steps of error control are kept; the others estimate the error.
Limit   The functions use arithmetic and functions of NumPy that CasADi knows.  ``if x[0] > 0`` is an error for a
        symbol; ``math.sin`` of a symbol is NaN without an error.  Therefore the numbers are compared with the model's.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from rmpc_bench.extras import library
from rmpc_bench.models.dynamics import OUTSIDE_DOMAIN, LinearDynamics, OdeDynamics
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.numerics.integration import EDGE
from rmpc_bench.types import Array, DesignError, SolverError

TRIALS = 20
"""States and inputs at which the functions are compared."""
AGREES = 1e-9
"""Largest difference, relative to the largest state: rounding of two implementations of sin or exp."""


def difference(model: NonlinearModel, name: str, made: Callable[..., Array], arguments: Sequence[str]) -> str:
    """Say where a function gives other numbers than that of the model; empty where it does not.

    Both are called at the operating point and at random states and inputs within the bounds of the plant.  Points at
    which the model is not defined are left out.
    """
    rng, signals = np.random.Generator(np.random.PCG64(5)), model.dynamics.signals
    for trial in range(TRIALS):
        size = 10.0 ** rng.uniform(-2.0, 1.0)
        x, u = size * np.abs(rng.standard_normal(model.nx)), rng.standard_normal(model.nu)
        if trial == 0 and model.operating_point is not None:
            x, u = model.operating_point.x, model.operating_point.u
        at: dict[str, Any] = {"x": np.clip(x, *model.limits), "u": np.clip(u, *signals.limits(signals.inputs))}
        given = [{**at, "k": trial}[each] for each in arguments]
        try:
            with np.errstate(all="ignore"):
                wanted: Array = getattr(model, name)(*given)
        except OUTSIDE_DOMAIN:
            continue
        found, largest = made(*given), max(np.abs(at["x"]).max(), np.abs(wanted).max())
        if np.isfinite(wanted).all() and not (np.abs(found - wanted) <= AGREES * largest).all():
            return f"{found.tolist()} instead of {wanted.tolist()} at x = {at['x'].tolist()}"
    return ""


class CasadiFunction:
    """A `casadi.Function` of dense columns t, x, u and p, called with the arguments `shown`; p is one column.

    Those without an input have no effect.  With `alone` every run is computed by itself: an integrator may fail in one.
    """

    def __init__(self, function: Any, names: tuple[str, ...], shown: tuple[str, ...], *, alone: bool = False) -> None:
        kind = inspect.Parameter.POSITIONAL_ONLY
        self.function, self.names, self.shown, self.alone = function, names, shown, alone
        self.__name__ = function.name()
        self.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in shown])
        self._of_size: dict[int, BlockCall] = {}

    def __call__(self, *arguments: Any) -> Any:
        """Return (n,), (n, runs) of a block, or a CasADi column of symbols; a SolverError where a solver fails."""
        given = self._by_name(arguments)
        x = given["x"]
        if x.dtype == object:
            return self.function(*(library("casadi").vcat(list(given[name])) for name in self.names))
        if self.alone and x.ndim > 1:
            raise TypeError("an integrator of CasADi computes one run at a time")
        n = x.shape[1] if x.ndim > 1 else 1
        if n not in self._of_size:
            self._of_size[n] = BlockCall(self.function, n)
        return self._of_size[n](self.names, given, block=x.ndim > 1).T.reshape(-1, *x.shape[1:]).copy()

    def jacobian(self, *arguments: Any) -> list[Array]:
        """Return the exact derivatives by x and, where the function has it as an input, by u."""
        casadi, given = library("casadi"), self._by_name(arguments)
        symbols = {name: casadi.MX.sym(name, self.function.size1_in(i)) for i, name in enumerate(self.names)}
        values = self.function(*symbols.values())
        wanted = [casadi.jacobian(values, symbols[name]) for name in ("x", "u") if name in symbols]
        found = casadi.Function("derivatives", [*symbols.values()], wanted).call([given[name] for name in self.names])
        return [np.array(each.full()) for each in found]

    def _by_name(self, arguments: tuple[Any, ...]) -> dict[str, Any]:
        given = dict(zip(self.shown, arguments, strict=True))
        columns = {"p": [given["p"][name] for name in given["p"]]}
        return {**given, **columns, "t": [given["t"]]} if "t" in given else {**given, **columns}

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without memory that belongs to this process."""
        return {**vars(self), "_of_size": {}}


class BlockCall:
    """``function.map(runs)``, which gives the same bits as a call per run.

    Numbers pass through the memory of `Function.buffer`: conversions of CasADi would take most of the time.
    """

    def __init__(self, function: Any, n: int) -> None:
        self.name = function.name()
        self.buffer, self.evaluate = function.map(n).buffer()
        self.inputs = [np.zeros((n, function.size1_in(i))) for i in range(function.n_in())]
        self.result = np.zeros((n, function.size1_out(0)))
        for i, each in enumerate(self.inputs):
            self.buffer.set_arg(i, each.data)
        self.buffer.set_res(0, self.result.data)

    def __call__(self, names: tuple[str, ...], given: Mapping[str, Any], *, block: bool) -> Array:
        """Return a row of results per run of numbers or, with `block`, of rows over the runs; p has a list of them."""
        for name, each in zip(names, self.inputs, strict=True):
            columns = each.T if block else each[0]
            if name == "p":
                for i, value in enumerate(given[name]):
                    columns[i] = value
            else:
                columns[...] = given[name]
        try:
            self.evaluate()
        except RuntimeError as error:
            raise SolverError(f"{self.name}: {reason(error)}") from error
        if self.buffer.ret():
            # The rows after the one that has failed are not computed.
            raise SolverError(f"{self.name}: a solver of CasADi has failed")
        return self.result


def reason(error: BaseException) -> str:
    """Return the message of an error of CasADi without the places in its own source."""
    lines = re.split(r"\S+\.[ch]pp:\d+: ", str(error))[-1].strip().splitlines()
    return next((line.strip() for line in lines if not line.endswith("failed:")), "")


EQUAL_STEPS = 10
"""Steps per sample where the plant has no trial runs."""
WAY_OUT = "use arithmetic and functions of NumPy, such as np.where for `if` and np.sin for math.sin"


def step_function(model: NonlinearModel) -> Any:
    """Return x(k+1) of a nonlinear design model as ``casadi.Function(x, u)``; (x, u, k) if rhs depends on the time."""
    dynamics, Ts = model.dynamics, model.Ts
    if isinstance(dynamics, LinearDynamics):
        return traced(model, "f", lambda x, u: x + (dynamics.A @ x + dynamics.B @ u - x), ("x", "u"))
    assert isinstance(dynamics, OdeDynamics), "there are no other plants as functions"
    ode, p = dynamics.ode, dynamics.ode.p
    # A graph has a fixed number of steps.
    model = replace(model, substeps=model.substeps or ode.equal_steps or EQUAL_STEPS)
    n, h = model.substeps, Ts / model.substeps

    def slope(t: Any, x: Any, u: Any) -> Any:
        return entries(ode.rhs(t, x, u, p) if ode.timed else ode.rhs(x, u, p))

    def step(x: Any, u: Any, k: Any = (0,)) -> Any:
        if ode.discrete:
            return slope(k[0] * Ts, x, u)
        for j in range(n):
            first, middle, last = ((k[0] + part) * Ts for part in (max(j / n, EDGE), (j + 0.5) / n, (j + 1) / n))
            last = (k[0] + 1 - EDGE) * Ts if j == n - 1 else last
            k1 = slope(first, x, u)
            k2 = slope(middle, x + h / 2 * k1, u)
            k3 = slope(middle, x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * (k2 + k3) + slope(last, x + h * k3, u))
        return x

    return traced(model, "f", step, ("x", "u", "k") if ode.timed else ("x", "u"))


def output_function(model: NonlinearModel) -> Any:
    """Return y of a nonlinear design model as ``casadi.Function(x)``."""
    model.refuse_feedthrough("CasADi")
    dynamics = model.dynamics
    if isinstance(dynamics, LinearDynamics):
        return traced(model, "h", lambda x: dynamics.C @ x, ("x",))
    return traced(model, "h", lambda x: x if model.output is None else model.output(x, model.p), ("x",))


@contextmanager
def numpy_functions() -> Iterator[None]:
    """Let functions of NumPy take and return CasADi symbols; since CasADi 3.8 they warn of it otherwise."""
    options = library("casadi").GlobalOptions
    before = options.getNumpyMode() if hasattr(options, "getNumpyMode") else None
    try:
        if before is not None:
            options.setNumpyMode(-1)
        yield
    finally:
        if before is not None:
            options.setNumpyMode(before)


def entries(values: Any) -> Any:
    """Return what a function has returned as an array of its entries; a CasADi matrix is taken column by column."""
    is_matrix = hasattr(values, "is_dense")
    found = library("casadi").vertsplit(values) if is_matrix else list(values) if np.iterable(values) else [values]
    made = np.empty(len(found), dtype=object)
    for i, each in enumerate(found):
        made[i] = each
    return made


def traced(model: NonlinearModel, name: str, function: Callable[..., Any], arguments: tuple[str, ...]) -> Any:
    """Return a function called with symbols as `casadi.Function`; its values are compared with those of the model."""
    casadi, sizes = library("casadi"), {"x": model.nx, "u": model.nu, "k": 1}
    symbols = [casadi.SX.sym(each, sizes[each]) for each in arguments]
    users = "rhs" if name == "f" else "output"
    try:
        with numpy_functions():
            found = entries(function(*(entries(each) for each in symbols)))
            result = casadi.vcat([each if hasattr(each, "is_dense") else float(each) for each in found])
            made = casadi.Function(name, symbols, [result], [*arguments], ["x_next" if name == "f" else "y"])
    # The function is the user's: it may raise anything.
    except Exception as error:
        what = f"{type(error).__name__}: {reason(error)}"
        raise DesignError(f"{users} cannot be called with CasADi symbols ({what}); {WAY_OUT}") from error
    values = difference(model, name, lambda *given: np.ravel(made(*given).full()), arguments)
    if values:
        raise DesignError(f"{users} called with CasADi symbols gives {values}; {WAY_OUT}")
    return made
