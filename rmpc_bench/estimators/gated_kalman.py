"""Kalman filter with an innovation gate: a measurement that is too unlikely is not used.

Model   As `kalman`. e = y - C x_pred, S = C P_pred C' + R_v.  If e' S^-1 e is above the gate, x_hat = x_pred and P =
        P_pred.
Source  Bar-Shalom, Li and Kirubarajan (2001), validation gates.
Assumed All outputs of a sample are used or none.  With missing outputs, e' S^-1 e and the number of degrees of freedom
        are those of the others; a gate given as a number stays.
Limit   A large gate is `kalman`.
Cost    As estimators/weighted.py.
Fails   Design error if R_v is singular.  P takes the noise of a used measurement as Gaussian: it is too small with
        outliers below the gate.  After a sudden change of the state, or by chance, all measurements can be outside the
        gate, so that x_hat is no longer corrected; P_pred of an unstable or integrating plant then grows until a
        measurement is inside the gate.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.estimators.weighted import WeightedFilter, weighted_filter
from rmpc_bench.numerics.ellipsoid import confidence
from rmpc_bench.numerics.output_weights import WeightLaw
from rmpc_bench.types import Array, DesignError, Model, Positive

EQUATION = r"""\hat x_{k|k} = \hat x_{k|k-1} + L_k e_k \quad
\mathrm{if} \quad e_k^\top S_k^{-1} e_k \le g, \quad \mathrm{else} \quad \hat x_{k|k} = \hat x_{k|k-1}"""
Probability: TypeAlias = Annotated[float, Gt(0), Lt(1)]
USUAL = 0.99
"""Probability where neither key is given."""


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    gate: Positive | None = None,
    probability: Probability | None = None,
    use_y0: bool = True,
) -> WeightedFilter:
    """Kalman filter that does not use measurements outside a gate.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    gate : largest e' S^-1 e of a measurement that is used
    probability : of a Gaussian innovation to be within the gate, by the chi-square distribution; 99 % if neither key is
        given
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If R_v is singular, or both keys are given.
    """
    if gate is not None and probability is not None:
        raise DesignError("give either gate or probability", "probability")
    limits = [confidence(USUAL if probability is None else probability, m) for m in range(1, model.ny + 1)]
    numbers = tuple(limits if gate is None else [gate] * model.ny)
    return weighted_filter(model, n_steps, x0, P0, WeightLaw("gate", numbers), use_y0=use_y0)
