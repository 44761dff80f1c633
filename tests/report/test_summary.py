"""The tables of a sweep: point below point, and many points of single runs together."""

from dataclasses import replace

import pandas as pd
import pytest
from data_frames import arrays, comparison_frame, summary_frame

from rmpc_bench import summarise
from rmpc_bench.report.point_tables import trials_csv
from rmpc_bench.report.summary import summary_markdown


@pytest.fixture
def sweep(make_trials, make_sweep):
    """Return a function that makes a sweep over `c` of n points with runs of A and B; B is c times as large."""

    def make(n, keys=None, sizes=(1.0, 2.0, 4.0)):
        tables = []
        for c in range(1, n + 1):
            columns = {"A": list(sizes), "B": [c * (size + (size == 4.0)) for size in sizes]}
            table = replace(make_trials({"mse": columns}), title=f"c={c}")
            tables.append(({"c": str(c), "d": "x"}, replace(table, keys=keys(c)) if keys else table))
        there = make_sweep(*tables)
        parts = [point.frame.assign(c=point.point["c"], d="x") for point in there.points]
        frame = pd.concat(parts, ignore_index=True)[["c", "d", *there.points[0].frame.columns]]
        return replace(there, columns=arrays(frame), title="", alike=True)

    return make


def own_keys(c):
    """Return keys of methods that differ at every point."""
    return {"A": f"A{c}", "B": f"B{c}"}


def test_sweep_columns_come_first(sweep):
    there = sweep(3)
    summary = summarise(there)
    for stacked, single in ((summary.described, summary_frame), (summary.compared, comparison_frame)):
        expected = [single(point) for point in there.points]
        assert [*stacked.columns] == ["c", "d", *expected[0].columns]
        assert stacked["c"].tolist() == [c for c, part in zip("123", expected, strict=True) for _ in range(len(part))]
        assert set(stacked["d"]) == {"x"}
        rest = stacked.drop(columns=["c", "d"])
        pd.testing.assert_frame_equal(rest, pd.concat(expected, ignore_index=True))
    b = summary.described[summary.described["method"] == "B"].set_index("c")
    assert b["mean"].to_dict() == pytest.approx({"1": 8 / 3, "2": 16 / 3, "3": 8})
    assert summary.compared["change_pct"].diff().gt(0).sum() == 2


def test_without_a_sweep_nothing_is_added(make_trials):
    trials = make_trials({"mse": {"A": [1.0, 2.0], "B": [2.0, 3.0]}})
    summary, described, compared = summarise(trials), summary_frame(trials), comparison_frame(trials)
    pd.testing.assert_frame_equal(summary.described, described)
    pd.testing.assert_frame_equal(summary.compared, compared)
    assert summary.to_markdown() == summary_markdown(trials, *summary.points[0][1:]) and summary.pooled is None


@pytest.mark.parametrize(
    ("n", "keys", "sizes"),
    [
        *((n, None, (1.0, 2.0, 4.0)) for n in (1, 2, 6)),
        (7, own_keys, (1.0, 2.0, 4.0)),  # Every point has the same draws: the runs of two are not independent.
        (8, lambda c: {"A": "same", "B": f"B{c}"}, (2.0,)),  # A has one run, not eight.
    ],
)
def test_points_that_are_not_taken_together_have_a_page_each(sweep, n, keys, sizes):
    summary = summarise(sweep(n, keys, sizes))
    assert summary.pooled is None
    headings = [line for line in summary.to_markdown().splitlines() if line.startswith("# ")]
    assert headings == [f"# tiny: c={c}" for c in range(1, n + 1)]


def test_many_points_are_shown_together_and_trials_have_sweep_columns_first(sweep, tmp_path):
    """Oracle: the mean of seven single runs; the page has each point, too."""
    summary = summarise(sweep(7, own_keys, sizes=(2.0,)))
    described = pd.DataFrame(summary.pooled.described).set_index("method")
    assert described["n"].tolist() == [7, 7]
    assert described["mean"].tolist() == pytest.approx([2.0, 8.0])
    assert described["se"].isna().all() and not summary.pooled.compared  # they are all there are
    headings = [line for line in summary.to_markdown().splitlines() if line.startswith("# ")]
    assert headings == ["# tiny: all 7 points together", *[f"# tiny: c={c}" for c in range(1, 8)]]
    assert len(summary.described) == 14 and set(summary.described["c"]) == set("1234567")
    trials_csv(sweep(2), tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "c,d,method,run,status,mse" and len(lines) == 13
    assert lines[1] == "1,x,A,0,ok,1.0" and lines[-1] == "2,x,B,2,ok,10.0"
