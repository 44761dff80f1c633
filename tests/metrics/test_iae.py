"""The integral of the absolute error against a plain loop and a closed form."""

import numpy as np
import pytest
from conftest import ROUND
from metrics.estimate_records import LAYOUT, N, trajectories
from metrics.issue_checks import only_issue

from rmpc_bench.metrics.tracking import Iae
from rmpc_bench.types import Record


@pytest.mark.parametrize(("bounds", "samples"), [({}, range(N)), ({"from_": 1.0, "to": "N"}, range(2, N + 1))])
def test_iae_against_a_plain_loop(bounds, samples, rng):
    """Oracle: a sum over samples and outputs; two outputs, a sampling time of 0.5 s."""
    block = trajectories(rng)
    for i, value in enumerate(Iae(**bounds).evaluate(block)):
        total = sum(abs(float(block.y[i, k, j] - block.r[k, j])) for k in samples for j in range(2))
        np.testing.assert_allclose(value, 0.5 * total / 2, **ROUND)


def test_an_exponential_in_closed_form():
    """Oracle: the geometric series, Ts (1 - a^N) / (1 - a) of the error a^k."""
    a, n, Ts = 0.9, 50, 0.1
    record = Record.of_run(y=1.0 - a ** np.arange(n + 1), r=1.0, Ts=Ts)
    np.testing.assert_allclose(Iae().evaluate(record), Ts * (1.0 - a**n) / (1.0 - a), **ROUND)


def test_its_column():
    """Oracle: a second times the unit of the output; states and estimates have none; windows as in other metrics."""
    assert Iae().info(LAYOUT) == ("iae", "rad*s", "lower", False, "")
    assert Iae(of="state").unit(LAYOUT) == Iae(of="estimate").unit(LAYOUT) == ""
    only_issue(Iae(to=100.0), LAYOUT, "", "must lie in 0..6")
