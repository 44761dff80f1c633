"""Changes and failed runs along a swept number, read back from the artists, and the sentences about them."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND

from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.analysis.turning_points import numeric_paths, tracks
from rmpc_bench.figures.ranking import Ranking
from rmpc_bench.report.turning_sentences import turning_sentences
from rmpc_bench.types import DesignError, MetricInfo, ResultLayout

PATH = "uncertainty.scale"
CHANGES = {"0.5": 0.8, "1": 0.95, "2": 1.3}


@pytest.fixture
def trials(make_trials, make_sweep):
    """R is better at 0.5 and 1 and worse at 2; at 2 it fails in two of 40 runs.  The points are not in order."""
    rng = np.random.default_rng(4)
    points = []
    for scale in ("2", "0.5", "1"):
        base = np.exp(rng.normal(size=40))
        values = list(CHANGES[scale] * base * np.exp(0.05 * rng.normal(size=40)))
        if scale == "2":
            values[:2] = ["diverged", "diverged"]
        points.append(({PATH: scale}, make_trials({"mse": {"S": list(base), "R": values}})))
    return make_sweep(*points)


def test_the_line_has_the_changes_of_the_comparisons(trials):
    """In the order of the path, with the simultaneous intervals."""
    axes = Ranking().draw(trials).axes[0]
    of = levels(trials)
    points = sorted(trials.points, key=lambda point: float(point.point[PATH]))
    expected = [comparisons(point, of).iloc[0] for point in points]
    line = next(line for line in axes.lines if len(line.get_xdata()) == 3)
    np.testing.assert_allclose(line.get_ydata(), [row["change_pct"] for row in expected], **ROUND)
    np.testing.assert_allclose(line.get_xdata(), [0.5, 1, 2], **ROUND)
    (bars,) = axes.collections
    ends = [segment[:, 1] for segment in bars.get_segments()]
    np.testing.assert_allclose(ends, [[row["ci_low"], row["ci_high"]] for row in expected], **ROUND)


def test_the_lower_panel_has_the_failed_runs(trials):
    """Two of 40 at the last point with the Wilson interval; without failed runs there is no such panel."""
    figure = Ranking().draw(trials)
    shares = [list(line.get_ydata()) for line in figure.axes[1].lines]
    assert shares == [[0, 0, 0], [0, 0, 5]]
    ends = figure.axes[1].collections[1].get_segments()[2][:, 1]
    np.testing.assert_allclose(ends, 100 * np.array(wilson(2, 40, 0.95)), **ROUND)
    assert len(Ranking(at=[{PATH: "0.5"}, {PATH: "1"}]).draw(trials).axes) == 1


def test_the_turn_lies_between_the_points_whose_signs_differ(trials):
    """In the track, in the caption and in the sentence with both changes and their intervals."""
    (track,) = tracks(trials, PATH)
    assert (track.places, track.turns) == ((0.5, 1.0, 2.0), ((1, 2),))
    assert "between 1 and 2" in Ranking().caption(trials)
    turning, failing = turning_sentences(trials)
    low, high = track.changes[1:]
    assert turning.startswith(
        f"Along {PATH}, the change of mse of R against S changes its sign between 1 ({low:.1f} % ["
    )
    assert f"and 2 (+{high:.1f} % [" in turning
    assert failing == f"Along {PATH}, R fails in 0 of 40 at 0.5, 0 of 40 at 1, 2 of 40 at 2."


def test_values_that_change_together_are_named_by_their_name(trials, make_sweep):
    """The sentence has the name of the interpretation, not the keys that it changes."""
    named = {"name": "own draws", "controller.law": "printed"}
    titled = [replace(point, title=f"{PATH}={point.point[PATH]}, own draws") for point in trials.points]
    points = [({PATH: point.point[PATH], **named}, point) for point in titled]
    sentence, *_ = turning_sentences(make_sweep(*points))
    assert sentence.startswith(f"Along {PATH} at own draws, the change of mse of R")


def test_no_turn_is_said_too(trials):
    """With the changes at both ends."""
    chosen = tuple(point for point in trials.points if point.point[PATH] != "2")
    (sentence,) = turning_sentences(replace(trials, points=chosen))
    assert "is negative at all 2 points" in sentence


@pytest.fixture
def unresolved(make_trials, make_sweep):
    """R is better at 0.5 and worse at 3; at 1 and 2 the estimates have opposite signs and intervals that contain 0."""
    points = []
    for scale, log in {"0.5": -0.3, "1": 0.01, "2": -0.01, "3": 0.3}.items():
        deviations = np.random.default_rng(4).normal(size=40)
        values = np.exp(log + 0.2 * (deviations - deviations.mean()))
        points.append(({PATH: scale}, make_trials({"mse": {"S": [1.0] * 40, "R": list(values)}})))
    return make_sweep(*points)


def test_a_change_whose_interval_contains_0_is_no_turn(unresolved):
    """The turn lies between the points that have a sign, and estimates that are noise do not turn."""
    (track,) = tracks(unresolved, PATH)
    assert (track.signs, track.turns) == ((-1, 0, 0, 1), ((0, 3),))
    assert "turns between 0.5 and 3." in Ranking().caption(unresolved)
    (sentence,) = turning_sentences(unresolved)
    assert "changes its sign between 0.5 (" in sentence
    middle = replace(unresolved, points=unresolved.points[1:3])
    (sentence,) = turning_sentences(middle)
    assert "has an interval that contains 0 at all 2 points: +" in sentence
    assert "no turn is resolved; the interval of the change contains 0 at 1, 2." in Ranking().caption(middle)
    (sentence,) = turning_sentences(replace(unresolved, points=unresolved.points[:3]))
    assert "is negative at 1 of 3 points, and its interval contains 0 at 1, 2: " in sentence


def test_the_caption_names_the_intervals_of_another_metric(make_trials, make_sweep):
    """Only those of the primary metric are simultaneous."""
    rng = np.random.default_rng(1)
    columns = {name: {"S": list(rng.uniform(1, 2, 40)), "R": list(rng.uniform(1, 2, 40))} for name in ("mse", "mae")}
    infos = [MetricInfo(name, "rad^2", "lower") for name in columns]
    sweep = make_sweep(*[({PATH: scale}, make_trials(columns, infos)) for scale in ("1", "2")])
    assert "with simultaneous 95 % intervals;" in Ranking().caption(sweep)
    assert "with 95 % intervals for each point alone;" in Ranking(metric="mae").caption(sweep)


def test_paths_of_names_have_no_turn(make_sweep, trials):
    """Only numbers have an order."""
    named = make_sweep(*[({"law": text}, trials.points[1]) for text in ("ours", "printed")])
    assert numeric_paths(named) == ()
    assert list(turning_sentences(named)) == []
    with pytest.raises(DesignError, match="swept path of numbers"):
        Ranking().draw(named)


def test_keys_are_checked_before_the_run():
    """The nearest path is named, and one of several must be chosen."""
    points = tuple({PATH: a, "controller.Hp": b} for a in ("1", "2") for b in ("5", "10"))
    layout = ResultLayout(methods=("S", "R"), metrics=("mse",), points=points)
    (issue,) = Ranking(path="uncertainty.scales").check(layout)
    assert "did you mean 'uncertainty.scale'" in issue.message
    (issue,) = Ranking().check(layout)
    assert "controller.Hp" in issue.message
    assert list(Ranking(path=PATH).check(layout)) == []
