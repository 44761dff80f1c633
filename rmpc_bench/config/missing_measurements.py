"""Refuses estimators that cannot predict without a measurement where a noise law omits some."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import Method

BRIDGING = (
    "control-lqe",
    "correntropy-kalman",
    "directional-kalman",
    "enhanced-robust",
    "extended-kalman",
    "fading-kalman",
    "gated-kalman",
    "h-infinity",
    "huber-kalman",
    "kalman",
    "kalman-disturbance",
    "kalman-predictor",
    "lmmse",
    "lp-window",
    "mixed",
    "moving-horizon",
    "oracle",
    "risk-sensitive",
    "robust-h-infinity",
    "robust-kalman",
    "sayed-bdu",
    "set-membership",
    "student-kalman",
    "unscented-kalman",
    "wasserstein-kalman",
)
"""Kinds of estimators that predict where a measurement is missing; those of other kinds may do so as well."""


def refuse_unbridged(draft: DraftConfig, scenario: Scenario, methods: Sequence[Method | None]) -> None:
    """Report estimators that do not bridge the missing measurements of the noise; an invalid method is None."""
    if not any(law.omits_measurements for law in scenario.measurement):
        return
    without = [each.name for each in methods if each is not None and not each.estimator.bridges_missing]
    if without:
        draft.note(
            ["noise", "measurement"],
            f"omits measurements, and the estimator of {', '.join(map(repr, without))} cannot predict without one; "
            f"some that can: {', '.join(BRIDGING)}",
        )
