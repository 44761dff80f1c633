"""do-mpc: its moving-horizon estimator (MHE), with a window that grows until it is full.

Model   do-mpc has y(j+1) beside u(j): x(0) has the arrival cost only.  Thus y(0) is not used, and x_hat(0) = x0.
Window  do-mpc repeats the oldest measurement until the window is full.  Here the measurements there are fill the
        first places.  The equations of missing and later measurements have no bounds: those samples are predictions
        with the last input and add nothing to the cost.  The estimate is the state at the last measurement.  x0 stays
        in the arrival cost until the window is full; then the smoothed x(1) replaces it.  Bounds hold for the
        predictions as well.  Time-varying parameters are those of the samples in the window: the last of those that
        the function of the user gives for the time, as in a full window.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from rmpc_bench.adapters.do_mpc_setup import checked_solution, refuse_other_order, set_up, shorten_history
from rmpc_bench.types import Array


class MheEstimator:
    """An MHE of do-mpc; its model has the measurements y with noise, and none or u without noise."""

    returns = "an MHE of do-mpc"

    @staticmethod
    def owned(made: Any) -> list[Any]:
        """Return the objects that no other run may have."""
        return [made]

    @staticmethod
    def fits(made: Any) -> bool:
        """Whether a function has returned an MHE, which takes measurements by a function."""
        return hasattr(made, "make_step") and hasattr(made, "set_y_fun")

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
