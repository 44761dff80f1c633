"""Which points of a sweep a figure shows."""

from dataclasses import replace

import pytest

from rmpc_bench.figures.boxplot import Boxplot
from rmpc_bench.figures.labels import short_title
from rmpc_bench.figures.points import point_at, points_at
from rmpc_bench.types import DesignError

TABLE = {"mse": {"A": [1.0, 2.0]}}


def sweep_of(make_trials, make_sweep, points):
    return make_sweep(*((point, make_trials(TABLE)) for point in points))


@pytest.fixture
def sweep(make_trials, make_sweep):
    """Three points of two paths, one of them a word."""
    words = [("10", "kalman"), ("15", "kalman"), ("1e-1", "robust")]
    return sweep_of(make_trials, make_sweep, [{"controller.Hp": hp, "estimator": word} for hp, word in words])


@pytest.mark.parametrize(
    ("at", "places"),
    [
        (None, [0, 1, 2]),
        ([{"controller.Hp": 15}], [1]),
        ([{"controller.Hp": 10.0}], [0]),
        ([{"controller.Hp": "10"}], [0]),
        ([{"controller.Hp": 0.1}], [2]),
        ([{"estimator": "robust"}, {"controller.Hp": 10}], [2, 0]),
        ([{"estimator": "kalman"}, {"controller.Hp": 10}], [0, 1]),
        ([{}], [0, 1, 2]),
    ],
)
def test_points_are_found_by_their_values(make_trials, sweep, at, places):
    assert list(points_at(sweep, at)) == [sweep.points[place] for place in places]
    table = make_trials(TABLE)  # without a sweep
    assert points_at(table, None) == (table,) and point_at(table, None) == (table, "")


@pytest.mark.parametrize(
    ("at", "place", "title"),
    [
        (None, 0, "Hp=10, estimator=kalman (first of 3 points)"),
        ({"estimator": "kalman"}, 0, "Hp=10, estimator=kalman (first of 2 points)"),
        ({"controller.Hp": 15}, 1, "Hp=15, estimator=kalman"),
    ],
)
def test_one_point_says_which_it_is(sweep, at, place, title):
    assert point_at(sweep, at) == (sweep.points[place], title)


NAMED = {"reference.values": "pi first", "controller.Hp": "10", "name": "R/Q 1e-5", "controller.R": "1"}


@pytest.mark.parametrize(
    ("point", "title", "text"),
    [
        # Two paths that end alike are written in full.
        ({"a.estimator.c": "1", "b.estimator.c": "2"}, "", "a.estimator.c=1, b.estimator.c=2"),
        # A value of several words stands for itself; arithmetic, single words and components keep their paths.
        ({"reference.values": "pi first"}, "", "pi first"),
        ({"controller.Hp": "10", "reference.values": "0 first"}, "", "Hp=10, 0 first"),
        ({"plant.x": "half weight", "model.y": "half weight"}, "", "x=half weight, y=half weight"),
        ({"plant.perturb.R": "1 + 5%", "reference.value": "2 * pi"}, "", "R=1 + 5%, value=2 * pi"),
        ({"controller.law": "printed", "estimator": "{kind: kalman}"}, "", "law=printed, estimator={kind: kalman}"),
        # A name stands for what changes together, beside the other paths.
        (NAMED, "R/Q 1e-5", "R/Q 1e-5"),
        (NAMED, "reference.values=pi first, R/Q 1e-5", "pi first, R/Q 1e-5"),
        (NAMED, "controller.Hp=10, R/Q 1e-5, reference.values=pi first", "Hp=10, R/Q 1e-5, pi first"),
    ],
)
def test_short_titles(make_trials, make_sweep, point, title, text):
    table = sweep_of(make_trials, make_sweep, [point]).points[0]
    assert short_title(replace(table, title=title or table.title)) == text


@pytest.mark.parametrize(
    ("at", "message"),
    [
        ([{"Hp": 10}], "'Hp' is not a known path of the sweep; known: controller.Hp, estimator"),
        ([{"controller.Hp": 12}], "controller.Hp has no value 12 in the sweep (it has 10, 15, 1e-1)"),
        ([{"estimator": None}], "estimator has no value null in the sweep (it has kalman, robust)"),
        ([{"estimator": True}], "estimator has no value true in the sweep (it has kalman, robust)"),
        ([{"estimator": {"kind": "kalman"}}], "estimator has no value {kind: kalman} in the sweep (it has kalman, "),
        ([], "must name at least one point"),
    ],
)
def test_errors_show_the_choices(sweep, at, message):
    with pytest.raises(DesignError) as error:
        Boxplot(at=at).draw(sweep)
    assert str(error.value).startswith(message) and error.value.parameter == "at"
