"""The references of the servomechanism judged by one another: three methods, two of them at two tolerances.

Bounds: 1e-13 rad for the load angle (measured: 2e-14 at an inductance of 0.01 H, else 6e-15), a hundredth of what the
bench's plant is allowed; 2e-10 for the other states, of which the current is the worst (7e-11 A where an event of
DOP853 at the looser tolerance falls into a transient of an inductance of 0.01 H, and 2e-13 A elsewhere).
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from plants import servo_digits
from plants.servo_loops import ODD, Case, bang_bang, near_breakaway, random_plant, random_states, short_episodes
from plants.servo_oracle import TABLE_2, flow
from plants.servo_reference import COARSE, FINE, MARGIN, RELEASE, REVERSAL, STICK, held, table
from plants.servo_ties import ties

ANGLE, REST = 1e-13, 2e-10
TOLERANCES = ({"rtol": 1e-12, "atol": 1e-14, "max_step": 4e-3}, {"rtol": 1e-13, "atol": 1e-15, "max_step": 2e-3})


def by_events(case: Case, tolerance: dict[str, float]) -> Any:
    """States of a loop by the event-driven DOP853."""
    states = [np.array(case.x, dtype=float)]
    for u in case.volts:
        states.append(flow(case.p, states[-1], float(u), 0.1, **tolerance))
    return np.array(states)


def four_answers(case: Case) -> dict[str, Any]:
    """States of a loop by two methods at two tolerances each."""
    by_collocation = {f"collocation {nodes}": case.reference(nodes)[0] for nodes in (COARSE, FINE)}
    return by_collocation | {f"DOP853 {tolerance['rtol']}": by_events(case, tolerance) for tolerance in TOLERANCES}


def assert_all_agree(cases: Sequence[Case]) -> None:
    for case in cases:
        for (first, ours), (second, others) in combinations(four_answers(case).items(), 2):
            off = np.abs(ours - others).max(axis=0)
            assert off[0] <= ANGLE and off.max() <= REST, (first, second, off, case)


def test_two_methods_at_two_tolerances_agree():
    assert_all_agree([*bang_bang(31, 4, 20), *near_breakaway(5, 4), *random_states(6, 20)])


@pytest.mark.parametrize("name", ODD)
def test_two_methods_agree_on_odd_plants(name):
    assert_all_agree([*bang_bang(8, 1, 8, **ODD[name]), *random_states(9, 3, **ODD[name])])


@pytest.mark.slow
def test_two_methods_at_two_tolerances_agree_on_many_loops():
    assert_all_agree([*bang_bang(32, 60, 40), *near_breakaway(6, 60), *random_states(7, 400), *short_episodes(6)])


@pytest.mark.slow
@pytest.mark.parametrize("name", ODD)
def test_two_methods_agree_on_many_loops_of_odd_plants(name):
    assert_all_agree([*bang_bang(10, 5, 40, **ODD[name]), *random_states(11, 20, **ODD[name])])


@pytest.mark.slow
def test_two_methods_at_two_tolerances_agree_at_ties():
    assert_all_agree([case for tie in ties(3, 60) for case in tie.around((0, 1))])


def assert_digits_agree(cases: Sequence[Case]) -> None:
    """Oracle: forty digits; the double precision answers are within its rounding, 1e-14 rad."""
    for case in cases:
        exact, events = servo_digits.held(case.p, case.volts, case.x)
        for tolerance in (COARSE, FINE):
            states, log = case.reference(tolerance)
            assert len(log.t) == events
            assert np.abs(states - exact)[:, 0].max() <= 1e-14, case
            assert np.abs(states - exact).max() <= 1e-12, case


@pytest.mark.slow
def test_forty_digits_agree():
    assert_digits_agree([*bang_bang(11, 1, 6), *near_breakaway(3, 1), *random_states(4, 4)])


@pytest.mark.slow
def test_forty_digits_agree_on_more_loops():
    odd = [case for changes in ODD.values() for case in random_states(5, 1, **changes)]
    assert_digits_agree([*bang_bang(12, 4, 20), *near_breakaway(4, 4), *random_states(5, 12), *odd])


@pytest.mark.parametrize("tolerance", [COARSE, FINE])
def test_collocation_integrates_polynomials(tolerance):
    """Oracle: powers of t up to the order; the Bernstein coefficients of 1 and t."""
    stages, end, bernstein, _ = table(tolerance)
    n = tolerance.nodes
    c = stages @ np.ones(n)
    for power in range(n):
        np.testing.assert_allclose(stages @ c**power, c ** (power + 1) / (power + 1), rtol=0, atol=1e-14)
    for power in range(2 * n):
        assert end @ c**power == pytest.approx(1 / (power + 1), abs=1e-14)
    # rounding of the inverse, 1e3 times that of its entries
    np.testing.assert_allclose(bernstein @ np.ones(n), np.ones(n), rtol=0, atol=1e-12)
    np.testing.assert_allclose(bernstein @ c, np.arange(n) / (n - 1), rtol=0, atol=1e-12)


def test_the_log_tells_what_happens():
    """A motor that is released, turns round under the opposite voltage, and rests without one."""
    _, log = held(TABLE_2, [30.0] * 5 + [-30.0] * 5 + [0.0] * 40)
    kinds = [kind for body, kind in zip(log.body, log.kind, strict=True) if body == 1]
    assert kinds[:2] == [RELEASE, REVERSAL] and kinds[-1] == STICK
    assert (np.diff(log.t) > 0).all() and log.t[0] > 0
    np.testing.assert_array_equal(log.sample, np.floor(log.t / 0.1 + 1e-9).astype(int))


def test_a_release_waits_for_the_breakaway_torque():
    """Oracle: dry friction holds the motor until K_t I = alpha_m0 + alpha_m1, and I = (u / R) (1 - exp(-R t / L))."""
    p = random_plant(np.random.default_rng(2))
    share = (p["alpha_m0"] + p["alpha_m1"]) * (1 + MARGIN) / p["K_t"] * p["R"] / 20.0
    _, log = held(p, [20.0])
    assert log.signature()[0] == (0, 1, RELEASE)
    assert log.t[0] == pytest.approx(-p["L"] / p["R"] * np.log1p(-share), rel=1e-12)
