"""do-mpc: its MPC, with the reference as a time-varying parameter."""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.adapters.do_mpc_setup import checked_solution, refuse_other_order, set_up, shorten_history
from rmpc_bench.types import Array, Count


class MpcController:
    """An MPC of do-mpc, from a new initial guess at k = 0 and after a step that has failed.

    Parameters
    ----------
    made : the MPC
    model, Ts : design model, sampling time [s]
    preview : samples of the reference that the MPC knows, r(k) included; the last one is held over the horizon
    plant_info : names of the signals
    """

    returns = "an MPC of do-mpc"

    @staticmethod
    def owned(made: Any) -> list[Any]:
        """Return the objects that no other run may have."""
        return [made]

    @staticmethod
    def fits(made: Any) -> bool:
        """Whether a function has returned an MPC, which has weights of the moves of the input."""
        return hasattr(made, "make_step") and hasattr(made, "set_rterm")

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
