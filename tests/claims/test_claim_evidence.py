"""What claims.md says of a comparison: the smallest margin, with digits that distinguish the sides."""

import json

import numpy as np
import pytest

from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.record import claims_table
from rmpc_bench.claims.verdict import judge

VAR = np.array([[0.1, 0.1], [3.62498, 10], [5, 20]])
BOUND = np.array([[0.1, 0.1], [3.62537, 12], [6, 20]])
SERIES = {"v": VAR, "b": BOUND, "same": BOUND, "t": [1.0, 1.0 + 1e-15, 1.0 - 1e-15], "one": [1.0, 1.0, 1.0]}
SERIES |= {
    "P": [[[4, 1], [1, 3]], [[4, 2], [2, 3]], [[4, 1], [1, 3]]],
    "c": [[1.0, 2.0]],
    "up": [1.0, 1.0, 1.0 + 4e-16],
}

SOME = "equal to 9 digits in 3 of 6 entries"


@pytest.fixture
def trials(make_trials):
    """Two columns and some series of method A."""
    rows = [
        ("A", name, ",".join(map(str, index)), k, 0, float(value[index]))
        for name, values in SERIES.items()
        for k, value in enumerate(np.asarray(values, dtype=float))
        for index in np.ndindex(value.shape)
    ]
    return make_trials({"mse": {"A": [1.0, 2.0], "B": [1.5, 2.5]}}, rows)


def said(check, trials):
    """Return what claims.md says after the check."""
    text = claims_markdown([judge(Claim("", "", (check,)), trials)], informational=False)
    [line] = [line for line in text.splitlines() if line.startswith(f"- `{check}`: ")]
    return line.removeprefix(f"- `{check}`: ")


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (
            "all(v[A] <= b[A])",
            "holds; smallest margin at k = 1, entry 0: 3.62498 and 3.62537; equal to 9 digits in 3 of 6 entries",
        ),
        (
            "all(b[A] >= v[A])",
            "holds; smallest margin at k = 1, entry 0: 3.62537 and 3.62498; equal to 9 digits in 3 of 6 entries",
        ),
        ("all(since(v[A], 1) < since(2 * b[A], 1))", "holds; smallest margin at k = 1, entry 0: 3.625 and 7.251"),
        ("all(b[A] <= v[A])", "does not hold; largest violation at k = 1, entry 1: 12 and 10"),
        ("all(b[A] < same[A])", "does not hold; largest violation at k = 0, entry 0: 0.1 and 0.1"),
        ("all(b[A] <= same[A])", "holds; equal to 9 digits in all 6 entries"),
        (
            "all(b[A] ~ v[A] +- 2)",
            "holds; largest difference at k = 1, entry 1: 12 and 10; equivalent within margins of 2 or more",
        ),
        (
            "at(P[A], 1) ~ [[4, 1.5], [2, 3]] +- 1",
            "holds; largest difference at entry 0,1: 2 and 1.5; equivalent within margins of 0.5 or more",
        ),
        ("last(entry(v[A], 0)) ~ 4 +- 50%", "holds; 5 and 4; equivalent within margins of 25 % or more"),
        ("last(entry(v[A], 0)) < 2 * last(entry(b[A], 0))", "holds; 5 and 12; outcome changes at a factor of 0.8333"),
        ("0.5 * last(entry(v[A], 0)) < last(entry(b[A], 0))", "holds; 2.5 and 6; outcome changes at a factor of 1.2"),
        ("last(entry(v[A], 0)) < 6", "holds; 5 and 6"),
        ("all(c[A] < 3)", "holds; smallest margin at entry 1: 2 and 3"),  # the same at all k
        ("all(same[A] ~ b[A] +- 1)", "holds; equal to 9 digits in all 6 entries"),
        ("1 <= 1", "holds; 1 and 1"),
        ("last(up[A]) ~ 1 +- 1%", "holds; 1 and 1"),
        ("1 < 1.00000123", "holds; 1 and 1.0000012"),
        ("all(entry(since(v[A], 2), 0) < 7)", "holds; smallest margin at k = 2: 5 and 7"),
        ("all(mse[A] < mse[B])", "inconclusive; 1 and 1.5, n = 2; at most 78 % of all runs are exceptions"),
    ],
)
def test_where_a_comparison_is_tightest(trials, check, words):
    """Oracle: by hand."""
    assert said(check, trials) == words


def test_sides_that_digits_cannot_tell_apart(trials):
    """They are called equal, whether the comparison holds or fails; the first of them is named."""
    assert said("all(t[A] <= one[A] + 1e-14)", trials) == "holds; equal to 9 digits in all 3 entries"
    assert said("all(up[A] <= one[A])", trials) == (
        "does not hold; largest violation at k = 0: 1 and 1, equal to 9 digits"
    )
    words = "holds; smallest margin at k = 0: 1 and 1, equal to 9 digits"
    assert said("all(one[A] < one[A] + 1e-14)", trials) == words


def test_the_place_in_the_table(trials):
    """As JSON numbers; none for columns and single numbers."""
    checks = ("all(v[A] <= b[A])", "at(P[A], 1) < 9", "all(mse[A] < mse[B])", "1 < 2")
    verdicts = [judge(Claim("", "", (check,)), trials) for check in checks]
    rows = [row["numbers"][0] for row in json.loads(json.dumps(claims_table(verdicts)))]
    places = [(row["k"], row["entry"]) for row in rows]
    assert places == [(1, [0]), (None, [0, 0]), (None, None), (None, None)]
