"""Objectives over a parameter, read back from the artists."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tuned_searches import constant, search, tuning

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.tuning import TuningOverParameter
from rmpc_bench.types import DesignError, ResultLayout


@pytest.fixture
def trials(make_trials):
    """Return three methods, of which A and B are tuned; the values of A are not in order, and one loses all runs."""
    made = make_trials({"mse": dict.fromkeys("ABC", [1.0] * 3)})
    first = search("A", constant([4, 3, math.nan]), constant([5, 2, 7, 6]), values=[1.0, 0.01, 0.1], default=0.5)
    return made.with_tuning(tuning(first, search("B", constant([1, 20]), default=None)))


def lines(axes):
    """Lines with more than the two points of a vertical line."""
    return [line for line in axes.lines if line.get_marker() in ("o", "s")]


def test_marks_are_the_objectives_in_the_order_of_the_values(trials):
    """A value with which all runs failed has no mark on the tuning runs; the default is not among the test marks."""
    first, second = TuningOverParameter().draw(trials).axes
    on_tuning, on_test = lines(first)
    assert on_tuning.get_xydata().tolist() == [[0.01, 3], [1.0, 4]]
    assert on_test.get_xydata().tolist() == [[0.01, 2], [0.1, 7], [1.0, 5]]
    assert first.get_xscale() == "log" and first.get_xlabel() == "A: estimator.radius"
    verticals = [float(line.get_xdata()[0]) for line in first.lines if line not in (on_tuning, on_test)]
    assert verticals == [0.01, 0.5]
    text = TuningOverParameter(order=["A"]).caption(trials)
    assert "circles on the 3 tuning runs, squares on the 3 runs of the experiment" in text
    assert text.endswith("default.") and text.count(". ") == 0
    # Without runs of the experiment and without a number as default: one line, one vertical line, a wide range.
    assert len(lines(second)) == 1 and len(second.lines) == 2 and second.get_yscale() == "log"


def test_an_offset_is_subtracted_and_each_point_of_a_sweep_has_its_own_searches(trials, make_sweep):
    one = search("A", constant([2, 1]), values=[1.001, 1.1], default=1.01)
    (parameter,) = one.parameters
    moved = replace(one, parameters=(replace(parameter, low=1e-4, high=1.0, offset=1.0),))
    (axes,) = TuningOverParameter().draw(trials.with_tuning(tuning(moved))).axes
    np.testing.assert_allclose(lines(axes)[0].get_xdata(), [0.001, 0.1], rtol=1e-9)  # digits of 1.001 - 1
    assert axes.get_xlabel() == "A: estimator.radius - 1"
    found = [search("A", constant([1, number]), point=f"s={number}") for number in (2, 3)]
    tables = [({"s": str(number)}, replace(trials, title=f"s={number}")) for number in (2, 3)]
    sweep = make_sweep(*tables).with_tuning(tuning(*found))
    (axes,) = TuningOverParameter(at={"s": "3"}).draw(sweep).axes
    assert lines(axes)[0].get_ydata().tolist() == [1.0, 3.0]


def test_a_method_with_two_parameters_has_two_panels_without_lines(trials):
    base = search("A", constant([2, 1]))
    both = (base.parameters[0], replace(base.parameters[0], path="model.scale", scale="linear"))
    two = replace(base, parameters=both, default=(0.1, 2.0), candidates=np.array([[0.1, 2.0], [0.5, 3.0]]))
    axes = TuningOverParameter().draw(trials.with_tuning(tuning(two))).axes
    assert [each.get_xlabel() for each in axes] == ["A: estimator.radius", "A: model.scale"]
    assert [each.get_xscale() for each in axes] == ["log", "linear"]
    assert all(line.get_linestyle() == "None" for each in axes for line in lines(each))


def test_what_cannot_be_drawn_is_refused_before_the_run(trials):
    layout = layout_of(trials)
    assert layout.tuned == ("A", "B") and not list(TuningOverParameter().check(layout))
    (issue,) = TuningOverParameter(order=["C"]).check(layout)
    assert issue.key == "order" and "tuned: A, B" in issue.message
    (issue,) = TuningOverParameter().check(ResultLayout(methods=("A",), metrics=("mse",), points=({},)))
    assert "give one a range with `tune`" in issue.message
    with pytest.raises(DesignError, match="no search"):
        TuningOverParameter().draw(replace(trials, methods=("C",)))
