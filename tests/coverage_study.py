"""Coverage of every printed interval and share of wrong verdicts, by simulating whole experiments.

An experiment draws runs with replacement from a population (see populations.py), and the product compares the methods
as for any user.  Because the population is finite, its own averages are the true values.  Print the table with

    python tests/coverage_study.py [EXPERIMENTS] [claims | adjusted [N:DIR ..]]

The words print the intervals of claims only, or those of adjusted comparisons (see adjusted_study.py).
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import adjusted_study
import numpy as np
import pandas as pd
from data_frames import arrays
from populations import Population, populations

from rmpc_bench.analysis import comparison
from rmpc_bench.analysis.intervals import student
from rmpc_bench.analysis.levels import planned_level, schedule
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.grammar import Link, parse
from rmpc_bench.claims.spread import spread_of
from rmpc_bench.types import MetricInfo

LEVEL, RELEVANT = 0.95, 0.01
SEED = 20261122


@dataclass(frozen=True)
class Truth:
    """True values of a method against the baseline.

    Parameters
    ----------
    geometric, mean : log of the geometric mean ratio, and of the ratio of the means; NaN where there is none
    difference : mean difference of a signed metric; NaN for ratios
    superiority : P(better) + P(tied)/2
    failed : difference of the shares of failed runs
    """

    geometric: float
    mean: float
    difference: float
    superiority: float
    failed: float


def truth(population: Population, column: int) -> Truth:
    """Compute the true values from the definitions in the documentation, not with the code under study."""
    values = np.abs(population.values) if population.direction == "zero" else population.values
    a, b = values[:, column], values[:, 0]
    ok = ~(np.isnan(a) | np.isnan(b))
    failed = np.isnan(a).mean() - np.isnan(b).mean()
    signed = population.direction == "zero"
    with np.errstate(all="ignore"):
        gap = a - b if signed else np.where(a == b, 0.0, np.log(a) - np.log(b))
    tied = np.abs(gap) <= (0.0 if signed else np.log1p(RELEVANT) + 1e-12)
    better = np.where(ok, (gap < 0) & ~tied, np.isnan(b) & ~np.isnan(a))
    worse = np.where(ok, (gap > 0) & ~tied, np.isnan(a) & ~np.isnan(b))
    superiority = better.mean() + (1 - better.mean() - worse.mean()) / 2
    if population.may_not_occur or not np.isfinite(gap[ok]).all():
        return Truth(np.nan, np.nan, np.nan, superiority, failed)
    if signed:
        return Truth(np.nan, np.nan, gap[ok].mean(), superiority, failed)
    return Truth(gap[ok].mean(), np.log(a[ok].mean() / b[ok].mean()), np.nan, superiority, failed)


def table_of(population: Population, runs: np.ndarray, confidence: float) -> Trials:
    """Make the table of trials of an experiment with these runs of a population."""
    values = population.values[runs]
    n, n_methods = values.shape
    methods = tuple(f"M{i}" for i in range(n_methods))
    flat = values.T.ravel()
    frame = pd.DataFrame(
        {
            "method": np.repeat(methods, n),
            "run": np.tile(np.arange(n), n_methods),
            "status": np.where(np.isnan(flat), "diverged", "ok"),
            "m": flat,
        }
    )
    info = MetricInfo("m", "", population.direction, may_not_occur=population.may_not_occur)
    return Trials(
        name="study",
        methods=methods,
        labels={},
        metrics=(info,),
        columns=arrays(frame),
        over_time=(),
        baseline=methods[0],
        confidence=confidence,
        relevant=RELEVANT,
        seed=SEED,
    )


def compared(population: Population, runs: np.ndarray, confidence: float = LEVEL) -> list[Mapping[str, object]]:
    """Return the rows of comparisons.csv of an experiment, without the signed-rank p, which no verdict reads."""
    trials = table_of(population, runs, confidence)
    rows = comparison.compared(trials, trials.metrics[0], comparison.levels(trials))
    return [row for _, row in rows]


def is_wrong(word: str, row: Mapping[str, object], true: Truth) -> bool:
    """Whether a verdict contradicts the true values; an inconclusive one never does."""
    signed = not np.isnan(true.difference)
    size, margin = (true.difference, 0.0) if signed else (true.geometric, np.log1p(RELEVANT))
    if word == "fails-more":
        return true.failed <= 0
    if word == "depends-on-average":
        return true.geometric * true.mean >= 0
    if word == "equivalent":
        return abs(size) > margin * (1 + 1e-9)
    if word == "inconclusive":
        return False
    sign = 1 if word.startswith("better") else -1
    by_counts = row["won"] + row["lost"] == 0 or np.isnan(size) or _few(row)
    if by_counts:
        return sign * (true.superiority - 0.5) <= 0
    beyond = 0.0 if word.endswith("size-uncertain") else margin
    return -sign * size <= beyond * (1 - 1e-9)


def _few(row: Mapping[str, object]) -> bool:
    return row["won"] + row["lost"] - row["failed_only"] - row["baseline_failed_only"] < 20


def study(population: Population, n: int, experiments: int) -> dict[str, float]:
    """Simulate experiments of n runs.

    Returns
    -------
    kind of interval -> share of experiments in which it contains the true value, the lowest over the methods;
    ``all methods``: share in which the intervals of all methods do; ``wrong``: share in which any verdict is wrong
    """
    rng = np.random.Generator(np.random.PCG64([SEED, n]))
    truths = [truth(population, column) for column in range(1, population.values.shape[1])]
    held: dict[str, Counter[int]] = {}
    n_all = n_wrong = 0
    for _ in range(experiments):
        rows = compared(population, rng.integers(0, len(population.values), n))
        together, wrong = True, False
        for i, (row, true) in enumerate(zip(rows, truths, strict=True)):
            for kind, inside in _intervals(row, true):
                held.setdefault(kind, Counter())[i] += inside
                together &= inside or kind != _deciding(row)
            wrong |= is_wrong(str(row["verdict"]), row, true)
        n_all += together
        n_wrong += wrong
    shares = {kind: min(counts.values()) / experiments for kind, counts in held.items()}
    return shares | {"all methods": n_all / experiments, "wrong": n_wrong / experiments}


def _deciding(row: Mapping[str, object]) -> str:
    return str(row["average"]) or "superiority"


def _intervals(row: Mapping[str, object], true: Truth) -> Iterator[tuple[str, bool]]:
    """Yield kind and whether the interval contains the true value, for each interval of a row that has one."""
    for kind in ("geometric", "mean"):
        value = getattr(true, kind)
        if not np.isnan(value):
            yield kind, _inside(np.expm1(value) * 100, row[f"{kind}_low"], row[f"{kind}_high"])
    if not np.isnan(true.difference):
        yield "difference", _inside(true.difference, row["difference_low"], row["difference_high"])
    yield "superiority", _inside(true.superiority, row["superiority_low"], row["superiority_high"])
    yield "failures", _inside(true.failed, row["failed_low"], row["failed_high"])


def _inside(value: float, low: object, high: object) -> bool:
    slack = 1e-9 * max(1.0, abs(value))
    # An interval that is not printed claims nothing.
    return bool(np.isnan(low) or low - slack <= value <= high + slack)  # type: ignore[arg-type, operator]


def study_of_looks(population: Population, min_runs: int, max_runs: int, experiments: int) -> float:
    """Return the share of experiments whose verdict is wrong for any method at any planned look."""
    looks = schedule(min_runs, max_runs)
    confidence = planned_level(LEVEL, len(looks))
    rng = np.random.Generator(np.random.PCG64([SEED, min_runs, max_runs]))
    truths = [truth(population, column) for column in range(1, population.values.shape[1])]
    n_wrong = 0
    for _ in range(experiments):
        runs = rng.integers(0, len(population.values), max_runs)
        n_wrong += any(
            is_wrong(str(row["verdict"]), row, true)
            for n in looks
            for row, true in zip(compared(population, runs[:n], confidence), truths, strict=True)
        )
    return n_wrong / experiments


def study_of_means(values: np.ndarray, n: int, experiments: int) -> float:
    """Return the coverage of the Student interval of the mean in summary.csv."""
    rng = np.random.Generator(np.random.PCG64([SEED, n]))
    true = values.mean()
    intervals = (student(values[rng.integers(0, len(values), n)], LEVEL) for _ in range(experiments))
    return sum(low <= true <= high for low, high in intervals) / experiments


CLAIMED = {
    "mean": "mean(m[A]) - mean(m[B]) < 1",
    "ratio of means": "ratio(mean(m[A]), mean(m[B])) < 1",
    "geometric": "ratio(m[A], m[B]) < 1",
    "share": "share(m[A] < 2) < 0",
    "rare share": "share(m[A] > 10) < 0",
    "difference of shares": "share(m[A] < 1) < share(m[B] < 1)",
    "median": "median(m[A]) < 1",
    "quantile 0.9": "quantile(m[A], 0.9) < 1",
    "quantile 0.99": "quantile(m[A], 0.99) < 1",
    "medians": "median(m[A]) < median(m[B])",
    "quantiles 0.9": "quantile(m[A], 0.9) < quantile(m[B], 0.9)",
    "smallest": "min(m[A]) < 1",
    "largest": "max(m[A]) < 1",
    "standard deviations": "std(m[A]) < std(m[B])",
    "standard deviation": "std(m[A]) < 1",
    "mean of skewed": "mean(m[A]) < 1",
}
"""Every interval of claims that are about columns over the runs; `analysis` covers those of moments."""


def study_of_claims(n: int, experiments: int, kinds: Iterable[str] = tuple(CLAIMED)) -> dict[str, tuple[float, float]]:
    """Return for every kind the shares of experiments whose interval of left - right is above and below the truth.

    A and B are paired, both with standard normal logs that have a correlation of 0.36, in a population of 100,000.
    """
    rng = np.random.Generator(np.random.PCG64([SEED, n]))
    common, own = rng.normal(size=(100_000, 1)), rng.normal(size=(100_000, 2))
    names, values = ("A", "B"), np.exp(0.6 * common + 0.8 * own)
    info = MetricInfo("m", "", "lower")
    links = {kind: parse(CLAIMED[kind]).links[0] for kind in kinds}

    def evaluator(rows: np.ndarray, link: Link) -> Evaluator:
        flat = values[rows].T.ravel()
        columns = {"method": np.repeat(names, len(rows)), "run": np.tile(np.arange(len(rows)), 2), "status": "ok"}
        frame = pd.DataFrame({**columns, "m": flat})
        trials = Trials("claims", names, {}, (info,), arrays(frame), (), "B", LEVEL, RELEVANT, SEED)
        return Evaluator(trials, link)

    missed: dict[str, list[tuple[bool, bool]]] = {kind: [] for kind in kinds}
    whole = np.arange(len(values))
    true = {kind: evaluator(whole, link).sides(link) for kind, link in links.items()}
    for _ in range(experiments):
        rows = rng.integers(0, len(values), n)
        for kind, link in links.items():
            spread = spread_of(link, evaluator(rows, link), LEVEL)
            assert spread is not None
            (low, high), gap = spread.gap(), float(true[kind][0].array - true[kind][1])
            missed[kind].append((low > gap, high < gap))
    return {
        kind: (float(above), float(below)) for kind, each in missed.items() for above, below in [np.mean(each, axis=0)]
    }


def main() -> None:
    """Print the table of all populations at 50 and 200 runs, and that of claims at 20, 60 and 200."""
    experiments = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    if "adjusted" in sys.argv:
        adjusted_study.main(experiments, sys.argv[sys.argv.index("adjusted") + 1 :])
        return
    if "claims" not in sys.argv:
        print_comparisons(experiments)
    print(f"{'claim':48}{'n':>5}{'above':>9}{'below':>9}")
    for n in (20, 60, 200):
        for kind, (above, below) in study_of_claims(n, experiments).items():
            print(f"{CLAIMED[kind]:48}{n:5}{above:9.3f}{below:9.3f}", flush=True)


def print_comparisons(experiments: int) -> None:
    """Print the coverage of the intervals of the tables, and the wrong verdicts of four looks."""
    kinds = ["geometric", "mean", "difference", "superiority", "failures", "all methods", "wrong"]
    print(f"{'population':38}{'n':>5}" + "".join(f"{kind:>13}" for kind in kinds))
    for name, population in populations().items():
        for n in (50, 200):
            found = study(population, n, experiments)
            cells = "".join(f"{found[kind]:13.3f}" if kind in found else f"{'-':>13}" for kind in kinds)
            print(f"{name:38}{n:5}{cells}", flush=True)
    chosen = populations()["Fig. 7, no change"]
    print(f"looks at 50, 100, 200, 400: wrong {study_of_looks(chosen, 50, 400, experiments):.3f}")


if __name__ == "__main__":
    main()
