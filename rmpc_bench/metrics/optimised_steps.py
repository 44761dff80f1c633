"""Metric of the results of the quadratic programs of a constrained controller."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, Direction, Issue, MetricInfo, MetricLayout, OptimisedStep, Record, WindowMetric

EQUATION = r"\frac{1}{N} |\lbrace k \lt N : \mathrm{result}_k = \mathrm{of} \rbrace|"
QP = "qp"
"""Name of the entry that a constrained controller reports, the number of an `OptimisedStep`."""
Result: TypeAlias = Literal["skipped", "solved", "softened", "failed", "infeasible", "not-converged"]
STEPS: Mapping[Result, tuple[OptimisedStep, ...]] = {
    "skipped": (OptimisedStep.SKIPPED,),
    "solved": (OptimisedStep.SOLVED,),
    "softened": (OptimisedStep.SOFTENED,),
    "failed": (OptimisedStep.INFEASIBLE, OptimisedStep.NOT_CONVERGED),
    "infeasible": (OptimisedStep.INFEASIBLE,),
    "not-converged": (OptimisedStep.NOT_CONVERGED,),
}
"""Word of the key -> the results that it counts."""


@dataclass(frozen=True, kw_only=True)
class QpShare(WindowMetric):
    """Share of the samples k = 0..N-1 at which the quadratic program of the controller had the result `of`.

    `skipped`: no limit acts, and the closed form was applied; `solved`: without slack; `softened`: with the slack of a
    soft limit; `failed`: the fallback was applied, as no moves satisfy the hard limits (`infeasible`) or the solver did
    not find the minimum (`not-converged`).  These four add up to 1.  More skipped samples are better, and fewer of the
    others.

    A method without a quadratic program has no value; it is an error of the configuration if no method has one.

    Parameters
    ----------
    of : the result that is counted

    Examples
    --------
    >>> steps = [OptimisedStep.SKIPPED, OptimisedStep.SOLVED, OptimisedStep.SKIPPED, OptimisedStep.INFEASIBLE]
    >>> record = Record.of_run(u=[0.0] * 4)._replace(info={"qp": np.array(steps, dtype=float).reshape(1, 4, 1)})
    >>> QpShare(of="skipped").evaluate(record).item(), QpShare(of="failed").evaluate(record).item()
    (0.5, 0.25)
    """

    name: str = "qp_share"
    of: Result

    bounds: ClassVar[tuple[float, float]] = (0.0, 1.0)
    input_only: ClassVar[bool] = True
    needs_info: ClassVar[tuple[str, ...]] = (QP,)

    @property
    def better(self) -> Direction:
        """A higher share of skipped samples, a lower one of the others."""
        return "higher" if self.of == "skipped" else "lower"

    def info(self, layout: MetricLayout) -> MetricInfo:
        """Describe the column; the label names the result unless there is another name or label."""
        info = super().info(layout)
        own = info.name != "qp_share" or info.label
        return info if own else info._replace(label=f"share of QPs {self.of.replace('-', ' ')}")

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and methods none of which has a quadratic program."""
        yield from super().check(layout)
        if layout.methods and not any(QP in method.reports for method in layout.methods):
            yield Issue("", "no method solves a quadratic program; use limits: {enforce: qp}, or leave the metric out")

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Count the samples."""
        if QP not in record.info:
            return np.full(len(record.y), np.nan)
        results = record.info[QP][:, self.samples(record).slice, 0]
        counted = np.isin(results, [float(step) for step in STEPS[self.of]])
        return np.asarray(np.count_nonzero(counted, axis=1) / counted.shape[1])
