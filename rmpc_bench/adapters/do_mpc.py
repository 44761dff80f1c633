"""do-mpc: its MPC and MHE as single-run components; a function of the user makes and configures the object.

The object of a run is new, which takes 0.05 to 0.07 s: `reset_history` of do-mpc keeps the last input, solution and
multipliers.  A worker process makes its own objects, as they cannot be sent.  The first move begins at the input of
the operating point, or at 0.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import wraps
from typing import Any
from warnings import catch_warnings, filterwarnings, simplefilter

import numpy as np

from rmpc_bench.components.designs import class_around
from rmpc_bench.extras import library
from rmpc_bench.models.disturbed import DisturbedNonlinear
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.types import Array, Count, DesignError, SolverError

__all__ = ["do_mpc_controller", "do_mpc_estimator", "do_mpc_model"]


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


@quiet
def do_mpc_model(model: Any) -> Any:
    """Return a discrete do-mpc model of a design model, in physical units.

    Parameters
    ----------
    model : a linear model that is the same at all k, or ``{nonlinear: plant}``

    Returns
    -------
    A model with the state ``x``, the input ``u``, the time-varying parameter ``r`` (reference), additive process noise
    and the measurements ``y`` (with noise) and ``u`` (without).  ``model.aux["y"]`` is the output.

    Raises
    ------
    DesignError
        If the model depends on the time, or on functions that CasADi does not know.
    """
    made = do_mpc_library().model.Model("discrete", "SX")
    x, u = (made.set_variable(f"_{name}", name, shape=(n, 1)) for name, n in (("x", model.nx), ("u", model.nu)))
    made.set_variable("_tvp", "r", shape=(model.ny, 1))
    step, output = functions_of(model)
    made.set_expression("y", output(x))
    made.set_rhs("x", step(x, u), process_noise=True)
    made.set_meas("y", output(x), meas_noise=True)
    made.set_meas("u", u, meas_noise=False)
    made.setup()
    return made


def functions_of(model: Any) -> tuple[Any, Any]:
    """Return x(k+1) of (x, u) and y of x as functions of CasADi expressions."""
    if isinstance(model, NonlinearModel):
        from rmpc_bench.adapters.casadi import output_function, step_function

        step = step_function(model)
        if step.n_in() > 2:
            raise DesignError("a do-mpc model is made of an equation that does not depend on the time", "kind")
        return step, output_function(model)
    if isinstance(model, DisturbedNonlinear):
        return _disturbed(model)
    if model.varies:
        raise DesignError("a do-mpc model is made of a model that is the same at all k", "kind")
    model.refuse_feedthrough("do-mpc")
    casadi = library("casadi")
    A, B, C = (casadi.DM(each) for each in (model.A, model.B, model.C))
    return lambda x, u: A @ x + B @ u + model.f0, lambda x: C @ x + model.d0


def _disturbed(model: DisturbedNonlinear) -> tuple[Any, Any]:
    """Return the functions of a nonlinear model with the disturbances as its last states."""
    casadi, nx = library("casadi"), model.undisturbed.nx
    step, output = functions_of(model.undisturbed)
    S, N, C_d = (casadi.DM(each) for each in (model.entry.S, model.entry.N, model.entry.C_d))

    def moved(z: Any, u: Any) -> Any:
        x, d = z[:nx], z[nx:]
        return casadi.vertcat(step(x, u + S @ d) + N @ d, d)

    return moved, lambda z: output(z[:nx]) + C_d @ z[nx:]


class _OwnObject:
    """A component with an object of do-mpc, which no other run may have."""

    method = ""
    """A method, besides `make_step`, that tells the object from others of do-mpc."""

    @classmethod
    def fits(cls, made: Any) -> bool:
        """Whether a function has returned the object."""
        return hasattr(made, "make_step") and hasattr(made, cls.method)

    @staticmethod
    def owned(made: Any) -> list[Any]:
        """Return the objects that no other run may have."""
        return [made]


class MpcController(_OwnObject):
    """An MPC of do-mpc, from a new initial guess at k = 0 and after a step that has failed.

    It knows `preview` samples of the reference, r(k) included; the last one is held over the horizon.
    """

    returns, method = "an MPC of do-mpc", "set_rterm"

    def __init__(self, made: Any, model: Any, Ts: float, preview: Count = 1, plant_info: Any = None) -> None:
        set_up(made, Ts)
        refuse_other_order(made.model, plant_info)
        n = made.settings.n_horizon + 1
        if preview > n:
            raise ValueError(f"preview = {preview}; an MPC with n_horizon = {n - 1} uses {n} samples of the reference")
        self.mpc, self.u_op, self.has_guess = made, model.u_op, bool(made.flags["set_initial_guess"])
        self.held = np.minimum(np.arange(n), preview - 1)
        template, own = made.get_tvp_template(), made.tvp_fun
        places = [template.f["_tvp", j, "r"] for j in range(n)] if "r" in made.model.tvp.keys() else []
        if places and len(places[0]) != model.ny:
            raise ValueError(f"the time-varying parameter r has {len(places[0])} entries; outputs: {model.ny}")
        self.places = [place for each in places for place in each]
        self.r = np.zeros((n, model.ny))

        def tvp_fun(t: Any) -> Any:
            template.master[:] = own(t).cat
            if places:
                template.master[self.places] = self.r.ravel()
            return template

        made.set_tvp_fun(tvp_fun)

    def control(self, x_hat: Array, r: Array, u_previous: Array | None, t: float) -> Array:
        """Return u(k); the moves of the input begin at u(k-1), at k = 0 at the input of the operating point."""
        mpc, self.r = self.mpc, np.atleast_2d(r)[self.held]
        mpc.t0, mpc.x0, mpc.u0 = float(t), x_hat, self.u_op if u_previous is None else u_previous
        if not self.has_guess:
            # Neither slack variables nor multipliers of an earlier solution, which may be NaN.
            mpc.opt_x_num.master[:], mpc.flags["initial_run"] = 0.0, False
            mpc.set_initial_guess()
        u = mpc.make_step(x_hat[:, None])
        shorten_history(mpc)
        self.has_guess = False
        checked_solution(mpc)
        self.has_guess = True
        return np.asarray(u).ravel()


# do-mpc: its moving-horizon estimator (MHE), with a window that grows until it is full.
#
# Model   do-mpc has y(j+1) beside u(j): x(0) has the arrival cost only.  Thus y(0) is not used, and x_hat(0) = x0.
# Window  do-mpc repeats the oldest measurement until the window is full.  Here the measurements there are fill the
#         first places.  The equations of missing and later measurements have no bounds: those samples are predictions
#         with the last input and add nothing to the cost.  The estimate is the state at the last measurement.  x0 stays
#         in the arrival cost until the window is full; then the smoothed x(1) replaces it.  Bounds hold for the
#         predictions as well.  Time-varying parameters are those of the samples in the window: the last of those that
#         the function of the user gives for the time, as in a full window.


class MheEstimator(_OwnObject):
    """An MHE of do-mpc; its model has the measurements y with noise, and none or u without noise."""

    returns, method = "an MHE of do-mpc", "set_y_fun"
    bridges_missing = True

    def __init__(self, made: Any, model: Any, Ts: float, plant_info: Any = None) -> None:
        set_up(made, Ts)
        refuse_other_order(made.model, plant_info)
        if made.model.n_v != model.ny or made.model.n_y not in (model.ny, model.ny + model.nu):
            found = f"measurements of the do-mpc model: {made.model.n_y}, of which {made.model.n_v} have noise"
            needed = f"{model.ny} outputs with noise (meas_noise=True), and {model.nu} inputs without, or none"
            raise ValueError(f"{found}; needed are {needed}")
        self.mhe, self.N, self.Ts, self.n_y = made, made.settings.n_horizon, Ts, made.model.n_y
        self.window: deque[Array] = deque(maxlen=self.N)
        measured = made.model._y
        self.is_output = np.zeros(self.n_y, dtype=bool)
        for name in measured.keys():  # noqa: SIM118, the structure is no mapping
            self.is_output[measured.f[name]] = f"{name}_noise" in made.model._v.keys()  # noqa: SIM118
        self.order = np.argsort(~self.is_output, kind="stable")
        if made.model._tvp.size > 0:
            made.set_tvp_fun(self._tvp_of_window(made.tvp_fun, made.get_tvp_template()))
        self.template, self.scale = made.get_y_template(), made._x_scaling.cat.full().ravel()
        made.set_y_fun(lambda t: self.template)
        self.p_est = made.p_est0.cat
        self.states = [place for j in range(self.N + 1) for place in made.opt_x.f["_x", j, -1]]
        rows, columns = (np.array(each) for each in made.S.get_function("nlp_jac_g").sparsity_out(1).get_triplet())
        self.equations = [row for j in range(self.N) for row in rows[np.isin(columns, made.opt_x.f["_v", j])].tolist()]
        self.missing = np.ones((self.N, model.ny), dtype=bool)

    def _tvp_of_window(self, own: Any, template: Any) -> Any:
        """Return the user's function with its last samples in the first places while the window grows."""

        def tvp_fun(t: Any) -> Any:
            given = own(t).cat.full().reshape(self.N + 1, -1)
            template.master[:] = given[np.minimum(np.arange(self.N + 1) + self.N - len(self.window), self.N)].ravel()
            return template

        return tvp_fun

    def start(self, x0: Array) -> None:
        """Begin with x(0) of the arrival cost."""
        self.x0, self.path = np.array(x0), np.array([x0])

    def update(self, y: Array, u_previous: Array | None, t: float) -> Array:
        """Return x_hat(k) from y(k), in which NaN is a missing measurement, and u(k-1)."""
        mhe, first = self.mhe, self.x0
        if u_previous is None:
            return first.copy()
        if len(self.window) == self.N:
            # After a step that has failed, the last solution gives the smoothed state one sample later.
            self.path = self.path[min(len(self.path) - 1, 1) :]
            first = self.path[0]
        else:
            mhe.p_est0.master = self.p_est
        self.window.append(np.empty(self.n_y))
        self.window[-1][self.order] = np.concatenate([y, u_previous])[: self.n_y]
        n = len(self.window)
        data = np.array([*self.window, *[self.window[-1]] * (self.N - n)])
        self.missing[:n] = np.isnan(data[:n, self.is_output])
        self.template.master[:] = np.where(np.isnan(data), 0.0, data).ravel()
        bound = np.where(self.missing, np.inf, 0.0).ravel()
        mhe.nlp_cons_lb[self.equations], mhe.nlp_cons_ub[self.equations] = -bound, bound
        if not mhe.flags["set_initial_guess"]:
            mhe.x0, mhe.u0 = first, u_previous
            mhe.set_initial_guess()
        mhe.opt_x_num["_x", 1, -1] = first / self.scale  # do-mpc takes it for the arrival cost
        mhe.t0, guess, p_est = t - self.Ts, mhe.opt_x_num.master, mhe.p_est0.master
        mhe.make_step(self.window[-1][:, None])
        shorten_history(mhe)
        path = mhe.opt_x_num.master[self.states].full().reshape(self.N + 1, -1) * self.scale
        if not mhe.solver_stats["success"]:
            mhe.opt_x_num.master, mhe.p_est0.master, mhe.flags["initial_run"] = guess, p_est, False
        checked_solution(mhe)
        self.path = path[: n + 1]
        return np.asarray(path[n])


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
