"""`rmpc_bench.filter_data`: an estimator on recorded arrays, with the numbers of the plant `data`, bit for bit."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from rmpc_bench.analysis.columns import data_frame
from rmpc_bench.config_file.factories import UnsizedEstimator
from rmpc_bench.numerics.linalg import real_numbers
from rmpc_bench.simulation.checked_calls import CheckedEstimator, is_own
from rmpc_bench.simulation.input_channel import FedEstimator
from rmpc_bench.simulation.recording import Recorder
from rmpc_bench.simulation.run_start import RunStart, RunState
from rmpc_bench.types import Array, DesignError, Estimator, InvalidReturnValue, Status, as_estimate
from rmpc_bench.types.contract import undefined_methods
from rmpc_bench.types.errors import check_arguments
from rmpc_bench.types.run_info import Journal, PassedOn, passed_on

if TYPE_CHECKING:
    import pandas as pd


class Estimates(NamedTuple):
    """What an estimator makes of recorded data; of several runs every array has the run as its first axis.

    Everything is NaN from the sample on at which a run fails.  None stands for what the estimator does not report.
    """

    x_hat: Float[Array, "*runs samples nx"]
    P: Float[Array, "*runs samples nx nx"] | None
    """Reported covariance of x_hat - x."""
    e: Float[Array, "*runs samples ny"] | None
    """Innovation, NaN where the measurement is missing."""
    S: Float[Array, "*runs samples ny ny"] | None
    """Covariance of the innovation."""
    nis: Float[Array, "*runs samples"] | None
    """e' S^-1 e, whose mean is ny for a consistent filter; NaN where a measurement is missing."""

    @property
    def _known(self) -> dict[str, Array]:
        return {name: values for name, values in self._asdict().items() if values is not None}

    def __repr__(self) -> str:
        return f"<Estimates: {', '.join(f'{name} {values.shape}' for name, values in self._known.items())}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row per sample: run, if there are several, k, and a column per component; matrices row by row."""
        *runs, samples, _ = self.x_hat.shape
        columns: dict[str, Array] = {"run": np.repeat(np.arange(*runs), samples)} if runs else {}
        columns["k"] = np.tile(np.arange(samples), runs or 1)
        for name, values in self._known.items():
            parts = values.reshape(len(columns["k"]), -1).T
            columns |= {f"{name}.{i}" if len(parts) > 1 else name: part for i, part in enumerate(parts)}
        return data_frame(columns)


def filter_data(estimator: Estimator, y: ArrayLike, u: ArrayLike | None) -> Estimates:
    """Run an estimator over recorded data.

    Parameters
    ----------
    estimator : from `estimator`, where `n_steps` may be left out, or one of your own
    y : (samples, ny) measurements, NaN where one is missing; (runs, samples, ny) for several runs
    u : (samples, nu) inputs, or (runs, samples, nu); the last sample may be left out; None for a model without input

    Returns
    -------
    x_hat, P, e, S and nis over the samples, with `to_frame()`

    Raises
    ------
    DesignError
        If an array has another shape, or a value is infinite or, in u, missing.

    Examples
    --------
    >>> import numpy as np, rmpc_bench
    >>> model = rmpc_bench.LinearModel(0.9, [[1]], [[1]], 0.01, 0.04)
    >>> kalman = rmpc_bench.estimator("kalman", model, x0=0, P0=1)
    >>> filter_data(kalman, [[1.0], [np.nan], [0.7]], [[0.0], [0.0]]).x_hat.round(3).ravel().tolist()
    [0.962, 0.865, 0.738]
    """
    check_arguments(filter_data, {"estimator": estimator})
    if missing := undefined_methods("estimators", type(estimator)):
        raise DesignError(f"{type(estimator).__qualname__} does not define {', '.join(missing)}", "estimator")
    several = np.ndim(y) == 3
    ys = _given("y", y, several)
    n_runs, samples = ys.shape[:2]
    us = np.zeros((n_runs, samples, 1)) if u is None else _given("u", u, several)
    if len(us) != n_runs or us.shape[1] not in (samples - 1, samples):
        shapes = [each.shape[not several :] for each in (us, ys)]
        raise DesignError(f"u has shape {shapes[0]}, and y {shapes[1]}; they differ in samples or runs", "u")
    if np.isinf(ys).any() or not np.isfinite(us).all():
        raise DesignError("y must not be infinite, and u must be finite", "y")
    if isinstance(estimator, UnsizedEstimator):
        estimator = estimator.sized(max(samples - 1, 1))
    schedule = estimator.gain_schedule
    model: Any = getattr(estimator, "model", None) if schedule is None else schedule
    C, B = (getattr(model, name, None) for name in "CB")
    if isinstance(C, np.ndarray) and ys.shape[2] != C.shape[-2]:
        raise DesignError(f"y has {ys.shape[2]} columns; {C.shape[-2]}, one per output of the model, fits", "y")
    if isinstance(B, np.ndarray) and (np.any(B) if u is None else us.shape[2] != B.shape[-1]):
        given = "is missing" if u is None else f"has {us.shape[2]} columns"
        raise DesignError(f"u {given}; {B.shape[-1]}, one per input of the model, fits", "u")
    if estimator.knows_uncertainty:
        raise DesignError("an oracle estimator needs the true plant, which recorded data do not have", "estimator")
    estimator.warm_up()
    if u is None and B is None and not is_own(estimator) and _uses_input(estimator, ys.shape[2]):
        raise DesignError("u is missing; the estimates depend on the input of the model", "u")
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            found = _filtered(estimator, ys, us)
    except PassedOn as passed:
        raise passed.error from None
    alone = [None if each is None else each[0] for each in found[1:]]
    return found if several else Estimates(found.x_hat[0], *alone)


def _uses_input(estimator: Estimator, ny: int) -> bool:
    """Whether two inputs lead to different estimates, where an estimator does not show the matrix of its input."""
    y, (state, _) = np.zeros((1, ny)), estimator.correct(0, estimator.init(1), np.zeros((1, ny)))
    ends = [estimator.correct(1, estimator.predict(0, state, np.full((1, 1), each)), y)[1] for each in (0.0, 0.7)]
    return not np.array_equal(as_estimate(ends[0]).x_hat, as_estimate(ends[1]).x_hat, equal_nan=True)


def _given(name: str, values: ArrayLike, several: bool) -> Float[Array, "runs samples n"]:
    """Return recorded values with the run first; a DesignError says which shape fits."""
    try:
        array = real_numbers(values)
    except ValueError:
        raise DesignError(f"{name} must be real numbers, ({'runs, ' * several}samples, n{name})", name) from None
    if array.ndim != 2 + several or not array.size:
        hint = f", as {name}[:, None] is for one column" if array.ndim == 1 else ""
        raise DesignError(f"{name} has shape {array.shape}; ({'runs, ' * several}samples, n{name}) fits{hint}", name)
    return array if several else array[None]


def _filtered(
    estimator: Estimator, y: Float[Array, "runs samples ny"], u: Float[Array, "runs samples nu"]
) -> Estimates:
    """Correct and predict at every sample, as in a simulation."""
    n_runs, samples = y.shape[:2]
    journal, runs = Journal(call=None if estimator.holds else passed_on), RunState.of(n_runs)
    state = RunStart(0, tuple(range(n_runs)), journal).estimator(estimator, n_runs, None, runs)
    alive = runs.alive
    called: Any = CheckedEstimator(estimator, alive, journal) if is_own(estimator) else estimator
    # What is not known of the last u tells nothing of y.
    known = np.pad(u, ((0, 0), (0, samples - u.shape[1]), (0, 0)), constant_values=np.nan).swapaxes(0, 1)
    called = called if estimator.fed is None else FedEstimator(called, estimator, known)
    recorder, failed = Recorder(samples, n_runs), np.zeros((n_runs, samples), dtype=bool)
    for k in range(samples):
        state, answer = called.correct(k, state, y[:, k].copy())
        for failure in journal.failures.values():
            raise InvalidReturnValue(f"run {failure.run}: {failure.message}")
        estimate = as_estimate(answer)
        alive &= (estimate.status == Status.OK) & np.isfinite(estimate.x_hat).all(axis=1)
        failed[:, k] = ~alive
        recorder.at(k, x_hat=estimate.x_hat, **{name: estimate.info[name] for name in ("e",) if name in estimate.info})
        recorder.matrix_at(k, "P", estimate.P)
        recorder.matrix_at(k, "S", estimate.info.get("S"))
        if k < samples - 1:
            state = called.predict(k, state, u[:, k].copy())
    for text, n in journal.warnings.items():
        warnings.warn(f"{text} ({n} times)", RuntimeWarning, stacklevel=3)
    signals, P, S = recorder.all(), recorder.matrix("P"), recorder.matrix("S")
    x_hat, e = signals["x_hat"], signals.get("e")
    for each in (x_hat, P, e, S):
        if each is not None:
            each[failed] = np.nan
    return Estimates(x_hat, P, e, S, None if e is None or S is None else _nis(e, S))


def _nis(e: Float[Array, "runs samples ny"], S: Float[Array, "runs samples ny ny"]) -> Float[Array, "runs samples"]:
    nis, known = np.full(e.shape[:2], np.nan), np.isfinite(e).all(axis=2)
    nis[known] = (e[known] * np.linalg.solve(S[known], e[known][..., None])[..., 0]).sum(axis=1)
    return nis
