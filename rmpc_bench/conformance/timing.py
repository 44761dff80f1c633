"""Whether estimates belong to the right sample and use the right input, and the likely reason where they do not."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.systems import EstimatorExample, LinearSystem, Recorded
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import Array, Estimator

SHIFTS = (-3, -2, -1, 1, 2, 3)
FIRST = 10
"""First sample of the comparison of shifts: the initial error is then forgotten."""
MOST_ERRORS = 4.0
"""Standard errors beyond which a paired difference counts."""
EXACT = 1e-6
"""Largest error without noise, as a share of the spread of the state; solvers of single steps are that exact."""


def shift_text(x_hat: Float[Array, "runs samples nx"], x: Float[Array, "runs samples nx"]) -> str:
    """Fail if x_hat(k) fits x(k + d) better than x(k), paired over the runs, by more than four standard errors."""
    samples = np.arange(FIRST, x.shape[1] - max(SHIFTS))

    def size(d: int) -> Array:
        squares: Array = np.maximum(
            ((x_hat[:, samples] - x[:, samples + d]) ** 2).mean(axis=(1, 2)), np.finfo(float).tiny
        )
        return squares

    now = size(0)
    gains = {d: 0.5 * np.log(now / size(d)) for d in SHIFTS}
    d = max(gains, key=lambda each: float(gains[each].mean()))
    mean, error = float(gains[d].mean()), float(gains[d].std(ddof=1) / np.sqrt(len(x)))
    if mean > MOST_ERRORS * error and mean > EXACT:
        late = f"{abs(d)} sample{'s' if abs(d) > 1 else ''} {'late' if d < 0 else 'early'}"
        where = f"x(k{d:+d})"
        raise AssertionError(f"x_hat(k) fits {where} best, {np.exp(mean):.3g} times better than x(k): it comes {late}")
    return f"the next best shift, {d:+d}, has {np.exp(-mean):.3g} times the error"


def exactness(estimator: Estimator, system: LinearSystem) -> str:
    """Filter data without noise from the true x(0); fail, with the likely reason, if x_hat is not the state."""
    recorded = system.recorded(noise=False)
    recorded = Recorded(*(each[:8] for each in recorded))
    data = EstimatorExample(recorded.y, recorded.u)
    x_hat, x = data.x_hat(estimator), recorded.x
    scale = float(x.std(axis=(0, 1)).max())
    error = float(np.abs(x_hat - x).max())
    if error <= EXACT * scale:
        return f"error up to {error:.2g}"
    reason = _reason(estimator, system, recorded, x_hat, EXACT * scale)
    raise AssertionError(f"error up to {error:.2g}, the state has a spread of {scale:.2g}: {reason}")


def _reason(estimator: Estimator, system: LinearSystem, recorded: Recorded, x_hat: Array, small: float) -> str:
    """Find the one change of the data that makes the estimates exact."""
    model, (y, u, x) = system.model, recorded
    for d in (-1, -2):
        if np.abs(x_hat[:, 3:] - x[:, 3 + d : d]).max() <= small:
            return f"it returns x(k{d:+d}), {-d} sample{'s' if d < -1 else ''} late"
    k = slice(3, x.shape[1] - 1)
    for word, input_ in (("u(k)", u[:, 3:]), ("u(k-1)", u[:, 2:-1]), ("no input", 0.0 * u[:, 3:])):
        ahead = np.stack([mv(model.A, a) + mv(model.B, b) for a, b in zip(x[:, k], input_, strict=True)]) + model.f0
        if np.abs(x_hat[:, k] - ahead).max() <= small:
            return f"it returns the prediction x(k+1|k) with {word}"
    earlier = np.concatenate([u[:, 1:], u[:, -1:]], axis=1)
    # u(0) is lost by the shift; the filter forgets it, so that the second half can be exact.
    half = slice(x.shape[1] // 2, x.shape[1] - 3)
    if np.abs(EstimatorExample(y, earlier).x_hat(estimator)[:, half] - x[:, half]).max() <= small:
        return "it is exact when it gets every input one sample earlier, so it uses u(k-2) instead of u(k-1)"
    if np.abs(EstimatorExample(y, 0.0 * u).x_hat(estimator) - x_hat).max() <= small:
        return "it does not use the input"
    return "is u(k-1) the one used?"
