"""Tests of the metrics of runaways and of quadratic programs, on small records whose values are known by hand."""

import numpy as np
import pytest
from metrics.issue_checks import no_issue, only_issue

from rmpc_bench.metrics.optimised_steps import QpShare
from rmpc_bench.metrics.runaway import Runaway
from rmpc_bench.plants.linear import design as linear
from rmpc_bench.types import Controller, Estimator, Method, MetricLayout, OptimisedStep, Record


class Solver(Controller):
    """Reports a quadratic program."""

    reports = {"qp": ()}


CLIPS, SOLVES = Method("clip", Estimator(), Controller()), Method("qp", Estimator(), Solver())
PLANT = linear(0.1, 2, A=[[1.0, 0.0], [0.0, 1.0]], C=[[1.0, 0.0], [0.0, 1.0]])


@pytest.mark.parametrize(("largest", "expected"), [(1.9, 0.0), (2.0, 0.0), (2.1, 1.0), (-2.1, 1.0)])
def test_runaway_is_beyond_twice_the_reference(largest, expected):
    """Oracle: the definition, also at the last sample."""
    record = Record.of_run(y=[0.0, 0.5, largest], r=-1.0)
    assert Runaway().evaluate(record).tolist() == [expected]
    assert Runaway(factor=2.2).evaluate(record).tolist() == [0.0]
    assert Runaway(to=1.0).evaluate(record).tolist() == [0.0]


def test_reference_may_pass_through_zero():
    """Trap: |y(k)| > 2 |r(k)| at single samples calls every run a runaway while the reference passes through 0."""
    r = np.array([1.0, 0.01, -1.0, 0.0])
    y = np.array([1.0, 0.1, -1.1, 0.2])
    assert (np.abs(y) > 2.0 * np.abs(r)).any()  # the naive definition
    assert Runaway().evaluate(Record.of_run(y=y, r=r)).tolist() == [0.0]


def test_an_output_without_a_reference_has_no_size():
    """Oracle: by hand; the second output counts only with `beyond`."""
    record = Record.of_run(y=[[1.0, 50.0], [1.0, 0.0]], r=[[1.0, 0.0], [1.0, 0.0]])
    assert Runaway().evaluate(record).tolist() == [0.0]
    assert Runaway(beyond=3.0).evaluate(record).tolist() == [1.0]
    assert Runaway(beyond=3.0, only=[0]).evaluate(record).tolist() == [0.0]
    assert np.isnan(Runaway(only=[1]).evaluate(record)).all()


def test_mean_is_the_share_of_runaways():
    """Oracle: one of four runs."""
    y = np.array([[0.0, 1.0], [0.0, 3.0], [0.0, 2.0], [1.0, 0.0]])[:, :, None]
    record = Record(1.0, y, y, y, np.zeros((4, 1, 1)), np.ones((2, 1)))
    assert Runaway().evaluate(record).mean() == 0.25


def test_check_of_runaway():
    """Oracle: the rules of the keys."""
    layout = MetricLayout(2, plant=PLANT, r=np.array([[0.0, 1.0]] * 3))
    no_issue(Runaway(), layout)
    no_issue(Runaway(only=[1]), layout)
    only_issue(Runaway(only=[0]), layout, "", "the reference is 0")
    only_issue(Runaway(only=[2]), layout, "only", "there is no y.2")
    only_issue(Runaway(beyond=1.0, factor=3.0), layout, "factor", "has no effect beside `beyond`")
    only_issue(Runaway(), layout._replace(r=np.zeros((3, 2))), "", "give `beyond`")
    no_issue(Runaway(beyond=1.0), layout._replace(r=np.zeros((3, 2))))


RESULTS = [0, 0, 1, 2, 3, 4, 0, 1]
"""Numbers of `OptimisedStep`."""


@pytest.mark.parametrize(
    ("of", "count", "better"),
    [
        ("skipped", 3, "higher"),
        ("solved", 2, "lower"),
        ("softened", 1, "lower"),
        ("failed", 2, "lower"),
        ("infeasible", 1, "lower"),
        ("not-converged", 1, "lower"),
    ],
)
def test_share_of_results(of, count, better):
    """Oracle: the counts by hand."""
    info = {"qp": np.array(RESULTS, dtype=float).reshape(1, -1, 1)}
    metric = QpShare(of=of)
    assert metric.evaluate(Record.of_run(u=[0.0] * 8)._replace(info=info)).tolist() == [count / 8]
    assert (metric.better, metric.needs_info) == (better, ("qp",))
    assert metric.info(MetricLayout(8)).words == f"share of QPs {of.replace('-', ' ')}"


def test_every_result_is_counted_once():
    """Oracle: the shares of skipped, solved, softened and failed add up to 1, whatever the result."""
    for result in OptimisedStep:
        record = Record.of_run(u=[0.0])._replace(info={"qp": np.full((1, 1, 1), float(result))})
        values = {of: QpShare(of=of).evaluate(record).item() for of in ("skipped", "solved", "softened", "failed")}
        assert sum(values.values()) == 1.0
        assert values["failed"] == result.failed


def test_a_method_that_clips_has_no_value():
    """Oracle: NaN beside a method that solves; an error where none does."""
    record = Record.of_run(u=[0.0, 0.0])
    assert np.isnan(QpShare(of="skipped").evaluate(record)).all()
    no_issue(QpShare(of="skipped"), MetricLayout(2, methods=(CLIPS, SOLVES)))
    only_issue(QpShare(of="skipped"), MetricLayout(2, methods=(CLIPS,)), "", "no method solves a quadratic program")
