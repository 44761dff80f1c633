"""What metrics of estimates ask of estimators: as many components as the plant has states, a covariance, a set."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, DesignError, Estimate, Method, Plant, Record

Belief = Literal["P", "M"]
BELIEFS: dict[Belief, str] = {"P": "the covariance P", "M": "the set M"}
"""What an estimator may say of its error."""


def first_estimates(plant: Plant, methods: Sequence[Method]) -> Iterator[tuple[str, Estimate]]:
    """Let the estimators correct one measurement each, of a run that nobody keeps: its sizes are those of all runs.

    An oracle estimator is left out: it needs a drawn plant before its first estimate.
    """
    y = np.zeros((1, plant.ny))
    for method in methods:
        if not method.estimator.knows_uncertainty:
            with np.errstate(all="ignore"):
                yield method.name, method.estimator.correct(0, method.estimator.init(1), y)[1]


def refuse_other_states(plant: Plant | None, methods: Sequence[Method], parameter: str = "") -> None:
    """Insist that x_hat of every method has as many components as the plant's x.

    Raises
    ------
    DesignError
        Naming the first method whose x_hat has not, at ``parameter``.
    """
    if plant is None:
        return
    for name, estimate in first_estimates(plant, methods):
        if estimate.x_hat.shape[1] != plant.nx:
            raise DesignError(_other_states(f" of method {name!r}", estimate.x_hat.shape[1], plant.nx), parameter)


def refuse_without(plant: Plant | None, methods: Sequence[Method], *names: Belief, parameter: str = "") -> None:
    """Insist that every method has, beside its x_hat, at least one of what is named.

    Raises
    ------
    DesignError
        Naming the methods that have none, at ``parameter``.
    """
    if plant is None:
        return
    without = [
        method
        for method, estimate in first_estimates(plant, methods)
        if all(getattr(estimate, name) is None for name in names)
    ]
    if without:
        wanted = " or ".join(BELIEFS[name] for name in names)
        raise DesignError(
            f"needs {wanted} of the estimate, which the estimator of {', '.join(map(repr, without))} does not give; "
            "leave the metric or the method out",
            parameter,
        )


def estimate_error(record: Record) -> Float[Array, "runs samples nx"]:
    """x_hat - x at all samples.

    Raises
    ------
    DesignError
        If they differ in length, which `refuse_other_states` says before any run where it is asked.
    """
    if record.x_hat.shape != record.x.shape:
        raise DesignError(_other_states("", record.x_hat.shape[2], record.x.shape[2]))
    return record.x_hat - record.x


def _other_states(of: str, n_hat: int, n: int) -> str:
    return (
        f"x_hat{of} has {n_hat} components and x of the plant {n}, so there is no x_hat - x; "
        "choose a plant with the states of the model, or measure the output"
    )
