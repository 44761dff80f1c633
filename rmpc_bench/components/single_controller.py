"""Controllers and metrics written for one run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.single_design import SingleDesign, run_info
from rmpc_bench.components.user_class import UserClass
from rmpc_bench.components.user_runs import Failed, Reports, UserRuns, finite_rows, numbers
from rmpc_bench.types import Ahead, Array, Command, Controller, Estimate, InvalidReturnValue, Metric, Record, RunInfo
from rmpc_bench.types.metric import MetricLayout


class RunInputs:
    """Controllers of a block, one object per run, and the inputs that are held before the first sample."""

    def __init__(self, objects: UserRuns, u: Array) -> None:
        self.objects, self.u = objects, u


class SingleRunController(SingleDesign, Controller):
    """The controllers of a class of the user, one object per run."""

    role = "controller"
    takes_acting_input = True

    preview: int
    regulates: bool

    def __init__(self, user: UserClass, given: Mapping[str, Any]) -> None:
        super().__init__(user, given)
        self.nu = int(given["model"].nu)
        preview = self.keys.get("preview", user.constant("preview", 1))
        self.preview = preview if isinstance(preview, int) else 1
        self.regulates = bool(user.constant("regulates", False))
        self._reports = Reports(user.constant("reports", {}))

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """As the user's class declares."""
        return self._reports.shapes

    def init(self, n_runs: int, *, runs: RunInfo | None = None) -> RunInputs:
        """Make the objects."""
        objects = self.user_runs(n_runs, runs, {})
        objects.report()
        return RunInputs(objects, np.tile(self.given["model"].u_op, (n_runs, 1)))

    def control(
        self, k: int, state: RunInputs, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[RunInputs, Command]:
        """Call `control` of every run that has not failed."""
        if self.point is not None:
            estimate = estimate._replace(x_hat=estimate.x_hat - self.point.x)
            y, r = y - self.point.y, r - self.point.y
        n_runs, answer = len(y), _Answer(self, state)
        reference = r[0] if self.preview == 1 else r
        seen: dict[str, Any] = {"x_hat": estimate.x_hat, "y": y, "u_previous": state.u if k > 0 else None}
        given = {**seen, "r": np.broadcast_to(reference, (n_runs, *reference.shape))}
        asked = self.user.arguments["control"].names
        if "P" in asked:
            P = estimate.P
            given["P"] = None if P is None else np.broadcast_to(P, (n_runs, *P.shape[-2:]))
        if "e" in asked:
            given["e"] = estimate.info.get("e")
        if "info" in asked:
            given["info"] = [
                {name: np.array(values[row]) for name, values in estimate.info.items()} for row in range(n_runs)
            ]
        state.objects.call("control", k, given, answer.keep, settle=answer.settle)
        if not np.isfinite(answer.u).all():
            wrong = ~finite_rows(answer.u)
            answer.u[wrong] = state.u[wrong]
            state.objects.refuse(wrong, "control returned u with NaN or inf", k, given, answer.settle)
        state.u = answer.u
        u = answer.u.copy() if self.point is None else answer.u + self.point.u
        return state, Command(u, state.objects.failed.copy(), answer.info)

    def control_ahead(
        self, k: int, state: RunInputs, y: Array, estimate: Estimate, r: Array, ahead: Ahead
    ) -> tuple[RunInputs, Command]:
        """Call `control` at k with the predicted estimate and the reference of the sample where u(k) acts."""
        return self.control(k, state, y, estimate, r[len(ahead.y_hat) :])

    def applied(self, k: int, state: RunInputs, u: Float[Array, "runs nu"]) -> RunInputs:
        """Keep the input that acts as `u_previous`; one that nothing has changed keeps its bits."""
        u_op = 0.0 if self.point is None else self.point.u
        state.u = np.where(u == state.u + u_op, state.u, u - u_op)
        return state


class _Answer:
    """The answers of all runs at one sample; a run without an answer keeps its last input."""

    def __init__(self, design: SingleRunController, state: RunInputs) -> None:
        self.design, self.state = design, state
        self.u, self.shape = state.u.copy(), (design.nu,)
        self.info = design._reports.empty(len(self.u))

    def keep(self, row: int, answer: Any) -> None:
        """Copy u, or (u, info), of one run."""
        if type(answer) is tuple and len(answer) == 2 and isinstance(answer[1], Mapping):
            answer, info = answer
            self.design._reports.keep(row, info, self.info)
        elif type(answer) is tuple:
            raise InvalidReturnValue(f"returned a tuple of {len(answer)} entries; u, or (u, info), is expected")
        self.u[row] = numbers(answer, "input", self.shape, "the model")

    def settle(self, failure: Failed) -> bool:
        """Hold a step: the last input."""
        design, row = self.design, failure.row
        if not design.may_hold(self.state.objects.held[row]):
            return False
        self.u[row] = self.state.u[row]
        return True


def _declared(name: str, default: Any, kind: Callable[[Any], Any]) -> Any:
    """Return a property that the user's class declares."""
    return property(lambda metric: kind(metric.user.constant(name, default)))


@dataclass(frozen=True, kw_only=True)
class SingleRunMetric(Metric):
    """The metric of a class of the user: one object, and one call of `evaluate`, per run."""

    user: UserClass
    keys: Mapping[str, Any]

    role: ClassVar[str] = "metric"

    better = _declared("better", "lower", str)
    may_not_occur = _declared("may_not_occur", False, bool)
    needs_info = _declared("needs_info", (), tuple)

    @property
    def needs_P(self) -> bool:
        """Whether `evaluate` asks for P."""
        return "P" in self.user.arguments["evaluate"].names

    def unit(self, layout: MetricLayout) -> str:
        """As the user's class declares."""
        return str(self.user.constant("unit", ""))

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Evaluate every run that has not failed; NaN for the others."""
        n_runs, n_samples = record.y.shape[:2]
        runs = record.runs or run_info(n_runs)
        values = np.full(n_runs, np.nan)

        def keep(row: int, answer: Any) -> None:
            number = np.asarray(answer)
            if number.dtype.kind not in "fiub" or number.size != 1:
                raise InvalidReturnValue(f"returned {answer!r:.60}; one number is expected")
            values[row] = number.item()

        objects = UserRuns(self.role, self.user, runs, {"Ts": record.Ts}, record.Ts)
        objects.make(self.keys, {})
        objects.call("evaluate", None, _signals(record, n_runs, n_samples), keep)
        objects.report()
        return values


def _signals(record: Record, n_runs: int, n_samples: int) -> dict[str, Any]:
    """Trajectories of every run."""
    names = ("x", "y", "x_hat", "u", "u_command")
    signals: dict[str, Any] = {name: getattr(record, name) for name in names}
    signals["r"] = np.broadcast_to(record.r, (n_runs, *record.r.shape))
    k = np.arange(n_samples)
    signals["k"], signals["t"] = (np.broadcast_to(each, (n_runs, n_samples)) for each in (k, k * record.Ts))
    P = record.P
    signals["P"] = P if P is None or P.ndim == 4 else np.broadcast_to(P, (n_runs, *P.shape))
    signals["info"] = [{name: each[row].copy() for name, each in record.info.items()} for row in range(n_runs)]
    return signals
