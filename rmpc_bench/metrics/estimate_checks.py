"""What metrics of estimates require of an estimator: x_hat with as many components as x, P or M; and its error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.error_size import NormalisedSquares, normalised_squares
from rmpc_bench.types import (
    Array,
    DesignError,
    Estimate,
    Issue,
    MetricLayout,
    Record,
    as_estimate,
    without_disturbances,
)
from rmpc_bench.types.angles import period_of, places, wrapped
from rmpc_bench.types.result_layout import NO_P

ReportedMatrix = Literal["P", "M"]
DESCRIPTIONS: dict[ReportedMatrix, str] = {"P": "the covariance P", "M": "the set M"}
"""What an estimator may report about its error."""


def first_estimates(layout: MetricLayout) -> Iterator[tuple[str, Estimate]]:
    """Yield the name of each method and an estimate at k = 0, which has the sizes of all others.

    An estimator that knows the true parameters is left out: it needs a drawn plant first.  One from a file of the user
    is not called here; what it returned in its first call is used.
    """
    if layout.plant is None:
        return
    y = np.zeros((1, layout.plant.ny))
    for method in layout.methods:
        known = layout.first_estimates.get(method.name)
        if known is not None:
            yield method.name, without_disturbances(known, method.n_disturbances)
        elif not (method.estimator.knows_uncertainty or method.name in layout.first_estimates):
            with np.errstate(all="ignore"):
                estimate = as_estimate(method.estimator.correct(0, method.estimator.init(1), y)[1])
            yield method.name, without_disturbances(estimate, method.n_disturbances)


def check_state_lengths(layout: MetricLayout, key: str = "") -> Iterator[Issue]:
    """Find the first method whose x_hat has not as many components as the plant's x; `key` is the one to blame."""
    for name, estimate in first_estimates(layout):
        nx = layout.plant.nx if layout.plant is not None else 0
        if estimate.x_hat.shape[1] != nx:
            yield Issue(key, _other_lengths(f" of method {name!r}", estimate.x_hat.shape[1], nx))
            return


def check_reported(layout: MetricLayout, *names: ReportedMatrix, key: str = "", of_all: bool = True) -> Iterator[Issue]:
    """Find the methods whose estimator reports none of the given matrices, or that no method does; blame the `key`."""
    without = [
        method for method, estimate in first_estimates(layout) if all(getattr(estimate, name) is None for name in names)
    ]
    if not of_all:
        yield from [Issue(key, NO_P)] if 0 < len(layout.methods) == len(without) else []
    elif without:
        wanted = " or ".join(DESCRIPTIONS[name] for name in names)
        yield Issue(
            key,
            f"needs {wanted} of the estimate, which the estimator of {', '.join(map(repr, without))} does not give; "
            "leave the metric or the method out",
        )


def estimate_error(record: Record) -> Float[Array, "runs samples nx"]:
    """x_hat - x at all samples, that of an angle wrapped; a DesignError where `check_state_lengths` finds one."""
    if record.x_hat.shape != record.x.shape:
        raise DesignError(_other_lengths("", record.x_hat.shape[2], record.x.shape[2]))
    return wrapped(record.x_hat - record.x, period_of(record.layout.angles, places("x", record.x.shape[2])))


def squared_size(
    record: Record,
    samples: slice,
    S: Float[Array, "window nx nx"] | Float[Array, "runs window nx nx"],
    states: Sequence[int] | None = None,
) -> NormalisedSquares:
    """Return e' S^+ e with e = x_hat - x and the symmetric S of all runs or of each; `states` are those that count."""
    size = np.maximum(np.abs(record.x), np.abs(record.x_hat)).max(axis=1)
    e = estimate_error(record)[:, samples]
    if states is not None:
        e, S, size = e[..., states], S[..., states, :][..., states], size[:, states]
    return normalised_squares(e, S, size[:, None, :])


def _other_lengths(of: str, n_hat: int, n: int) -> str:
    return (
        f"x_hat{of} has {n_hat} components and x of the plant {n}, so there is no x_hat - x; "
        "choose a plant with the states of the model, or measure the output"
    )
