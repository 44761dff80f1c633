"""Generalised predictive control: positional form, output weight constant or adapted to the noise.

Model   At every k minimise over u(k)..u(k+Np-1) the sum over j = 1..Np of
        |Q_yw (y(k+j) - r(k+j))|^2 + |Q_u u(k+j-1)|^2, predicted from x_hat(k) with one model over the horizon, and
        apply u(k) (7).  Q_yw and Q_u are roots: the weights are Q_yw' Q_yw and Q_u' Q_u.  The cost weighs the inputs,
        not their increments: a reference that needs a constant input is reached with an offset.  With an operating
        point, u stands for u - u_op throughout.  A state-dependent model is evaluated at x_hat(k-1), at k = 0 at
        x_hat(0); a time-varying one at k.  The predictions include the constant parts of the model and a mean of the
        process noise that is estimated (`w_mean`), held over the horizon.
Limits  `enforce: clip` clips the increment u(k) - u(k-1) of that input, then the input; u(-1) is 0 or u_op.
        `enforce: qp` adds the constraints
            u_low <= u(k+j) <= u_high,  du_low <= u(k+j) - u(k+j-1) <= du_high           for j = 0..Np-1
            z_low - eps <= z(k+j) <= z_high + eps,  eps >= 0                             for j = 1..steps, `soft`
        and, for every slack, linear eps / scale + quadratic / 2 (eps / scale)^2 to the cost.  Where no limit acts, the
        law is that without limits.  `linear` is in the unit of the cost: with Q_yw = 1 an output error of 0.01 over 10
        samples costs 1e-3.
Source  belda2017, section III; order of the steps as in its section VI.  The limits are an addition.
Tuning  `constant`, or `lp-noise` (noise_tuning.py), which computes Q_yw(k) from recent estimates and measurements.
Limit   Without a reference lqr with horizon = Np, Q_x = C' Q_yw' Q_yw C and R_u = Q_u' Q_u.  With Np = 1, Q_u = 0 and
        C B square, y(k+1) = r(k+1).  `enforce: qp` with limits that never act is the law without limits.
Cost    With constant weights and a constant linear model two small matrix-vector products per run and step.  Otherwise
        a square-root recursion over the horizon, about 10 us for six states, four inputs and Np = 10.
Fails   Design error if the cost does not determine the inputs, for example Q_u = 0 with more inputs than outputs.  With
        `enforce: qp` a step for which no inputs satisfy the hard limits, or for which the solver fails, applies
        `fallback` and is counted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.gpc_law import Gpc, TunedGpc
from rmpc_bench.controllers.gpc_limits import constant_program, limits_of
from rmpc_bench.controllers.limits import Limits, SoftLimit, require_effect
from rmpc_bench.controllers.noise_tuning import ConstantTuning, LpNoise, NoiseTuning
from rmpc_bench.controllers.prediction import Frozen, frozen, with_mean
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.numerics.linalg import SMALLEST, as_matrix
from rmpc_bench.numerics.tracking import Problem, TrackingLaw
from rmpc_bench.types import Array, DesignError, Estimator, Horizon, Matrix, PlantInfo

EQUATION = r"\min \sum_{j=1}^{N_p} \Vert Q_{yw} (\hat y_{k+j} - r_{k+j}) \Vert^2 + \Vert Q_u u_{k+j-1} \Vert^2"


def design(
    model: Any,
    n_steps: int | None = None,
    estimator: Estimator | None = None,
    plant_info: PlantInfo | None = None,
    *,
    Np: Horizon,
    Q_yw: Matrix,
    Q_u: Matrix,
    tuning: ConstantTuning | LpNoise = ConstantTuning(),  # noqa: B008 - frozen, so it cannot be shared by mistake
    limits: Limits | None = None,
    soft: dict[str, SoftLimit] | None = None,
) -> Gpc:
    """Generalised predictive controller.

    Parameters
    ----------
    model : prediction model, linear or state-dependent; the nominal part of an uncertain model
    n_steps : number of control periods; without it, a model that may vary is treated as varying
    estimator : estimator of the method; the predictions use the mean of the process noise if it estimates one, and
        `lp-noise` starts after the window of an estimator with a window is full
    plant_info : names of the states and outputs, which soft limits may use
    Np : prediction horizon [samples]
    Q_yw : root of the weight of the output error
    Q_u : root of the weight of the input
    tuning : `{kind: constant}` keeps Q_yw, `{kind: lp-noise, ..}` adapts Q_yw to estimated bounds of the noise
    limits : bounds of the input and of its increment
    soft : limits of predicted signals, measured or not, which may be exceeded at a cost; they need `enforce: qp`

    Raises
    ------
    DesignError
        If a size is inconsistent, bounds are in the wrong order, the cost does not determine the inputs, a soft limit
        names no signal of the design model, or the estimator estimates the mean of the process noise of a
        state-dependent model.
    """
    model.refuse_feedthrough("gpc")
    model = _constant(model, n_steps)
    uses_mean = estimator is not None and estimator.estimates_mean
    if uses_mean and isinstance(model, StateDependentModel):
        raise DesignError("does not support an estimated mean of the process noise with a state-dependent model")
    now = model if isinstance(model, StateDependentModel) else model.at(0)
    if isinstance(now, LinearModel):
        require_effect(now.B)
    outputs, inputs = as_matrix(Q_yw, now.ny, "Q_yw"), as_matrix(Q_u, now.nu, "Q_u")
    R_u, extended = np.linalg.qr(inputs)[1], _extended_states(model, uses_mean=uses_mean)
    limited = limits_of(limits, soft, model, extended, Np, plant_info)
    if isinstance(tuning, ConstantTuning) and isinstance(model, LinearModel):
        fixed = with_mean(frozen(model)) if uses_mean else frozen(model)
        law = _gains(fixed, outputs, inputs, Np)
        if limited is not None and limited.horizon is not None:
            limited = replace(limited, program=constant_program(fixed, outputs, inputs, limited.horizon.at(0)))
        return Gpc(model, Np, outputs, R_u, law, uses_mean, limits=limited)
    sizes = np.linalg.svd(inputs, compute_uv=False)
    if not sizes[-1] > SMALLEST * sizes[0]:
        raise DesignError("must be of full rank, unless both the model and Q_yw are constant", "Q_u")
    if isinstance(tuning, ConstantTuning):
        return Gpc(model, Np, outputs, R_u, None, uses_mean, limits=limited)
    if isinstance(model, StateDependentModel) and model.has_offsets:
        raise DesignError("does not support `at: trajectory` of the model; use constant", "tuning")
    noise = _noise(tuning, estimator, now.nx, now.ny)
    return TunedGpc(model, Np, outputs, R_u, None, uses_mean, noise, limits=limited)


def _extended_states(model: Any, *, uses_mean: bool) -> int:
    """Return the number of states of the predictions: those of `with_mean` and `with_output` are more."""
    if isinstance(model, StateDependentModel):
        return int(model.nx + (model.ny + 1 if model.has_offsets else 0))
    nx = int(model.at(0).nx)
    return 2 * nx if uses_mean else nx


def _gains(fixed: Frozen, Q_yw: Float[Array, "ny ny"], Q_u: Float[Array, "nu nu"], Np: int) -> TrackingLaw:
    """Return the constant law."""
    try:
        return Problem(fixed.A, fixed.B, fixed.f, fixed.C, Q_yw, Q_u, Np, Np).law()
    except ValueError as error:
        raise DesignError(f"{error}; choose another Q_u", "Q_u") from None


def _constant(model: Any, n_steps: int | None) -> Any:
    """Return the linear model if it is the same at all k, otherwise the given model."""
    if isinstance(model, StateDependentModel | LinearModel) or n_steps is None:
        return model
    first = model.at(0)
    return first if all(model.at(k) is first for k in range(1, n_steps)) else model


def _noise(keys: LpNoise, estimator: Estimator | None, nx: int, ny: int) -> NoiseTuning:
    """Check the keys against the sizes of the model."""
    lower, upper = keys.bounds
    if not lower <= upper:
        raise DesignError(f"the lower bound {lower:g} must not exceed the upper bound {upper:g}", "tuning.bounds")
    most = max(ny, nx if keys.state_rows else 0)
    if keys.Ne2 + 1 < most:
        raise DesignError(
            f"must be at least {most - 1}: a fit of {most} coefficients needs as many samples", "tuning.Ne2"
        )
    return NoiseTuning(keys, keys.Ne2 + (0 if estimator is None else estimator.Ne), nx, ny)
