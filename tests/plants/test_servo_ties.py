"""The bench's servomechanism at ties between events: no jump, no standstill, the same accuracy as anywhere.

At a tie a body grazes rest or breakaway, or an event falls onto the end of a sample or onto another event. The
references jump by less than 1e-13 rad across a tie, so a tie is no excuse.
"""

from itertools import product
from typing import Any

import numpy as np
import pytest
from plants.servo_loops import NOMINAL, ODD, Case, bench, random_plant
from plants.servo_oracle import breakaway
from plants.servo_ties import Tie, ties

ANGLE = 1e-11  # rad, as in test_servo_accuracy
JUMP = 1e-12  # rad between adjacent doubles: rounding of a loop of ten samples, a tenth of the error allowed
NEAR = np.array([-(2**20), -4096, -64, -8, -3, -2, -1, 0, 1, 2, 3, 4, 9, 65, 4097, 2**20 + 1])
KINDS = {
    "load rests for an instant",
    "load slips for an instant",
    "motor rests for an instant",
    "motor slips for an instant",
    "at the end of a sample",
    "at a jump of the voltage or a turn",
    "two at once",
}


def assert_smooth(found: tuple[Tie, ...]) -> None:
    """Oracle: the reference on both sides of every tie, and the plant itself on the other side."""
    cases = [case for tie in found for case in tie.around(NEAR)]
    ours = bench(cases)[:, :, 0].reshape(len(found), len(NEAR), -1)
    reference = np.array([case.reference()[0][:, 0] for case in cases]).reshape(ours.shape)
    off = np.abs(ours - reference).max(axis=(1, 2))
    assert off.max() <= ANGLE, (off.max(), found[int(off.argmax())])
    adjacent = np.flatnonzero(np.diff(NEAR) == 1)
    jumps = np.abs(ours[:, adjacent + 1] - ours[:, adjacent]).max(axis=(1, 2))
    assert jumps.max() <= JUMP, (jumps.max(), found[int(jumps.argmax())])


def jumps_nearby(found: tuple[Tie, ...], reach: int = 2**16) -> tuple[Any, Any]:
    """Largest jump between adjacent doubles near every tie [rad], and where: at that many doubles above it.

    The plant's own ties stand where its rounding and its margins put them. The half over which it changes more is
    halved again, which leads to any jump that exceeds its smooth change over the reach, about 1e-11 rad.
    """

    def angles(steps: Any) -> Any:
        return bench([tie.around([step])[0] for tie, step in zip(found, steps, strict=True)])[:, :, 0]

    low, high = np.full(len(found), -reach), np.full(len(found), reach)
    below, above = angles(low), angles(high)
    while (high - low > 1).any():
        middle = (low + high) // 2
        between = angles(middle)
        left = (np.abs(between - below).max(axis=1) >= np.abs(above - between).max(axis=1))[:, None]
        low, high = np.where(left[:, 0], low, middle), np.where(left[:, 0], middle, high)
        below, above = np.where(left, below, between), np.where(left, between, above)
    return np.abs(above - below).max(axis=1), low


def assert_no_jump_nearby(found: tuple[Tie, ...]) -> None:
    jumps, places = jumps_nearby(found)
    worst = int(jumps.argmax())
    assert jumps[worst] <= JUMP, (jumps[worst], places[worst], found[worst])


def test_across_ties_the_load_angle_does_not_jump():
    found = ties(10, 24)
    assert len(found) >= 20 and {tie.kind for tie in found} == KINDS
    assert_smooth(found)
    assert_no_jump_nearby(found)


@pytest.mark.slow
def test_across_hundreds_of_ties_the_load_angle_does_not_jump():
    found = ties(2, 300)
    assert len(found) >= 250
    for kind in KINDS:
        assert sum(tie.kind == kind for tie in found) >= 10
    assert_smooth(found)
    assert_no_jump_nearby(found)


@pytest.mark.parametrize("name", ["Coulomb only", "no decay", "near standstill only", "low rigidity"])
def test_across_ties_of_odd_plants_the_load_angle_does_not_jump(name):
    found = ties(4, 6, name)
    assert len(found) >= 2
    assert_smooth(found)
    assert_no_jump_nearby(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ODD)
def test_across_many_ties_of_odd_plants_the_load_angle_does_not_jump(name):
    found = ties(5, 4 if name == "small L" else 25, name)
    assert len(found) >= (2 if name == "small L" else 8)
    assert_smooth(found)
    assert_no_jump_nearby(found)


def steps(value: float) -> list[float]:
    """Doubles at and around a value, from its neighbours to 1e-9 of it."""
    ulp = np.spacing(value)
    return [value + k * ulp for k in range(-3, 4)] + [
        value * (1 + s * 10.0**-e) for e in (15, 13, 12, 9) for s in (-1, 1)
    ]


@pytest.mark.parametrize("voltage", [1.0, 1 - 1e-12, 1 + 1e-12, 0.9, 1.1, 0.0, -1.0])
@pytest.mark.parametrize("body", [0, 1])
def test_exactly_at_breakaway_nothing_is_corrupt(body, voltage):
    """Oracle: the reference, where the torque on a body is the breakaway torque up to a few units in the last place.

    The body is at rest (of either sign) or slower than any event can resolve, in either direction; the voltage holds
    the current exactly, nearly, or lets it rise or fall. The other body stands under little torque.
    """
    cases = []
    for p in (NOMINAL, random_plant(np.random.default_rng(5))):
        speeds = (0.0, -0.0, 5e-324, -5e-324, 1e-300, -1e-20, 1e-16, -1e-13)
        for torque, speed in product(steps(breakaway(p, body)), speeds):
            x = np.zeros(5)
            x[1 + 2 * body] = speed
            x[2] = p["rho"] * torque / p["k_theta"] * (body == 0)
            x[4] = (torque / p["rho"] if body == 0 else torque) / p["K_t"]
            cases.append(Case(p, [voltage * p["R"] * x[4]] * 3, x))
    ours = bench(cases)
    reference = np.array([case.reference()[0] for case in cases])
    off = np.abs(ours - reference)[:, :, 0].max(axis=1)
    assert off.max() <= ANGLE, (off.max(), cases[int(off.argmax())])
    assert np.abs(ours - reference).max() <= 1e-9  # the other states, lest one be corrupt at the last sample


def test_at_rest_without_torque_nothing_moves():
    """Oracle: zero is an equilibrium; signs of zero do not matter."""
    cases = [Case(NOMINAL, [volts] * 5, np.array(x)) for volts in (0.0, -0.0) for x in product((0.0, -0.0), repeat=5)]
    assert (bench(cases) == 0.0).all()
