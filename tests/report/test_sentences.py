"""Comparisons in words."""

import math
from dataclasses import replace

import pytest

from rmpc_bench.analysis.comparison_text import far_worse_bound, per_cent, verdict_text
from rmpc_bench.analysis.verdict import largest_share
from rmpc_bench.report.summary import sentence
from rmpc_bench.types import MetricInfo

MSE = MetricInfo("mse", "rad^2", "lower")
ROW = {
    **{"method": "R-MPC1", "baseline": "S-MPC", "metric": "mse", "average": "geometric", "verdict": "better"},
    **{"change_pct": -10.2, "ci_low": -11.3, "ci_high": -9.0, "ci_level": 0.95, "n_pairs": 200},
    **{"geometric_pct": -10.2, "geometric_low": -11.3, "geometric_high": -9.0},
    **{"mean_pct": -11.9, "mean_low": -13.0, "mean_high": -10.8},
    **{"difference": math.nan, "difference_low": math.nan, "difference_high": math.nan},
    **{"won": 162, "lost": 0, "tied": 38, "failed_only": 0, "baseline_failed_only": 0},
    **{"far_worse_runs": None, "far_worse_upper": math.nan},
    **{"runs_for_direction": None, "runs_for_equivalence": 1051},
}


@pytest.fixture
def trials(make_trials):
    """Return a table whose settings the sentences name: 95 %, 1 %."""
    return make_trials({"mse": {"R-MPC1": [1.0, 2.0], "S-MPC": [2.0, 4.0]}})


WON = "; won 162, lost 0, tied 38)"
GEOMETRIC = f"against S-MPC (geometric mean of the ratios, 200 paired runs, 95 % interval{WON}"
NEEDED = "(runs needed: about 430 for better or worse, about 1100 for equivalent)"
NO_CHANGE = dict.fromkeys(("change_pct", "ci_low", "ci_high", "geometric_pct", "mean_pct"), math.nan)
MEANS = {"geometric_pct": 20.1, "mean_pct": -23.0, "mean_low": -31.0, "mean_high": -15.0}
DIFFERENCE = {"average": "difference", "difference": -0.51, "difference_low": -0.62, "difference_high": -0.40}


def changed(value, low, high, verdict, **others):
    return {"change_pct": value, "ci_low": low, "ci_high": high, "verdict": verdict, **others}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, f"lowers mse by 10.2 % [9.0, 11.3] {GEOMETRIC}: better in these runs."),
        ({"verdict": ""}, f"lowers mse by 10.2 % [9.0, 11.3] {GEOMETRIC}."),
        (
            changed(5.0, 0.8, 9.0, "worse-size-uncertain", ci_level=0.97),
            f"raises mse by 5 % [1, 9] {GEOMETRIC}: worse, size uncertain.".replace("95", "simultaneous 95"),
        ),
        (
            changed(-3.9, -7.6, 0.02, "inconclusive", runs_for_direction=421),
            f"changes mse by −3.9 % [−7.6, 0.0] {GEOMETRIC}: inconclusive {NEEDED}.",
        ),
        (
            changed(20.1, 15.8, 24.9, "depends-on-average") | MEANS,
            f"raises mse by 20 % [16, 25] {GEOMETRIC}; the ratio of the means changes by −23 % "
            "[−31, −15]: depends on the average.",
        ),
        (
            {"failed_only": 60, "verdict": "fails-more", "n_pairs": 140},
            f"lowers mse by 10.2 % [9.0, 11.3] {GEOMETRIC}; R-MPC1 alone failed in 60: fails more (alone in 60 runs, "
            "S-MPC alone in 0).".replace("200", "140"),
        ),
        (NO_CHANGE | {"average": ""}, f"against S-MPC in mse (200 paired runs{WON}: better in these runs."),
        (
            NO_CHANGE | DIFFERENCE | {"verdict": "equivalent"},
            "lowers mse by 0.51 rad^2 [0.40, 0.62] against S-MPC (mean difference, 200 paired runs, 95 % interval"
            f"{WON}: equivalent (within 0 rad^2) in these runs.",
        ),
    ],
)
def test_a_sentence_can_be_quoted(trials, changes, text):
    assert sentence(ROW | changes, MSE, trials) == f"R-MPC1 {text}"


TUNED = "tuned (budget 16, 40 runs)"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("default", "default"), "both default, not tuned"),
        ((TUNED, TUNED), f"both {TUNED}"),
        ((TUNED, "as published"), f"R-MPC1: {TUNED}, S-MPC: as published, not tuned"),
    ],
)
def test_a_sentence_says_where_the_parameters_come_from(trials, words, text):
    trials = replace(trials, parameters=dict(zip(("R-MPC1", "S-MPC"), words, strict=True)))
    assert sentence(ROW, MSE, trials).endswith(f"tied 38; {text}): better in these runs.")


WORSE = "failed or 10 times worse than the partner"


@pytest.mark.parametrize(
    ("k", "direction", "text"),
    [
        (0, "lower", f"; {WORSE}: 0 of 200 runs, so at most 1.5 % of all runs (95 % bound)."),
        (3, "lower", f"; {WORSE}: 3 of 200 runs, so at most 3.8 % of all runs (95 % bound)."),
        (3, "zero", "; failed: 3 of 200 runs, so at most 3.8 % of all runs (95 % bound)."),
    ],
)
@pytest.mark.parametrize("word", ["equivalent", "better-size-uncertain", "worse", "inconclusive"])
def test_beside_a_verdict_stands_how_many_runs_are_far_worse_at_most(trials, k, direction, text, word):
    row = ROW | {"far_worse_runs": k, "far_worse_upper": largest_share(k, 200), "verdict": word}
    found = sentence(row, MSE._replace(direction=direction), trials)
    assert text in found
    assert (" in these runs;" in found) == (word[0] in "eb")


def test_methods_with_equal_numbers_of_far_worse_runs_stand_together(trials):
    rows = [
        ROW | {"method": name, "far_worse_runs": k, "far_worse_upper": largest_share(k, 200)}
        for name, k in zip("ABC", (0, 2, 0), strict=True)
    ]
    assert far_worse_bound(rows, trials, MSE) == (
        f"{WORSE}: 0 of 200 runs of A and C, so at most 1.5 % of all runs "
        "(95 % bound), and 2 of 200 runs of B, so at most 3.1 % of all runs (95 % bound)"
    )
    assert [per_cent(100 * largest_share(0, n)) for n in (1, 1000, 10**6)] == ["95.0 %", "0.3 %", "0.0003 %"]
    assert far_worse_bound([ROW], trials, MSE) == ""


def test_runs_that_would_decide_have_two_digits_and_a_limit():
    row = ROW | {"verdict": "inconclusive", "runs_for_direction": 1234567890, "runs_for_equivalence": None}
    assert verdict_text(row, "1 %") == "inconclusive (runs needed: more than 1000000 for better or worse)"
