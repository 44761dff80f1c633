"""Departures of the control error and poses close to singular ones against plain loops and hand calculation."""

import math

import numpy as np
import pytest
from metrics.burst_records import LAYOUT, RUNS, Mixed, N, Ts, counts, trajectories
from metrics.issue_checks import only_issue
from simulation.toy import Walk

from rmpc_bench.metrics.departures import Departures
from rmpc_bench.metrics.norms import moving_mean
from rmpc_bench.metrics.singular_poses import NearSingular
from rmpc_bench.types import MetricLayout, Record


def error_record(*spans, size=9.0, n_steps=200):
    """Error of one output: +-1, and `size` at some samples; a burst over samples 50 to 60."""
    e = np.where(np.arange(n_steps + 1) % 2, 1.0, -1.0)
    for a, b in spans:
        e[a : b + 1] = size
    bursts = np.zeros((1, n_steps + 1), dtype=bool)
    bursts[:, 50:61] = True
    y = -e[None, :, None]
    return Record(0.1, y, y, y, y[:, :-1], np.zeros((n_steps + 1, 1)), bursts=bursts, experiment=BRIEF)


BRIEF = MetricLayout(200, 0.1, "m", "V", bursts=True)


@pytest.mark.parametrize(
    ("spans", "everywhere", "of_bursts"),
    [
        ([], 0, 0),
        ([(55, 58)], 1, 1),
        ([(45, 58)], 1, 0),  # begins before the burst
        ([(50, 50)], 1, 1),
        ([(65, 70)], 1, 1),  # 0.5 s behind the end
        ([(66, 70)], 1, 0),
        ([(52, 53), (60, 60), (67, 67)], 1, 1),  # 0.7 s apart, each from the one before
        ([(52, 53), (61, 61)], 2, 2),  # 0.8 s apart
        ([(52, 53), (61, 61), (100, 101), (150, 150), (152, 190)], 4, 2),
        ([(200, 200)], 0, 0),  # k = N, which does not count
    ],
)
def test_departures_by_hand(spans, everywhere, of_bursts):
    """Oracle: by hand; `size` is such that an error of 9 is large and one of 1 is not, whatever else is large."""
    block = error_record(*spans)
    usual = math.sqrt((block.y[0, :200, 0][~block.bursts[0, :200]] ** 2).mean())
    keys = {"smooth": 0.0, "size": 4.0 / usual, "apart": 0.8, "after": 0.5}
    assert Departures(**keys).evaluate(block) == [everywhere]
    assert Departures(during="bursts", **keys).evaluate(block) == [of_bursts]


def test_departures_against_a_plain_loop(rng):
    """Oracle: a walk through the samples that remembers when the error was large last."""
    block = trajectories(rng, runs=30)
    error = moving_mean(block.r - block.y, 2)[:, :, [0, 2]]
    keys = {"only": [0, 2], "smooth": 1.0, "size": 1.1, "apart": 2.2, "memory": 1.0, "after": 3.0, "from_": 2.0}
    everywhere = Departures(**keys).evaluate(block)
    of_bursts = Departures(during="bursts", **keys).evaluate(block)
    for i in range(30):
        quiet = [k for k in range(4, N) if counts(i % 4, k, "quiet", 1.0)]
        usual = math.sqrt(np.mean([error[i, k] ** 2 for k in quiet]))
        last, begins = -math.inf, []
        for k in range(4, N):
            if np.abs(error[i, k]).max() > 1.1 * usual:
                if k - last > 1 and (k - last) * Ts >= 2.2:
                    begins.append(k)
                last = k
        assert everywhere[i] == len(begins)
        assert of_bursts[i] == sum(counts(i % 4, k, "bursts", 3.0) for k in begins)
    assert 0 < of_bursts.sum() < everywhere.sum()


def test_the_column_of_departures():
    """Oracle: a number without unit; all of them count where there are no bursts, none without quiet samples."""
    assert Departures().info(BRIEF) == ("departures", "", "lower", False, "")
    calm = error_record((80, 81))._replace(bursts=None)
    assert Departures(smooth=0.0).evaluate(calm) == [1.0]
    block = error_record()
    assert np.isnan(Departures(from_=5.0, to=6.0).evaluate(block)).all()


# -- singular poses ----------------------------------------------------------------------------------------------------


def test_poses_that_are_nearly_singular(rng):
    """Oracle: a loop; `below` is not below itself; a pose that is not a number does not count."""
    layout = LAYOUT._replace(plant=Mixed())
    block = trajectories(rng)._replace(experiment=layout)
    block.y[0, 5, 0], block.y[1, :, 1], block.y[0, 6, 0] = 0.25, np.nan, 0.2499
    for bounds, samples in (({}, range(N)), ({"from_": 2.0, "to": "N"}, range(4, N + 1))):
        values = NearSingular(below=0.25, **bounds).evaluate(block)
        expected = [sum(abs(block.y[i, k, 0]) < 0.25 for k in samples) for i in range(RUNS)]
        np.testing.assert_array_equal(values, [expected[0], 0, *expected[2:]])
    assert NearSingular().info(layout) == ("near_singular", "", "lower", False, "")
    for other in (Walk(), None):
        only_issue(NearSingular(), LAYOUT._replace(plant=other), "", "needs a plant with singular poses")
