"""A CasADi function for a fixed number of runs, called through memory that is shared with CasADi."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.types import Array, SolverError


class BlockCall:
    """``function.map(runs)``, which gives the same bits as a call per run.

    Numbers pass through the memory of `Function.buffer`: conversions of CasADi would take most of the time.

    Parameters
    ----------
    function : with dense columns as inputs and one dense column as result
    n : number of runs
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
        """Return a row of results per run.

        Parameters
        ----------
        names : of the inputs
        given : name -> numbers or, with `block`, rows over the runs; a list of them for p

        Raises
        ------
        SolverError
            If an integrator or a solver within the function fails.
        """
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
