"""do-mpc: what its MPC and its MHE have in common."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any
from warnings import catch_warnings, filterwarnings, simplefilter

from rmpc_bench.extras import library
from rmpc_bench.types import SolverError


def do_mpc_library() -> Any:
    """Import do-mpc without its warnings about optional features that are not installed."""
    with catch_warnings():
        simplefilter("ignore")
        return library("do-mpc")


def quiet(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls another one, in which do-mpc gives no warning that a user cannot avoid."""

    @wraps(function)
    def called(*args: Any, **keys: Any) -> Any:
        do_mpc_library()
        with catch_warnings():
            # do-mpc 5.1 calls functions of NumPy with CasADi numbers, of which CasADi 3.8 warns.
            filterwarnings("ignore", r"\s*casadi: a numpy function", FutureWarning)
            return function(*args, **keys)

    return called


@quiet
def set_up(made: Any, Ts: float) -> None:
    """Set up an MPC or an MHE where the user's function has not, without output of the solver."""
    if made.settings.t_step not in (None, Ts):
        raise ValueError(f"settings.t_step of do-mpc is {made.settings.t_step}; the sampling time is {Ts}")
    if made.settings.n_horizon is None:
        raise ValueError("settings.n_horizon of do-mpc is not set")
    if made.flags["setup"]:
        return
    made.settings.t_step = Ts
    if not made.flags["MINLP"]:  # integer inputs have another solver
        made.settings.supress_ipopt_output()
    if "set_y_fun" in made.flags:
        made.settings.meas_from_data = True
    if not made.flags["set_tvp_fun"]:
        template = made.get_tvp_template()
        made.set_tvp_fun(lambda t: template)
    if not made.flags.get("set_rterm", True):
        made.set_rterm()  # otherwise do-mpc waits two seconds in every run, to warn
    made.setup()


def refuse_other_order(model: Any, info: Any) -> None:
    """Refuse variables of a do-mpc model that have the names of signals of the plant in another order."""
    outputs = [name for name in model._y.keys() if f"{name}_noise" in model._v.keys()]
    for noun, own in (("states", [*model._x.keys()]), ("inputs", [*model._u.keys()]), ("outputs", outputs)):
        own, names = [name for name in own if name != "default"], [*getattr(info, noun, own)]
        if own != names and sorted(own) == sorted(names):
            text = f"{noun} of the do-mpc model: {', '.join(own)}; they need the order of the plant: {', '.join(names)}"
            raise ValueError(text)


def shorten_history(made: Any) -> None:
    """Keep the last samples only: the history is copied at every step, and would grow with the length of the run."""
    data = made.data
    for name in data.data_fields:
        setattr(data, name, getattr(data, name)[-made.settings.n_horizon :])


def checked_solution(made: Any) -> None:
    """Raise a SolverError where the solver has found no solution; do-mpc returns its last iterate."""
    if not made.solver_stats["success"]:
        status = str(made.solver_stats["return_status"])
        raise SolverError(f"the solver of do-mpc: {status}", infeasible=status == "Infeasible_Problem_Detected")
