"""Every conformance check fails for a component that breaks its rule, and passes for the one that keeps it."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pytest
from conftest import random_psd
from matplotlib.figure import Figure as MplFigure

from rmpc_bench.conformance import (
    ControllerExample,
    EstimatorExample,
    FigureExample,
    MetricExample,
    NoiseExample,
    PlantExample,
    ReferenceExample,
    check_component,
)
from rmpc_bench.types import (
    Command,
    Controller,
    Estimate,
    Estimator,
    Figure,
    Issue,
    Metric,
    Motion,
    Noise,
    Plant,
    Record,
    Reference,
)


class X(NamedTuple):
    """A state of one array."""

    x: np.ndarray


def ok(n_runs):
    """Statuses of runs that have not failed."""
    return np.zeros(n_runs, dtype=np.int8)


def failed(component, example):
    """Names of the checks that fail."""
    return {result.id for result in check_component(component, example) if result.status == "failed"}


# -- estimators --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Filter(Estimator):
    """x_hat = x + (y - x) / 2, predicted by x_hat + u / 10."""

    calls: list = field(default_factory=list)

    def init(self, n_runs):
        return X(np.zeros((n_runs, 1)))

    def correct(self, k, state, y):
        x_hat = state.x + 0.5 * (self.used(y) - state.x)
        return X(x_hat), Estimate(x_hat, None, None, self.status(len(y)), {})

    def used(self, y):
        return y

    def status(self, n_runs):
        return ok(n_runs)

    def predict(self, k, state, u):
        return X(state.x + 0.1 * u)


class MutableFilter(Filter):
    __setattr__ = object.__setattr__


class FloatStatus(Filter):
    def status(self, n_runs):
        return np.zeros(n_runs)


class InPlace(Filter):
    def used(self, y):
        y *= 0.5
        return y


class Counting(Filter):
    def used(self, y):
        self.calls.append(1)
        return y + 1e-3 * len(self.calls)


class Centred(Filter):
    def used(self, y):
        return y - y.mean(axis=0)


class ByRow(Filter):
    def used(self, y):
        return y + 1e-3 * np.arange(len(y))[:, None]


class Unpicklable(Filter):
    def __reduce__(self):
        raise TypeError("no copy of this")


class Hiding(Filter):
    def used(self, y):
        return np.nan_to_num(y)


class ShortSeries(Filter):
    def series(self):
        return {"K": np.zeros((3, 1, 1))}


def test_a_filter_that_keeps_the_rules_passes():
    """Oracle: the rules by inspection of five lines."""
    assert failed(Filter(), EstimatorExample.random(1, 1)) == set()


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (MutableFilter, "frozen"),
        (FloatStatus, "shapes"),
        (InPlace, "arguments"),
        (Counting, "purity"),
        (Centred, "batch-independence"),
        (ByRow, "order"),
        (Unpicklable, "pickle"),
        (Hiding, "missing-measurement"),
        (Centred, "missing-measurement"),
        (ShortSeries, "series"),
    ],
)
def test_estimator_checks(broken, check):
    """A broken rule is found; the others are checked all the same."""
    assert check in failed(broken(), EstimatorExample.random(1, 1))
    assert len(check_component(broken(), EstimatorExample.random(1, 1))) == len(EstimatorExample.checks)


def test_a_failure_gives_its_reason():
    """The first entry that differs, or the exception, stands in the result."""
    reasons = {result.id: result.reason for result in check_component(ByRow(), EstimatorExample.random(1, 1))}
    assert reasons["batch-independence"].startswith("x_hat of run 1 alone[0, 0, 0] is ") and reasons["shapes"] == ""
    [pickled] = [each for each in check_component(Unpicklable(), EstimatorExample.random(1, 1)) if each.id == "pickle"]
    text = "failed  pickle: a copy made by pickle gives the same bits (raised TypeError: no copy of this at "
    assert str(pickled).startswith(f"{text}test_checks.py:")


# -- controllers -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Law(Controller):
    """u = r - x_hat plus a tenth of the last input."""

    calls: list = field(default_factory=list)

    def init(self, n_runs):
        return X(np.zeros((n_runs, 1)))

    def control(self, k, state, y, estimate, r):
        u = self.law(estimate.x_hat, r) + 0.1 * state.x
        return X(u), Command(u, self.status(len(u)), {})

    def law(self, x_hat, r):
        return r[:1] - x_hat

    def status(self, n_runs):
        return ok(n_runs)


class MutableLaw(Law):
    __setattr__ = object.__setattr__


class LawFloatStatus(Law):
    def status(self, n_runs):
        return np.zeros(n_runs)


class LawInPlace(Law):
    def law(self, x_hat, r):
        r += 1.0
        return r[:1] - x_hat


class LawCounting(Law):
    def law(self, x_hat, r):
        self.calls.append(1)
        return r[:1] - x_hat + 1e-3 * len(self.calls)


class LawCentred(Law):
    def law(self, x_hat, r):
        return r[:1] - x_hat + x_hat.mean(axis=0)


class LawByRow(Law):
    def law(self, x_hat, r):
        return r[:1] - x_hat + 1e-3 * np.arange(len(x_hat))[:, None]


class LawUnpicklable(Law):
    def __reduce__(self):
        raise TypeError("no copy of this")


class LawHiding(Law):
    def law(self, x_hat, r):
        return r[:1] - np.nan_to_num(x_hat)


def test_a_law_that_keeps_the_rules_passes():
    """Oracle: the rules by inspection of three lines."""
    assert failed(Law(), ControllerExample.random(1, 1, 1)) == set()


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (MutableLaw, "frozen"),
        (LawFloatStatus, "shapes"),
        (LawInPlace, "arguments"),
        (LawCounting, "purity"),
        (LawCentred, "batch-independence"),
        (LawByRow, "order"),
        (LawUnpicklable, "pickle"),
        (LawHiding, "missing-estimate"),
    ],
)
def test_controller_checks(broken, check):
    """A broken rule is found."""
    assert check in failed(broken(), ControllerExample.random(1, 1, 1))


# -- plants ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Walk(Plant):
    """x(k+1) = a x + u + w, y = x + v."""

    calls: list = field(default_factory=list)
    nx, nu, ny, Ts = 1, 1, 1, 0.1
    nominal = {"a": 0.9}

    def draw(self, parameters, rngs, n_steps):
        return X(parameters["a"])

    def step(self, k, delta, x, u, w):
        moved = self.moved(delta, x, u, w)
        return Motion(moved, self.status(len(moved)))

    def moved(self, delta, x, u, w):
        return delta.x[:, None] * x + u + w

    def status(self, n_runs):
        return ok(n_runs)

    def output(self, k, delta, x, v):
        return x + v


class MutableWalk(Walk):
    __setattr__ = object.__setattr__


class WalkFloatStatus(Walk):
    def status(self, n_runs):
        return np.zeros(n_runs)


class WalkInPlace(Walk):
    def moved(self, delta, x, u, w):
        x *= 0.5
        return x + u + w


class WalkCounting(Walk):
    def moved(self, delta, x, u, w):
        self.calls.append(1)
        return delta.x[:, None] * x + u + 1e-3 * len(self.calls)


class WalkCentred(Walk):
    def moved(self, delta, x, u, w):
        return delta.x[:, None] * (x - x.mean(axis=0)) + u


class WalkByRow(Walk):
    def moved(self, delta, x, u, w):
        return x + u + 1e-3 * np.arange(len(x))[:, None]


class WalkUnpicklable(Walk):
    def __reduce__(self):
        raise TypeError("no copy of this")


class WalkHiding(Walk):
    def moved(self, delta, x, u, w):
        return np.nan_to_num(x) + u + w


class WalkWithoutNominal(Walk):
    nominal = {"a": np.nan}


def test_a_plant_that_keeps_the_rules_passes():
    """Oracle: the rules by inspection of three lines."""
    assert failed(Walk(), PlantExample.random(Walk())) == set()


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (MutableWalk, "frozen"),
        (WalkFloatStatus, "shapes"),
        (WalkInPlace, "arguments"),
        (WalkCounting, "purity"),
        (WalkCentred, "batch-independence"),
        (WalkByRow, "order"),
        (WalkUnpicklable, "pickle"),
        (WalkHiding, "missing-number"),
        (WalkWithoutNominal, "nominal"),
    ],
)
def test_plant_checks(broken, check):
    """A broken rule is found."""
    assert check in failed(broken(), PlantExample.random(Walk()))


# -- noises and references ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Coin(Noise):
    """Noise of +-1."""

    mean = np.zeros(1)
    cov = np.eye(1)

    def draw(self, rng, n_samples):
        return np.where(rng.random((n_samples, 1)) < 0.5, -1.0, 1.0)


class MutableCoin(Coin):
    __setattr__ = object.__setattr__


class CoinFlat(Coin):
    def draw(self, rng, n_samples):
        return super().draw(rng, n_samples)[:, 0]


class CoinGlobal(Coin):
    def draw(self, rng, n_samples):
        return np.random.default_rng().standard_normal((n_samples, 1))


class CoinByLength(Coin):
    def draw(self, rng, n_samples):
        return super().draw(rng, n_samples)[::-1]


class CoinWithNames(Coin):
    burst_names = ("burst_1_from",)


class CoinBiased(Coin):
    mean = np.full(1, 0.1)


class CoinNarrow(Coin):
    cov = np.full((1, 1), 0.9)


def test_a_noise_law_that_keeps_the_rules_passes():
    """Oracle: a fair coin has mean 0 and variance 1."""
    assert failed(Coin(), NoiseExample(1)) == set()


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (MutableCoin, "frozen"),
        (CoinFlat, "shapes"),
        (CoinGlobal, "generator"),
        (CoinByLength, "prefix"),
        (CoinWithNames, "bursts"),
        (CoinBiased, "moments"),
        (CoinNarrow, "moments"),
    ],
)
def test_noise_checks(broken, check):
    """A broken rule is found."""
    assert check in failed(broken(), NoiseExample(1))


@dataclass(frozen=True)
class Ramp(Reference):
    """r(k) = k."""

    kept: np.ndarray = field(default_factory=lambda: np.arange(100.0)[:, None])

    def sample(self, n_samples):
        return self.kept[:n_samples].copy()


class MutableRamp(Ramp):
    __setattr__ = object.__setattr__


class RampFlat(Ramp):
    def sample(self, n_samples):
        return self.kept[:n_samples, 0].copy()


class RampByLength(Ramp):
    def sample(self, n_samples):
        return self.kept[:n_samples] / n_samples


class RampShared(Ramp):
    def sample(self, n_samples):
        return self.kept[:n_samples]


def test_a_reference_that_keeps_the_rules_passes():
    """Oracle: the rules by inspection of one line."""
    assert failed(Ramp(), ReferenceExample(1)) == set()


@pytest.mark.parametrize(
    ("broken", "check"),
    [(MutableRamp, "frozen"), (RampFlat, "shapes"), (RampByLength, "prefix"), (RampShared, "purity")],
)
def test_reference_checks(broken, check):
    """A broken rule is found."""
    assert check in failed(broken(), ReferenceExample(1))


# -- metrics -----------------------------------------------------------------------------------------------------------


def trajectories():
    """Five runs of seven samples with two states, one output and one input."""
    rng = np.random.default_rng(3)
    x, x_hat = rng.standard_normal((2, 5, 7, 2))
    P = np.stack([random_psd(rng, 2) for _ in range(35)]).reshape(5, 7, 2, 2)
    return Record(0.5, x, x[:, :, :1], x_hat, rng.standard_normal((5, 6, 1)), np.zeros((7, 1)), P=P)


@dataclass(frozen=True, kw_only=True)
class Largest(Metric):
    """Largest absolute output."""

    name: str = "largest"
    calls: list = field(default_factory=list)

    def evaluate(self, record):
        return np.abs(record.y).max(axis=(1, 2))


class Ungraded(Largest):
    better = "more"


class Refusing(Largest):
    def check(self, layout):
        yield Issue("", "cannot be computed")


class OutOfBounds(Largest):
    bounds = (0.0, 0.1)


class Summed(Largest):
    def evaluate(self, record):
        return np.abs(record.y).max(axis=1)


class Overwriting(Largest):
    def evaluate(self, record):
        record.y[:] = np.abs(record.y)
        return record.y.max(axis=(1, 2))


class Ranked(Largest):
    def evaluate(self, record):
        values = super().evaluate(record)
        return values / values.max()


class Numbered(Largest):
    def evaluate(self, record):
        return super().evaluate(record) + np.arange(len(record.y))


class Averaged(Largest):
    def evaluate(self, record):
        return super().evaluate(record) + 0.0 * record.y.sum()


def test_a_metric_that_keeps_the_rules_passes():
    """Oracle: the rules by inspection of one line."""
    assert failed(Largest(), MetricExample(trajectories())) == set()


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (Ungraded, "facts"),
        (Refusing, "facts"),
        (OutOfBounds, "shapes"),
        (Summed, "shapes"),
        (Overwriting, "arguments"),
        (Ranked, "batch-independence"),
        (Numbered, "order"),
        (Averaged, "diverged-run"),
    ],
)
def test_metric_checks(broken, check):
    """A broken rule is found."""
    assert check in failed(broken(), MetricExample(trajectories()))


def test_a_metric_must_derive_from_the_base_class():
    """A class with the same methods is not enough: tables need its direction, its unit and its needs."""
    example = MetricExample(trajectories())

    class Imitation:
        evaluate = Largest.evaluate

    assert "base-class" in failed(Imitation(), example)
    assert failed(replace(Largest(), name="no name"), example) == {"facts"}


# -- figures -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Means(Figure):
    """The mean of every method as a dot."""

    needs_runs = True

    def draw(self, results):
        figure = MplFigure(figsize=(self.drawn_width(), 2.0))
        axes = figure.subplots()
        axes.plot(self.means(results), "o")
        return figure

    def drawn_width(self):
        return self.width

    def means(self, results):
        return [np.mean(results.column("mse", method)) for method in results.methods]


class MutableMeans(Means):
    __setattr__ = object.__setattr__


class MeansNever(Means):
    def check(self, layout):
        yield Issue("", "cannot be drawn")


class MeansAlways(Means):
    def check(self, layout):
        return iter(())


class MeansRandom(Means):
    def means(self, results):
        return np.random.default_rng().standard_normal(3)


class MeansOverwriting(Means):
    def means(self, results):
        results.frame["mse"] += 1.0
        return [1.0]


class MeansNarrow(Means):
    def drawn_width(self):
        return 2.0


@pytest.fixture
def results(make_trials):
    """Two methods with three runs."""
    return FigureExample(make_trials({"mse": {"A": [1.0, 2.0, 4.0], "B": [2.0, 3.0, 5.0]}}))


def test_a_figure_that_keeps_the_rules_passes(results):
    """Oracle: the rules by inspection of a few lines."""
    assert failed(Means(), results) == set()


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (MutableMeans, "frozen"),
        (MeansNever, "accepted"),
        (MeansAlways, "refused"),
        (MeansRandom, "same-bytes"),
        (MeansOverwriting, "same-bytes"),
        (MeansNarrow, "width"),
    ],
)
def test_figure_checks(broken, check, results):
    """A broken rule is found."""
    assert check in failed(broken(), results)
