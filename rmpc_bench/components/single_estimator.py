"""Estimators written for one run, and the step of the design model for one whose step is held."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.single_design import SingleDesign
from rmpc_bench.components.user_class import UserClass
from rmpc_bench.components.user_runs import (
    BEFORE,
    JOINED,
    Failed,
    Reports,
    UserRuns,
    asymmetric_rows,
    finite_rows,
    numbers,
)
from rmpc_bench.models.disturbed import DisturbedNonlinear
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.types import Array, Estimate, Estimator, InvalidReturnValue, RunInfo


def advanced(model: Any, k: int, x_hat: Array, P: Array, u: Array) -> tuple[Array, Array]:
    """Return x_hat (nx,) and P of the linearisation at k+1; what a model does not have in finite numbers stays."""
    try:
        with np.errstate(all="ignore"):
            x_next, P_next = _moved(model, k, x_hat, P, u)
    # A design model may be the user's; one that fails leaves the last estimate.
    except Exception:
        return x_hat, P
    if not np.isfinite(x_next).all():
        return x_hat, P
    return x_next, P_next if np.isfinite(P_next).all() else P


def _moved(model: Any, k: int, x_hat: Array, P: Array, u: Array) -> tuple[Array, Array]:
    if isinstance(model, NonlinearModel | DisturbedNonlinear):
        F = model.F(x_hat, u, k)
        return model.f(x_hat, u, k), F @ P @ F.T + model.Q_w
    # A linear model has f as well, but its matrices also move P.
    if callable(getattr(model, "f", None)) and not getattr(model, "is_linear_model", False):
        return np.asarray(model.f(x_hat, u), dtype=float).reshape(x_hat.shape), P
    if isinstance(model, StateDependentModel) and model.has_offsets:
        A = model.around(k, x_hat[None], u[None]).A[0]
        return model.advance(k, x_hat[None], u[None])[0], A @ P @ A.T + model.Q_w
    if isinstance(model, StateDependentModel):
        A, B = (matrix[0] for matrix in model.at_state(x_hat[None]))
        return A @ x_hat + B @ u, A @ P @ A.T + model.Q_w
    now = model.at(k)
    return now.A @ x_hat + now.B @ u + now.f0, now.A @ P @ now.A.T + now.Q_w


AUGMENTED = "augmented"
"""Entry of `info` with the estimated states that the model does not have."""


class RunStates:
    """State of the estimators of a block; x_hat and P are those before the first measurement, one row per run."""

    def __init__(self, objects: UserRuns, x_hat: Array, P: Array) -> None:
        self.objects, self.x_hat, self.P = objects, x_hat, P
        self.gives_P = np.zeros(len(x_hat), dtype=bool)
        self.u_previous: Array | None = None


class SingleRunEstimator(SingleDesign, Estimator):
    """The estimators of a class of the user, one object per run."""

    role = "estimator"

    knows_uncertainty: bool
    bridges_missing: bool
    Ne: int
    P_is: Literal["covariance", "bound"]

    def __init__(self, user: UserClass, given: Mapping[str, Any]) -> None:
        super().__init__(user, given)
        self.nx = int(given["model"].nx)
        self.states: slice | None = user.constant("states", None)
        # An estimator that asks for the plant is an oracle estimator.
        self.knows_uncertainty = "plant" in self.given
        self.bridges_missing = bool(user.constant("bridges_missing", False))
        self.P_is = "bound" if user.constant("P_is", "covariance") == "bound" else "covariance"
        Ne = self.keys.get("Ne", user.constant("Ne", 0))
        self.Ne = Ne if isinstance(Ne, int) else 0
        self._reports = Reports(user.constant("reports", {}))

    @property
    def repeats(self) -> bool:
        """Whether no step is held: a held one would be counted at every repetition."""
        return not self.holds

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """As the user's class declares."""
        return self._reports.shapes

    def init(self, n_runs: int, delta: Any = None, *, runs: RunInfo | None = None) -> RunStates:
        """Make the objects."""
        x0, P0 = (np.asarray(self.given[name], dtype=float) for name in ("x0", "P0"))
        objects = self.user_runs(n_runs, runs, {})
        objects.report()
        return RunStates(objects, np.tile(x0, (n_runs, 1)), np.tile(P0, (n_runs, 1, 1)))

    def copied(self, state: RunStates) -> RunStates:
        """Return a state with copies of the objects."""
        other = copy(state)
        other.objects, other.gives_P = state.objects.copied(), state.gives_P.copy()
        return other

    def correct(self, k: int, state: RunStates, y: Float[Array, "runs ny"]) -> tuple[RunStates, Estimate]:
        """Call `update`, or `predict` and `correct`, of every run that has not failed."""
        answer, y = _Answer(self, state, k), y if self.point is None else y - self.point.y
        seen = {"y": y, "u_previous": state.u_previous, "x_hat": state.x_hat}
        method = "update" if "update" in self.user.methods else "correct" if k == 0 else JOINED
        if method == JOINED:
            seen[f"{BEFORE}u"] = state.u_previous
        state.objects.call(method, k, seen, answer.keep, settle=answer.settle)
        answer.check(method.removeprefix(BEFORE), seen)
        state.x_hat, state.P = answer.x_hat, answer.P
        P = np.where(state.gives_P[:, None, None], answer.P, np.nan) if state.gives_P.any() else None
        x_hat = answer.x_hat if self.point is None else answer.x_hat + self.point.x
        return state, Estimate(x_hat, P, None, state.objects.failed.copy(), answer.info)

    def predict(self, k: int, state: RunStates, u: Float[Array, "runs nu"]) -> RunStates:
        """Keep u(k): the user's object gets it with the next measurement."""
        state.u_previous = u.copy() if self.point is None else u - self.point.u
        return state


class _Answer:
    """The answers of all runs at one sample; a run without an answer keeps its last estimate."""

    def __init__(self, design: SingleRunEstimator, state: RunStates, k: int) -> None:
        self.design, self.state, self.k = design, state, k
        self.x_hat, self.P = state.x_hat.copy(), state.P.copy()
        self.info = design._reports.empty(len(self.x_hat))
        self.shape = (design.nx,)

    def keep(self, row: int, answer: Any) -> None:
        """Copy x_hat, (x_hat, P), (x_hat, info) or (x_hat, P, info) of one run."""
        if type(answer) is tuple:
            x_hat, *more = answer
            info = more.pop() if more and isinstance(more[-1], Mapping) else {}
            P = more.pop(0) if more else None
            if more:
                raise InvalidReturnValue(f"returned {len(answer)} entries; x_hat, or (x_hat, P, info), is expected")
            self.keep_x_hat(row, x_hat)
            self.state.gives_P[row] = P is not None
            if P is not None:
                self.keep_P(row, P)
            if info:
                self.design._reports.keep(row, info, self.info)
            return
        self.state.gives_P[row] = False
        self.keep_x_hat(row, answer)

    def keep_x_hat(self, row: int, value: Any) -> None:
        """Copy the estimate; with `states` it may have more entries than the model has states."""
        states = self.design.states
        if states is None:
            self.x_hat[row] = numbers(value, "state", self.shape, "the model")
            return
        array = numbers(value, "state", (len(np.atleast_1d(value)),), "the model")
        chosen = np.zeros(len(array), dtype=bool)
        chosen[states] = True
        if chosen.sum() != self.design.nx:
            raise InvalidReturnValue(
                f"returned {len(array)} numbers, of which `states` takes {chosen.sum()}; "
                f"the model has {self.design.nx} states"
            )
        self.x_hat[row] = array[states]
        if AUGMENTED in self.info:
            self.design._reports.keep(row, {AUGMENTED: array[~chosen]}, self.info)

    def keep_P(self, row: int, value: Any) -> None:
        """Copy the covariance, with `states` that of the states of the model."""
        nx, states = self.design.nx, self.design.states
        if states is not None and np.ndim(value) == 2:
            value = np.asarray(value)
            value = value[states, states] if value.shape != (nx, nx) else value
        try:
            self.P[row] = numbers(value, "state", (nx, nx), "the model")
        except InvalidReturnValue as error:
            raise InvalidReturnValue(f"{error} (this is P)") from None

    def settle(self, failure: Failed) -> bool:
        """Hold a step: the last estimate, moved by the model."""
        design, row, k = self.design, failure.row, self.k
        if not design.may_hold(self.state.objects.held[row]):
            return False
        self.x_hat[row], self.P[row] = self.state.x_hat[row], self.state.P[row]
        if k > 0 and self.state.u_previous is not None:
            moved = advanced(design.given["model"], k - 1, self.x_hat[row], self.P[row], self.state.u_previous[row])
            self.x_hat[row], self.P[row] = moved
        return True

    def check(self, method: str, seen: Mapping[str, Any]) -> None:
        """Fail the runs whose numbers are not finite or whose P is not symmetric."""
        objects = self.state.objects
        if not np.isfinite(self.x_hat).all():
            self._fail(~finite_rows(self.x_hat), f"{method} returned x_hat with NaN or inf", seen)
        if self.state.gives_P.any():
            reported = self.state.gives_P & (objects.failed == 0)
            self._fail(reported & ~finite_rows(self.P), f"{method} returned P with NaN or inf", seen)
            self._fail(reported & asymmetric_rows(self.P), f"{method} returned P that is not symmetric", seen)

    def _fail(self, wrong: Array, message: str, seen: Mapping[str, Any]) -> None:
        self.x_hat[wrong], self.P[wrong] = self.state.x_hat[wrong], self.state.P[wrong]
        self.state.objects.refuse(wrong, message, self.k, seen, self.settle)
