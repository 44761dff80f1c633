"""One step of a design model for one run, for an estimator whose step is held."""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.models.disturbed import DisturbedNonlinear
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.types import Array


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
