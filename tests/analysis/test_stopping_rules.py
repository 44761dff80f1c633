"""Stopping rules by simulation: wrong findings, and coverage of the intervals at a stop that the runs choose."""

import numpy as np
import pytest
from coverage_study import compared, table_of
from populations import Population

from rmpc_bench.analysis.intervals import student
from rmpc_bench.analysis.levels import next_width_look, planned_level, schedule
from rmpc_bench.analysis.resolution import half_widths
from rmpc_bench.claims.claim import Claim, Finding
from rmpc_bench.claims.verdict import judge

LEVEL, EXPERIMENTS, SEED = 0.95, 1000, 17
STANDARD_ERROR = np.sqrt(LEVEL * (1 - LEVEL) / EXPERIMENTS)
MIN_RUNS, MAX_RUNS = 100, 1600
TAIL = "rests on few runs of a long tail"
CLAIM = Claim("M1 is better than M0", "additional result", ("mean(m[M1]) < mean(m[M0])",))


def values(rng, n, ratio=1.0):
    """Paired log-normal values of two methods; with the ratio 1 they have the same law, so that no order is right."""
    common = rng.normal(0.0, 0.5, n)
    logs = common[:, None] + rng.normal(0.0, 0.2, (n, 2))
    return np.exp(logs) * [1.0, ratio]


def table(columns, confidence):
    """The table of trials of these runs."""
    return table_of(Population(columns, "lower"), np.arange(len(columns)), confidence)


@pytest.mark.slow
def test_planned_looks_at_claims_keep_their_error():
    """Any decision is wrong here.  Intervals at 95 % at a look every 50 runs decide far too often."""
    looks = schedule(MIN_RUNS, MAX_RUNS)
    level = planned_level(LEVEL, len(looks))
    rng = np.random.Generator(np.random.PCG64([SEED, 1]))
    n_planned = n_peeking = 0
    for _ in range(EXPERIMENTS):
        columns = values(rng, MAX_RUNS)
        gap = columns[:, 1] - columns[:, 0]
        found = (judge(CLAIM, table(columns[:n], level)).finding for n in looks)
        n_planned += any(finding is not Finding.INCONCLUSIVE for finding in found)
        ends = (student(gap[:n], LEVEL) for n in range(MIN_RUNS, MAX_RUNS + 1, 50))
        n_peeking += any(not low <= 0 <= high for low, high in ends)
    assert 0.02 <= n_planned / EXPERIMENTS <= 1 - LEVEL + 3 * STANDARD_ERROR
    assert n_peeking / EXPERIMENTS > 0.2
    print(f"wrong findings: planned looks {n_planned / EXPERIMENTS:.3f}, every 50 runs {n_peeking / EXPERIMENTS:.3f}")


@pytest.mark.slow
@pytest.mark.parametrize("resolve", [0.02, 0.04])
def test_a_stop_at_the_width_keeps_the_coverage(resolve):
    """The interval at the stop contains the true ratio as often as one of a fixed number of runs."""
    rng = np.random.Generator(np.random.PCG64([SEED, 2]))
    n_inside, stops = 0, []
    for _ in range(EXPERIMENTS):
        columns, n = values(rng, 2000, ratio=0.9), 50
        while (half := half_widths(table(columns[:n], LEVEL))[0].value) > resolve and n < 2000:
            n = next_width_look(n, half, resolve, 25, 2000)
        [row] = compared(Population(columns[:n], "lower"), np.arange(n))
        assert half <= resolve
        n_inside += row["geometric_low"] <= 100 * (0.9 - 1) <= row["geometric_high"]
        stops.append(n)
    print(f"resolve {resolve:g}: coverage {n_inside / EXPERIMENTS:.3f}, {np.mean(stops):.0f} runs on average")
    assert abs(n_inside / EXPERIMENTS - LEVEL) <= 3 * STANDARD_ERROR
    # Oracle: the number of runs for which 1.96 standard errors of the log ratio are the half width.
    needed = (1.96 * 0.2 * np.sqrt(2) / np.log1p(resolve)) ** 2
    assert needed * 0.9 <= np.mean(stops) <= needed * 1.15


@pytest.mark.parametrize(("half", "following"), [(np.inf, 200), (0.5, 200), (0.022, 110), (0.0201, 110)])
def test_the_next_look_at_the_width(half, following):
    """At most twice the runs, at least a step."""
    assert next_width_look(100, half, 0.02, 10, 1000) == following


@pytest.mark.parametrize(
    ("logs", "reason"),
    [
        (np.where(np.arange(300) < 3, np.log(9), 0.0), ""),
        (np.zeros(300), ""),
        (np.where(np.arange(300) % 30 < 1, 0.95, -0.05) + 1e-3 * np.sin(np.arange(300)), TAIL),
    ],
)
def test_a_width_takes_an_interval_that_runs_support(logs, reason):
    """Equal but for 3 of 300 runs: the narrow interval of the superiority says nothing of the change; ten events."""
    [found] = half_widths(table(np.exp(np.stack([0 * logs, logs], axis=1)), LEVEL))
    assert found.value == np.inf and found.reason == reason


def test_thirty_events_support_a_width():
    """The rule of Cochran with 20: skewness^2 is about n / k with k events."""
    logs = np.where(np.arange(600) % 20 < 1, 0.95, -0.05)
    [found] = half_widths(table(np.exp(np.stack([0 * logs, logs + 1e-3 * np.sin(np.arange(600))], axis=1)), LEVEL))
    assert 0.01 < found.value < 0.03
