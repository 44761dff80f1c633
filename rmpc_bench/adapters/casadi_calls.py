"""CasADi functions called as the functions of a user are: with numbers of a run, rows of a block, or symbols."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.extras import library
from rmpc_bench.types import Array, SolverError


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
    """Return the message of an error of CasADi without the places in its own source.

    Examples
    --------
    >>> reason(RuntimeError(".../casadi/core/options.cpp:255: Unknown option: reltoll"))
    'Unknown option: reltoll'
    """
    lines = re.split(r"\S+\.[ch]pp:\d+: ", str(error))[-1].strip().splitlines()
    return next((line.strip() for line in lines if not line.endswith("failed:")), "")
