"""Metrics written for one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.single_design import run_info
from rmpc_bench.components.user_class import UserClass
from rmpc_bench.components.user_runs import UserRuns
from rmpc_bench.types import Array, InvalidReturnValue, Metric, Record
from rmpc_bench.types.metric import Direction, MetricLayout


@dataclass(frozen=True, kw_only=True)
class SingleRunMetric(Metric):
    """The metric of a class of the user: one object, and one call of `evaluate`, per run."""

    user: UserClass
    keys: Mapping[str, Any]

    role: ClassVar[str] = "metric"

    @property
    def better(self) -> Direction:
        """As the user's class declares."""
        direction: Direction = self.user.constant("better", "lower")
        return direction

    @property
    def may_not_occur(self) -> bool:  # type: ignore[override]
        """As the user's class declares."""
        return bool(self.user.constant("may_not_occur", False))

    @property
    def needs_P(self) -> bool:
        """Whether `evaluate` asks for P."""
        return "P" in self.user.arguments["evaluate"].names

    @property
    def needs_info(self) -> tuple[str, ...]:
        """As the user's class declares."""
        return tuple(self.user.constant("needs_info", ()))

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
