"""Checks of estimators: shapes, purity, independence of other runs, and the information that x_hat(k) depends on.

x_hat(k) depends on y(0)..y(k), u(0)..u(k-1) and the model, and on nothing else.  These checks need a linear Gaussian
system, whose best estimator is the Kalman filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from rmpc_bench.config_file.factories import estimator as made_estimator
from rmpc_bench.conformance.information import CHANGE, FRESH, InformationExample, function_of_data, require_no_lookahead
from rmpc_bench.conformance.outcome import REPETITION, first_checks, require_valid_return_values
from rmpc_bench.conformance.results import (
    Check,
    NotApplicableError,
    base_class,
    copies,
    require,
    require_same,
    require_unchanged,
)
from rmpc_bench.conformance.systems import EstimatorExample, LinearSystem, Recorded
from rmpc_bench.numerics.linalg import congruence, mv
from rmpc_bench.types import Array, Estimator, as_estimate


def _shapes(estimator: Estimator, example: EstimatorExample) -> None:
    outcome = example.all(estimator)
    require_valid_return_values(outcome.journal, "shape")
    n_runs, nx = outcome.returned[0].x_hat.shape
    require(n_runs == example.n_runs, f"x_hat has {n_runs} rows for {example.n_runs} runs")
    require(example.nx in (None, nx), f"x_hat has {nx} numbers; the model has {example.nx} states")
    for state in outcome.states if not estimator.starts_runs else []:
        require(all(len(array) == n_runs for array in state), "axis 0 of a state's array is not the run")
    for k, estimate in enumerate(outcome.returned):
        require(estimate.x_hat.shape == (n_runs, nx), f"x_hat has shape {estimate.x_hat.shape} at k = {k}")
        require(estimate.x_hat.dtype == np.float64, f"x_hat is {estimate.x_hat.dtype}, not float64")
        for name, matrix in (("P", estimate.P), ("M", estimate.M)):
            fits = matrix is None or matrix.shape in ((nx, nx), (n_runs, nx, nx))
            require(fits, f"{name} has shape {None if matrix is None else matrix.shape}")
        require(estimate.status.dtype == np.int8, f"status is {estimate.status.dtype}, not int8")
        require(estimate.status.shape == (n_runs,), f"status has shape {estimate.status.shape} for {n_runs} runs")
        for name, values in estimate.info.items():
            require(len(values) == n_runs, f"info[{name!r}] has {len(values)} rows for {n_runs} runs")


def _arguments(estimator: Estimator, example: EstimatorExample) -> None:
    state = example.begun(estimator)
    for k in range(3):
        arguments = [*state, example.y, example.u]
        before = copies(arguments)
        corrected, _ = estimator.correct(k, state, example.y[:, k])
        require_unchanged(arguments, before)
        arguments = [*corrected, example.y, example.u]
        before = copies(arguments)
        state = estimator.predict(k, corrected, example.u[:, k])
        require_unchanged(arguments, before)


def _purity(estimator: Estimator, example: EstimatorExample) -> None:
    state = example.begun(estimator)
    for k in range(3):
        (a, first), (b, second) = (estimator.correct(k, state, example.y[:, k]) for _ in range(2))
        require_same("x_hat", as_estimate(second).x_hat, as_estimate(first).x_hat)
        new, again = (estimator.predict(k, each, example.u[:, k]) for each in (a, b))
        for number, (left, right) in enumerate(zip(new, again, strict=True)):
            require_same(f"state[{number}]", right, left)
        state = new


def _own_arrays(estimator: Estimator, example: EstimatorExample) -> None:
    state = example.begun(estimator)
    returned: list[Array] = []
    for k in range(3):
        state, corrected = estimator.correct(k, state, example.y[:, k])
        estimate = as_estimate(corrected)
        returned += [each for each in (estimate.x_hat, estimate.P) if each is not None and each.ndim in (2, 3)]
        before = copies(returned)
        state = estimator.predict(k, state, example.u[:, k])
        estimator.correct(k + 1, state, example.y[:, k + 1])
        changed = not all(np.array_equal(*pair, equal_nan=True) for pair in zip(returned, before, strict=True))
        require(not changed, "a later call changes an array that was returned before; return a new array")


def _missing(estimator: Estimator, example: EstimatorExample) -> None:
    run, k, broken = example.n_runs // 2, 3, example.y.copy()
    broken[run, k] = np.nan
    outcome, expected = example.changed(y=broken).evaluate(estimator), example.x_hat(estimator)
    found = outcome.values
    require_same("x_hat of the other runs", np.delete(found, run, axis=0), np.delete(expected, run, axis=0))
    require_same("x_hat before the missing sample", found[run, :k], expected[run, :k])
    # The estimate of a predictor uses y(k) one sample later.
    if estimator.bridges_missing:
        require(bool(np.isfinite(found).all()), "x_hat is not finite after a missing measurement")
        changed = (found[run, k : k + 2] != expected[run, k : k + 2]).any()
        require(bool(changed), "x_hat does not depend on the measurement")
    else:
        failed = bool(outcome.status[run]) or bool(np.isnan(found[run, k : k + 2]).any())
        require(
            failed,
            "x_hat is finite although a measurement is missing; set `bridges_missing` if the estimator then predicts",
        )


def _series(estimator: Estimator, example: EstimatorExample) -> None:
    for name, values in estimator.series().items():
        fits = len(values) in (1, example.y.shape[1])
        require(fits, f"series {name!r} has {len(values)} entries for {example.y.shape[1]} samples")


FIRST = first_checks(
    base_class(Estimator, "estimator"),
    _shapes,
    "axis 0 is the run; P and M are shared, per run or None; numbers are float64",
)
EstimatorExample.checks = (
    *FIRST,
    Check("arguments", "correct and predict leave their arguments unchanged", _arguments),
    Check("own-arrays", "an array that was returned does not change later", _own_arrays, "warning"),
    Check("purity", "the same call twice gives the same bits", _purity),
    *REPETITION,
    Check("missing-measurement", "a missing measurement of one run changes no other run", _missing),
    Check("series", "a series has one entry for every sample, or a single constant one", _series),
)


SPACING = 10
"""Samples between those that count; with fast modes their errors are nearly independent."""
QUANTILE = 4.0
"""Standard normal quantile of both ends of a band: outside once in 16,000 times by chance."""
MOST_ERRORS = 4.0
"""Standard errors beyond which a paired difference counts."""
SHIFTS = (-3, -2, -1, 1, 2, 3)
SETTLED = 10
"""First sample of the comparison of shifts: the initial error is then forgotten."""
EXACT = 1e-6
"""Largest error without noise, as a share of the spread of the state; solvers of single steps are that exact."""
AHEAD = 20
"""Samples after the change; a component that looks further ahead is not found."""
LOST = 0.4
"""Probability that an output of a sample is missing."""
EQUAL, STILL_EQUAL = 1e-5, 1e-4
"""Largest difference from the Kalman filter, relative to its largest estimate, without and with missing outputs."""


@dataclass(frozen=True, eq=False)
class EstimatorInformationExample(InformationExample):
    """A linear Gaussian system, with the random inputs of its runs, that an estimator is checked on."""

    system: LinearSystem

    @cached_property
    def recorded(self) -> Recorded:
        """Data with noise."""
        return self.system.recorded()

    @cached_property
    def data(self) -> EstimatorExample:
        """The measurements and inputs alone."""
        return EstimatorExample(self.recorded.y, self.recorded.u, nx=self.system.model.nx)

    @cached_property
    def kalman(self) -> Float[Array, "runs samples nx"]:
        """Estimates of the Kalman filter."""
        return self.data.x_hat(self.system.kalman)

    def simulated(self, component: Estimator) -> Float[Array, "runs samples nx"]:
        """Estimates in the simulation, where there is a plant."""
        return self.system.simulated(component).x_hat


def _causal(estimator: Estimator, example: EstimatorInformationExample) -> None:
    require_causal(estimator, example.data)


def require_causal(estimator: Estimator, data: EstimatorExample, change: int = CHANGE) -> None:
    """Fail if estimates before `change` depend on y from there on; the error says how far they look ahead."""
    y, rows = data.y[:5, : change + AHEAD], range(min(5, data.n_runs))
    changed = y.copy()
    # The size of noise: measurements of another size may be impossible for the model.
    spread = 0.5 * np.diff(y, axis=1).std(axis=(0, 1)) + 1e-6 * np.abs(y).max()
    changed[:, change:] += spread * np.random.default_rng(17).standard_normal(changed[:, change:].shape)
    before, after = ([data.x_hat(estimator, rows, each) for _ in range(3)] for each in (y, changed))
    require_no_lookahead(before, after, change, f"with another y from k = {change} on x_hat")


def _applied(estimator: Estimator, example: EstimatorInformationExample) -> None:
    if not np.array_equal(example.data.all(estimator).values, example.in_loop(estimator), equal_nan=True):
        raise NotApplicableError("see `function-of-data`")
    u = example.system.u
    system = replace(example.system, largest=0.5 * float(np.abs(u).max(initial=0.0)) or 1.0)
    record, recorded = system.simulated(estimator), system.recorded()
    expected = EstimatorExample(recorded.y, np.clip(u, -system.largest, system.largest)).x_hat(estimator)
    require(
        np.allclose(record.x_hat, expected, rtol=1e-9, atol=1e-12, equal_nan=True),
        "where the plant limits the input, x_hat is not that of the input that acts: use the u that `predict` gets",
    )


def band(degrees: int) -> tuple[float, float]:
    """Return the quantiles of chi-square over its degrees of freedom, after Wilson and Hilferty.

    The ends are off by 1e-2 at 30 degrees and by 1e-4 at 1000.
    """
    spread = 2.0 / (9.0 * degrees)
    low, high = ((1.0 - spread + sign * QUANTILE * math.sqrt(spread)) ** 3 for sign in (-1.0, 1.0))
    return low, high


def _consistent(estimator: Estimator, example: EstimatorInformationExample) -> str:
    """Compare normalised squares of errors and innovations with chi-square."""
    outcome, model, (y, u, x) = example.data.all(estimator), example.system.model, example.recorded
    matrices = [estimate.P for estimate in outcome.returned]
    if any(P is None for P in matrices):
        raise NotApplicableError("P is not reported")
    # (samples, nx, nx) where P is shared, else (runs, samples, nx, nx).
    P = np.stack(matrices, axis=matrices[0].ndim - 2)
    x_hat, (n_runs, n_samples) = outcome.values, x.shape[:2]
    P = np.broadcast_to(P, (n_runs, *P.shape[-3:]))
    ks = range(2 * SPACING, n_samples - 1, SPACING)
    nees = [_squares(x_hat[:, k] - x[:, k], P[:, k]) for k in ks]
    nis = []
    for k in ks:
        # A predictor does not use y(k).
        if estimator.form == "predictor":
            x_pred, P_pred = x_hat[:, k + 1], P[:, k + 1]
        else:
            x_pred = mv(model.A, x_hat[:, k]) + mv(model.B, u[:, k]) + model.f0
            P_pred = congruence(model.A, P[:, k]) + model.Q_w
        e = y[:, k + 1] - mv(model.C, x_pred) - model.d0
        nis.append(_squares(e, congruence(model.C, P_pred) + model.R_v))
    texts, wrong = [], []
    for name, values, n in (("nees", nees, x.shape[2]), ("nis", nis, y.shape[2])):
        mean, (low, high) = float(np.mean(values)) / n, band(n_runs * len(nees) * n)
        texts.append(f"{name} {mean:.3g} (band {low:.3g}..{high:.3g})")
        if not low <= mean <= high:
            wrong.append(f"{texts[-1]}: P is too {'small' if not mean <= high else 'large'}")
    if wrong:
        raise AssertionError("; ".join(wrong))
    return ", ".join(texts)


def _squares(e: Float[Array, "runs n"], P: Float[Array, "runs n n"]) -> Float[Array, " runs"]:
    """Return e' P^-1 e of every run; a singular P has its pseudo-inverse."""
    squares: Array = np.einsum("ri,rij,rj->r", e, np.linalg.pinv(P, hermitian=True), e)
    return squares


def _in_time(estimator: Estimator, example: EstimatorInformationExample) -> str:
    """Fail if x_hat(k) fits x(k + d) better than x(k), paired over the runs, by more than four standard errors."""
    x_hat, x = example.in_loop(estimator), example.recorded.x
    samples = np.arange(SETTLED, x.shape[1] - max(SHIFTS))

    def size(d: int) -> Array:
        squares: Array = np.maximum(
            ((x_hat[:, samples] - x[:, samples + d]) ** 2).mean(axis=(1, 2)), np.finfo(float).tiny
        )
        return squares

    now = size(0)
    gains = {d: 0.5 * np.log(now / size(d)) for d in SHIFTS}
    d = max(gains, key=lambda each: float(gains[each].mean()))
    mean, error = _mean(gains[d])
    if mean > MOST_ERRORS * error and mean > EXACT:
        late = f"{abs(d)} sample{'s' if abs(d) > 1 else ''} {'late' if d < 0 else 'early'}"
        where = f"x(k{d:+d})"
        raise AssertionError(f"x_hat(k) fits {where} best, {np.exp(mean):.3g} times better than x(k): it comes {late}")
    return f"the next best shift, {d:+d}, has {np.exp(-mean):.3g} times the error"


def _mean(values: Float[Array, " runs"]) -> tuple[float, float]:
    """Return the mean over the runs and its standard error."""
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def _exact(estimator: Estimator, example: EstimatorInformationExample) -> str:
    """Filter data without noise from the true x(0); fail, with the likely reason, if x_hat is not the state."""
    recorded = Recorded(*(each[:8] for each in example.system.recorded(noise=False)))
    x_hat, x = EstimatorExample(recorded.y, recorded.u).x_hat(estimator), recorded.x
    scale = float(x.std(axis=(0, 1)).max())
    error = float(np.abs(x_hat - x).max())
    if error <= EXACT * scale:
        return f"error up to {error:.2g}"
    reason = _reason(estimator, example.system, recorded, x_hat, EXACT * scale)
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


def _possible(estimator: Estimator, example: EstimatorInformationExample) -> str:
    x = example.recorded.x
    found, best = (
        ((x_hat - x)[:, 5:] ** 2).mean(axis=(1, 2)) for x_hat in (example.in_loop(estimator), example.kalman)
    )
    tiny = np.finfo(float).tiny
    log_ratio = 0.5 * np.log(np.maximum(found, tiny) / np.maximum(best, tiny))
    mean, error = _mean(log_ratio)
    text = f"error {np.exp(mean):.3g} times that of the Kalman filter"
    require(
        not (mean < -MOST_ERRORS * error and mean < -1e-6),
        f"{text}, {-mean / max(error, tiny):.0f} standard errors below it: it uses the true state or later measurements"
        if error > 0.0
        else f"{text} in every run",
    )
    return text


def _kalman_with_gaps(estimator: Estimator, example: EstimatorInformationExample) -> str:
    if not estimator.bridges_missing:
        raise NotApplicableError("the estimator does not go on without a measurement")
    system, rows = example.system, range(6)
    y = example.data.y[:, :61]
    lost = np.random.default_rng(19).random(y.shape) < LOST
    lost[0] = False  # a run without gaps beside the others
    for form in ("filter", "predictor"):
        kalman = made_estimator("kalman", system.model, system.n_steps, x0=system.x0, P0=system.P0, form=form)
        whole, gaps = (
            _distance(*(example.data.x_hat(each, rows, values) for each in (estimator, kalman)))
            for values in (y, np.where(lost, np.nan, y))
        )
        if whole <= EQUAL:
            text = f"differs by {gaps:.2g} of the largest estimate with missing measurements, by {whole:.2g} without"
            way = "compute the gains again where measurements are missing, or set bridges_missing = False"
            require(gaps <= STILL_EQUAL, f"{text}: does it keep the gains of a run in which nothing is missing? {way}")
            return text
    raise NotApplicableError("with these keys it is not the Kalman filter; give the keys with which it is")


def _distance(found: Array, expected: Array) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


FUNCTION = Check(
    "function-of-data", "x_hat depends on y, u and the model only: the same without a plant", function_of_data
)
EstimatorInformationExample.checks = (
    FUNCTION,
    FRESH,
    Check("causal", "x_hat(k) does not depend on y after k", _causal),
    Check("in-time", "x_hat(k) fits x(k) better than the state of any other sample", _in_time),
    Check("applied-input", "predict uses the input that acts, within the bounds of the plant", _applied),
    Check("exact", "without noise and from the true x(0), x_hat is the state", _exact),
    Check("possible", "the error is not smaller than that of the Kalman filter, which is optimal here", _possible),
    Check(
        "kalman-with-gaps",
        "an estimator that equals the Kalman filter with all measurements also does where some are missing",
        _kalman_with_gaps,
    ),
    Check("consistent", "errors and innovations agree with the reported covariance P", _consistent, "warning"),
)
