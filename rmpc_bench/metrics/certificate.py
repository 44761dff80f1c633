"""Metric of the validity and tightness of the cost bound that a robust controller certifies.

The controller certifies rho: the bounded noise cannot add more to the cost.  If the largest cost that a search finds
exceeds rho, the bound is violated; close to rho it is tight; far below, it is conservative or the search has missed the
worst case.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias, TypeGuard

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import (
    DISTURBANCES,
    Array,
    Controller,
    Count,
    DesignError,
    Direction,
    Issue,
    Metric,
    MetricLayout,
    NonNegative,
    Record,
    SampleWindow,
)

EQUATION = r"\frac{J_{worst}}{\rho}"
CertificateValue: TypeAlias = Literal["excess", "rho", "worst"]


@dataclass(frozen=True, kw_only=True)
class Certificate(Metric):
    """Worst cost of a search over the admissible noise, relative to the certified bound; above 1 the bound is violated.

    Both are costs over the controller's horizon from the estimate at one sample, minus the least cost without bounded
    noise.  A method whose controller has no certificate is an error of the configuration.  A run without a finite
    estimate has no value.

    Parameters
    ----------
    of : `excess` is worst / rho, best at 1; `rho` is the certified cost and `worst` the one found, lower is better
    at : the sample, in seconds or samples as `time` of the experiment, at most N-1
    starts : number of starting points of the search
    noise : `each` searches noise that is in its set at every sample, `shared` noise whose samples are in one set
        together, a smaller one

    Examples
    --------
    A controller that certifies x_hat^2 and a search that finds half as much.

    >>> class Certifying(Controller):
    ...     certifies = True
    ...     def certificate(self, k, x_hat, starts):
    ...         return x_hat[:, 0] ** 2, x_hat[:, 0] ** 2 / 2
    >>> record = Record.of_run(x_hat=[2.0, 5.0])._replace(controller=Certifying())
    >>> Certificate(at=0.0).evaluate(record).item(), Certificate(of="rho", at=0.0).evaluate(record).item()
    (0.5, 4.0)
    """

    name: str = "certificate"
    of: CertificateValue = "excess"
    at: NonNegative
    starts: Count = 40
    noise: Literal["each", "shared"] = "each"

    # The controller certifies the cost from [x; d] on, where the design model has disturbances.
    needs_info: ClassVar[tuple[str, ...]] = (DISTURBANCES,)

    @property
    def better(self) -> Direction:
        """A ratio is best at 1, a cost is better when it is lower."""
        return "one" if self.of == "excess" else "lower"

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find a sample without an input, and methods whose controller has no certificate."""
        yield from super().check(layout)
        without = [method.name for method in layout.methods if not _certifies(method.controller)]
        if without:
            yield Issue(
                "",
                "needs a controller that certifies its cost, such as minimax-lq with sets that do not depend on the "
                f"data, which {', '.join(map(repr, without))} does not have; leave the metric or the method out",
            )

    def window(self, layout: MetricLayout) -> SampleWindow:
        """Return the only sample that it reads."""
        # No input is chosen at k = N.
        last = layout.n_steps - 1
        k = layout.sample(self.at, "at")
        k = min(k, last) if layout.cut else k
        if k > last:
            raise DesignError(f"sample {k} lies beyond the last one with an input, {last}", "at")
        return SampleWindow(k, k)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Compute the certificate for the estimates at the sample."""
        k = self.samples(record).first
        controller, x_hat = record.controller, record.x_hat[:, k]
        if DISTURBANCES in record.info:
            x_hat = np.hstack([x_hat, record.info[DISTURBANCES][:, k]])
        values = np.full(len(x_hat), np.nan)
        # A failed run may have no estimate.
        known = np.isfinite(x_hat).all(axis=1)
        if _certifies(controller) and known.any():
            shared = {"shared": True} if self.noise == "shared" else {}
            rho, worst = controller.certificate(k, x_hat[known], self.starts, **shared)
            with np.errstate(all="ignore"):
                # Without noise nothing is added, and the bound is tight: 0/0 is 1.
                excess = np.where(worst == rho, 1.0, worst / rho)
            values[known] = {"rho": rho, "worst": worst, "excess": excess}[self.of]
        return values


def _certifies(controller: Controller | None) -> TypeGuard[Controller]:
    return controller is not None and controller.certifies
