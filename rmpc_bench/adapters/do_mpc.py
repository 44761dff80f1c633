"""do-mpc: its MPC and MHE as single-run components; a function of the user makes and configures the object.

The object of a run is new.  `reset_history` of do-mpc keeps the last input, the last solution and the multipliers, so
that the next run would depend on this one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rmpc_bench.adapters.do_mpc_mhe import MheEstimator
from rmpc_bench.adapters.do_mpc_model import do_mpc_model
from rmpc_bench.adapters.do_mpc_mpc import MpcController
from rmpc_bench.adapters.do_mpc_setup import quiet
from rmpc_bench.components.designs import class_around

__all__ = ["do_mpc_controller", "do_mpc_estimator", "do_mpc_model"]


def do_mpc_controller(function: Callable[..., Any] | None = None, **declared: Any) -> Any:
    """Turn a function that returns a `do_mpc.controller.MPC` into a controller.

    Parameters
    ----------
    function : its arguments are standard names and keys; the MPC may be set up or, better, not yet.  A time-varying
        parameter ``r`` of its model is the reference
    declared : attributes of the class, such as ``deviation=True``

    Returns
    -------
    A single-run class with the additional key `preview`.
    """
    return class_around(MpcController, function and quiet(function), **declared)


def do_mpc_estimator(function: Callable[..., Any] | None = None, **declared: Any) -> Any:
    """Turn a function that returns a `do_mpc.estimator.MHE` into an estimator.

    Parameters
    ----------
    function : its arguments are standard names and keys; the MHE may be set up or, better, not yet
    declared : attributes of the class, such as ``deviation=True``

    Returns
    -------
    A single-run class; x_hat(0) is x0, since do-mpc has no measurement beside the first state.
    """
    return class_around(MheEstimator, function and quiet(function), **declared)
