"""Adds the disturbances of a configuration to a design model of any kind, and checks that they are detectable."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.disturbance import Disturbance, Entry, entry_of, refuse_undetectable
from rmpc_bench.models.disturbed import DisturbedLinear, DisturbedModel, DisturbedNonlinear
from rmpc_bench.models.disturbed_states import DisturbedStates
from rmpc_bench.models.disturbed_uncertain import DisturbedUncertain
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.models.uncertain_linear import UncertainModel
from rmpc_bench.numerics.jacobian import jacobian
from rmpc_bench.types import Array, Model


def disturbed(model: Model, entry: Entry, label: str = "") -> Model:
    """Return a model of any kind with disturbances as further states."""
    kinds = (
        (LinearModel, DisturbedLinear),
        (UncertainModel, DisturbedUncertain),
        (StateDependentModel, DisturbedStates),
        (NonlinearModel, DisturbedNonlinear),
        (Model, DisturbedModel),
    )
    make: Any = next(made for kind, made in kinds if isinstance(model, kind))
    found: Model = make(model, entry, label)
    return found


def with_disturbance(model: Model, disturbance: Disturbance, n_steps: int, x0: Float[Array, " nx"]) -> Model:
    """Return the design model with the disturbances of a configuration."""
    entry = entry_of(model, disturbance)
    models = _linear_models(model, n_steps, x0)
    rank, needed = refuse_undetectable(models, entry) if models else (0, 0)
    places = disturbance.at if isinstance(disturbance.at, list) else [disturbance.at]
    words = ", ".join(place if isinstance(place, str) else "B_d, C_d" for place in places)
    drift = ", ".join(f"{value:g}" for value in entry.drift.diagonal())
    detectable = f", detectable: rank {rank} of {needed}" if needed else ""
    return disturbed(model, entry, f"at {words}, drift {drift}{detectable}")


def _linear_models(model: Model, n_steps: int, x0: Float[Array, " nx"]) -> list[LinearModel]:
    """Return the linear models with which detectability is checked; none where the model has none."""
    if isinstance(model, StateDependentModel):
        if model.has_offsets:
            low, high = model.dynamics.limits(model.dynamics.names.inputs)  # type: ignore[attr-defined]
            A, B, f0, C, d0 = (part[0] for part in model.around(0, x0[None], np.clip(0.0, low, high)[None]))
        else:
            (A, B), C = (part[0] for part in model.at_state(x0[None])), model.C
            f0, d0 = np.zeros(model.nx), np.zeros(model.ny)
        fits = all(np.isfinite(part).all() for part in (A, B, C))
        return [LinearModel(A, B, C, model.Q_w, model.R_v, f0=f0, d0=d0)] if fits else []
    if isinstance(model, NonlinearModel) and model.linear_keys is None:
        F = model.F(x0, np.zeros(model.nu))
        B = jacobian(lambda u: model.f(x0, u, near=(x0, np.zeros(model.nu))), np.zeros(model.nu))
        C = model.H(x0)
        fits = all(np.isfinite(part).all() for part in (F, B, C))
        return [LinearModel(F, B, C, model.Q_w, model.R_v)] if fits else []
    return [model.at(k) for k in range(n_steps + 1 if model.varies else 1)]
