"""docs/numbers.md lists what has moved by more than its standard error, and nothing else."""

import pandas as pd
import pytest

from docs import numbers_page

PAGE = numbers_page.PAGE.read_text(encoding="utf-8")
SUMMARY = pd.DataFrame({"point": [None, "a"], "method": "KF", "metric": "mse", "n": 100, "mean": [1.0, 2.0], "se": 0.1})
COMPARED = pd.DataFrame(
    {
        "method": ["A", "B"],
        "baseline": "KF",
        "metric": "mse",
        "change_pct": [-10.0, 5.0],
        "ci_low": [-13.92, 1.08],
        "ci_high": [-6.08, 8.92],
        "verdict": ["better", "inconclusive"],
        "ci_level": 0.95,
    }
)


def test_a_mean_within_its_standard_error_has_not_moved():
    new = SUMMARY.assign(mean=[1.09, 2.11])
    assert list(numbers_page.moved_rows(SUMMARY, new)) == [("a, KF, mse", "2", "2.11")]


def test_the_name_of_a_point_stands_for_lists_and_mappings():
    frame = SUMMARY.assign(point=["a", None], noise=["{cov: 1}", "[1, 2]"])[["point", "noise", "method", "metric", "n"]]
    assert [*numbers_page.keyed(frame, "metric").index] == ["a, KF, mse", "KF, mse"]


def test_an_exact_value_moves_by_more_than_rounding():
    exact = SUMMARY.assign(se=0.0)
    assert not list(numbers_page.moved_rows(exact, exact.assign(mean=[1.0 + 1e-7, 2.0])))
    assert len(list(numbers_page.moved_rows(exact, exact.assign(mean=[1.0 + 1e-5, 2.0])))) == 1


def test_a_comparison_moves_by_its_interval_or_its_verdict():
    """The standard error of the interval -13.92 to -6.08 is 2."""
    assert not list(numbers_page.moved_rows(COMPARED, COMPARED.assign(change_pct=[-8.1, 5.0])))
    new = COMPARED.assign(change_pct=[-7.9, 5.0], verdict=["better", "worse"])
    assert list(numbers_page.moved_rows(COMPARED, new)) == [
        ("A, KF, mse", "-10 better", "-7.9 better"),
        ("B, KF, mse", "5 inconclusive", "5 worse"),
    ]


def test_a_claim_moves_by_its_finding_or_an_inequality():
    def claims(finding, *holds):
        numbers = [{"holds": each} for each in holds]
        return {"claims": [{"statement": "s", "finding": finding, "joined": finding, "numbers": numbers}]}

    assert not list(numbers_page.moved_claims(claims("confirmed", True), claims("confirmed", True)))
    moved = list(numbers_page.moved_claims(claims("inconclusive", True, False), claims("inconclusive", True, True)))
    assert moved == [("s", "inconclusive; 1 of 2 hold", "inconclusive; 2 of 2 hold")]


def test_rows_of_one_state_are_counted_and_a_change_without_a_cause_is_refused():
    assert numbers_page.only_in_one(SUMMARY, SUMMARY.iloc[:1]) == "1 rows gone"
    with pytest.raises(SystemExit, match="nowhere/x has moved: say why"):
        numbers_page.section("nowhere/x", [("summary.csv", "1 new rows", [])], PAGE)
    made = numbers_page.section("ma2025/fig4", [("summary.csv", "1 new rows", [])], PAGE)
    assert made.startswith("## ma2025/fig4\n\nCause: *printed law*.\n\n`summary.csv` (1 new rows)")
