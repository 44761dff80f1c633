"""Whether the bound that a robust controller certifies holds, and how much room it leaves.

The controller says rho: more than this the bounded noise cannot add to the cost.  The largest cost that a search over
allowed noise finds tests it: above rho the bound is broken, close to rho it is exact, far below it is careful, or the
search has missed the worst.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeGuard

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.tracking import SampleMetric, Units, Window
from rmpc_bench.types import Array, Controller, Count, DesignError, MetricInfo, NonNegative, Record

Of = Literal["excess", "rho", "worst"]


@dataclass(frozen=True)
class Certified:
    """Parameters of `certificate`."""

    of: Of
    starts: int

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Ask the controller about the estimate at the only sample of the window."""
        controller, x_hat = record.controller, record.x_hat[:, window.first]
        if not _certifies(controller):
            return np.full(len(x_hat), np.nan)
        asked = np.isfinite(x_hat).all(axis=1)  # a run that failed has no estimate to ask about
        values = np.full(len(x_hat), np.nan)
        if asked.any():
            values[asked] = self._of(*controller.certificate(window.first, x_hat[asked], self.starts))
        return values

    def _of(self, rho: Float[Array, " runs"], worst: Float[Array, " runs"]) -> Float[Array, " runs"]:
        if self.of != "excess":
            return rho if self.of == "rho" else worst
        with np.errstate(all="ignore"):
            return np.where(worst == rho, 1.0, worst / rho)  # 0/0 where there is no noise: the bound is exact


def _certifies(controller: Controller | None) -> TypeGuard[Controller]:
    return controller is not None and controller.certifies


def certificate(
    units: Units,
    *,
    name: str = "certificate",
    of: Of = "excess",
    at: NonNegative,
    starts: Count = 40,
) -> SampleMetric:
    """Worst cost that a search over allowed noise finds, over what the controller certifies: above 1 the bound fails.

    Both are costs over the controller's horizon, from the estimate of the run at one sample, beyond the least cost
    without bounded noise.  A method whose controller certifies nothing is refused.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    of : excess is worst / rho, best at 1; rho is the certified cost, worst the one that was found
    at : the sample (seconds or samples, as `time`), the last one that has an input at most
    starts : how many times the search begins, each time elsewhere
    """
    without = [method.name for method in units.methods if not _certifies(method.controller)]
    if without:
        raise DesignError(
            f"needs a controller that certifies its cost, such as minimax-lq with sets that do not depend on the data, "
            f"which {', '.join(map(repr, without))} does not have; leave the metric or the method out"
        )
    last = units.n_steps - 1  # no input is chosen at k = N
    k = round(float(at) / units.tick)
    k = min(k, last) if units.cut else k
    if k > last:
        raise DesignError(f"sample {k} lies beyond the last one with an input, {last}", "at")
    direction = "one" if of == "excess" else "lower"
    return SampleMetric(MetricInfo(name, "", direction), Window(k, k), Certified(of, starts))
