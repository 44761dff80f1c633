"""Coverage of adjusted and plain intervals: constructed populations, and disjoint subsamples of stored trials.

`python tests/coverage_study.py SETS adjusted [N:DIR ..]` prints the table; N:DIR are samples of N runs of the trials
that a directory holds, whose own averages, adjusted where they can be, are the true values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from comparison_tables import table

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.analysis.trials import Trials

UNIT = {"dist": "uniform", "low": -1, "high": 1}
SEED = 20261130


class Coverage(NamedTuple):
    """What a number of samples shows."""

    adjusted: float
    plain: float
    ratio: float
    """Of the median widths, plain over adjusted."""
    wrong: float
    """Share of samples in which a method that does not differ has a direction."""
    forms: Mapping[str, int]

    @property
    def text(self) -> str:
        """A line of the table."""
        forms = ", ".join(f"{name} {n}" for name, n in self.forms.items())
        return f"{self.adjusted:9.3f}{self.plain:9.3f}{self.ratio:8.2f}{self.wrong:8.3f}  {forms}"


def unrelated(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Normal differences that do not depend on the draws."""
    return 0.1 * rng.standard_normal(len(u))


def unrelated_lognormal(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Skewed differences that do not depend on the draws."""
    return 0.1 * (np.exp(rng.standard_normal(len(u))) - math.exp(0.5))


def kink(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A function with an edge; max(u, 0.5) has the mean 0.5 + 0.0625."""
    return np.maximum(u[:, 0], 0.5) - 0.5625


def jump(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A function that jumps where three quarters of the runs end."""
    return (u[:, 0] + u[:, 1] > 1) - 0.125


def ties(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Equal values in 80 % of the runs."""
    return np.where(np.abs(u[:, 0]) < 0.2, u[:, 1], 0.0)


def heteroscedastic(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise whose size grows with a quantity."""
    return 0.1 * np.exp(3 * u[:, 0]) * rng.standard_normal(len(u))


def failing(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Runs with large u fail; the others have the mean 0 of u - 0.2 below 0.6, whose mean is -0.2."""
    return np.where(u[:, 0] > 0.6, np.nan, u[:, 0] + 0.2 + 0.2 * u[:, 1] * u[:, 0])


POPULATIONS: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {
    "unrelated normal": unrelated,
    "unrelated log-normal": unrelated_lognormal,
    "kink": kink,
    "jump": jump,
    "ties 80 %": ties,
    "exp(3u) times noise": heteroscedastic,
    "failures depend on u": failing,
}
"""Name -> log ratios of mean 0 at (n, 2) uniform draws."""


def samples(name: str, n: int, sets: int) -> Iterator[Trials]:
    """Yield experiments of a constructed population."""
    place = [*POPULATIONS].index(name)
    for number in range(sets):
        rng = np.random.Generator(np.random.PCG64([SEED, place, n, number]))
        u = rng.uniform(-1, 1, (n, 2))
        drawn = {"run": np.arange(n), "eps": u[:, 0], "eta": u[:, 1]}
        values = {"B": np.ones(n), "A": np.exp(POPULATIONS[name](u, rng))}
        yield table(values, quantities=drawn, laws={"eps": UNIT, "eta": UNIT}, random_besides=("noise",))


def stored(trials: Trials, n: int, sets: int) -> Iterator[Trials]:
    """Yield disjoint samples of n runs of the trials of an experiment."""
    for number in range(min(sets, len(trials.runs) // n)):
        yield trials._of_runs(trials.runs[number * n : (number + 1) * n])


def coverage(made: Iterator[Trials], truth: float, method: str, average: str = "geometric") -> Coverage:
    """Count in how many samples the true change [%] of a method lies in the two intervals of an average."""
    inside, widths, wrong, forms = list[Any](), list[Any](), 0, dict[str, int]()
    for trials in made:
        row = next(row for row in comparisons(trials) if row["method"] == method and row["verdict"])
        plain = [row[f"{average}_low"], row[f"{average}_high"]]
        adjusted = [row[f"{average}_adjusted_low"], row[f"{average}_adjusted_high"]]
        ends = [plain if math.isnan(adjusted[0]) else adjusted, plain]
        if math.isnan(plain[0]):
            continue
        inside.append([low <= truth <= high for low, high in ends])
        widths.append([high - low for low, high in ends])
        wrong += row["verdict"].startswith(("better", "worse"))
        form = row["adjusted_form"] or "plain"
        forms[form] = forms.get(form, 0) + 1
    (of_adjusted, of_plain), (narrow, wide) = np.mean(inside, axis=0), np.median(widths, axis=0)
    return Coverage(of_adjusted, of_plain, wide / narrow, wrong / len(inside), forms)


def main(sets: int, places: list[str]) -> None:
    """Print the table of constructed populations, or of stored trials."""
    print(f"{'population':34}{'n':>5}{'adjusted':>9}{'plain':>9}{'ratio':>8}{'wrong':>8}  forms")
    for name in POPULATIONS if not places else ():
        for n in (60, 120, 300):
            print(f"{name:34}{n:5}{coverage(samples(name, n, sets), 0.0, 'A').text}", flush=True)
    for place in places:
        from rmpc_bench import load_results

        size, _, directory = place.partition(":")
        trials, n = load_results(directory).trials.common, int(size)
        [info] = [each for each in (trials.primary_info,) if each is not None]
        for method in (name for name in trials.methods if name != trials.baseline):
            whole = next(row for row in comparisons(trials) if (row["method"], row["metric"]) == (method, info.name))
            for average in ("geometric", "mean"):
                # The plain average of all runs may be less certain than the adjusted one of some of them.
                adjusted, plain = (whole[f"{average}{kind}_pct"] for kind in ("_adjusted", ""))
                value = plain if math.isnan(adjusted) else adjusted
                found = coverage(stored(trials, n, sets), value, method, average)
                print(f"{f'{trials.name}, {method}, {average}':34}{n:5}{found.text}", flush=True)
