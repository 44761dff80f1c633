"""What metrics of estimates ask of estimators: as many components as the plant has states, and a covariance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, DesignError, Estimate, Informed, Method, Plant, Record


def first_estimates(plant: Plant, methods: Sequence[Method]) -> Iterator[tuple[str, Estimate]]:
    """Let the estimators correct one measurement each, of a run that nobody keeps: its sizes are those of all runs.

    An informed estimator is left out: it wants a drawn plant before it says anything.
    """
    y = np.zeros((1, plant.ny))
    for method in methods:
        if not isinstance(method.estimator, Informed):
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


def refuse_without_P(plant: Plant | None, methods: Sequence[Method]) -> None:
    """Insist that every method has a covariance P beside its x_hat.

    Raises
    ------
    DesignError
        Naming the methods that have none.
    """
    if plant is None:
        return
    without = [name for name, estimate in first_estimates(plant, methods) if estimate.P is None]
    if without:
        names = ", ".join(map(repr, without))
        raise DesignError(
            f"needs the covariance P of the estimate, which the estimator of {names} does not give; "
            "leave the metric or the method out"
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
