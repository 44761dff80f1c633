"""Ties of the servomechanism: loops at adjacent doubles between which its events change.

One number of a loop (the scale of its voltages or a parameter) is bisected by the events of `servo_reference` until no
double is left between two values with different events. There a body grazes: it touches rest without resting, or its
torque touches the breakaway torque without a release; or an event falls onto the end of a sample, or two onto another.
A solver that finds events by roots meets there a double root, a root at the end of its interval or one at its start.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from plants.servo_loops import ODD, Case, durations, random_plant
from plants.servo_reference import COARSE, Log

CHANGING = ("voltage", "J_l", "J_m", "K_t", "k_theta", "beta_l", "alpha_l1", "alpha_m1", "alpha_m2", "R", "L")
SAMPLES, COUNTED = 10, 8  # of a loop, and in which events count; the others show what became of those
TINY = 1e-5  # s; what a grazing leaves of an episode at the next double is about 1e-7 s long


class Family(NamedTuple):
    """A loop with one number that changes."""

    case: Case
    name: str
    by_sample: bool  # whether the sample of an event counts

    def events(self, factor: float) -> tuple[Any, ...]:
        """Events of the loop in their order."""
        case = self.at(factor)
        log = case._replace(volts=case.volts[:COUNTED]).reference(COARSE)[1]
        return log.signature() if self.by_sample else tuple(own[1:] for own in log.signature())

    def at(self, factor: float) -> Case:
        """Multiply the number by a factor."""
        p, volts, x = self.case
        if self.name == "voltage":
            return Case(p, volts * factor, x)
        return Case(p | {self.name: p[self.name] * factor}, volts, x)


class Tie(NamedTuple):
    """Adjacent factors of a family, and what changes between them."""

    family: Family
    low: float
    high: float
    kind: str

    def around(self, steps: Any) -> list[Case]:
        """Loops at so many doubles above (or below) the tie."""
        ulp = self.high - self.low
        return [self.family.at(self.low + step * ulp) for step in steps]


def families(seed: int, n: int, **changes: float) -> Iterator[Family]:
    """Random loops of a few samples with changing voltages, from states in which a body may be at rest."""
    rng = np.random.default_rng(seed)
    for i in range(n):
        p, x = random_plant(rng, **changes), rng.standard_normal(5) * [1.0, 0.3, 0.0, 3.0, 0.5]
        x[2] = p["rho"] * (x[0] + rng.normal(0, 1.2) * 10.5 / p["k_theta"])
        x[[1, 3]] *= rng.random(2) < 0.5
        levels = rng.uniform(-1, 1, SAMPLES) * rng.choice([5, 20, 60, 220])
        volts = np.repeat(levels, rng.integers(1, 4))[:SAMPLES]
        yield Family(Case(p, volts, x), CHANGING[rng.integers(len(CHANGING))], i % 4 == 0)


def _kind(logs: list[Log]) -> str:
    """Name what changes between two logs."""
    few, many = sorted(logs, key=lambda log: len(log.t))
    orders = {tuple(own[1:] for own in log.signature()) for log in logs}
    if len(few.t) == len(many.t):
        return "at the end of a sample" if len(orders) == 1 else "two at once"
    brief = [(span, "load" if body == 0 else "motor", slips) for body, slips, span in durations(many)]
    span, body, slips = min(brief, default=(np.inf, "", False))
    if span > TINY:
        return "at a jump of the voltage or a turn"
    return f"{body} {'slips' if slips else 'rests'} for an instant"


def bisected(family: Family, low: float, high: float) -> Tie:
    """Bisect factors between which the events change."""
    first = family.events(low)
    while np.nextafter(low, high) < high:
        middle = (low + high) / 2
        low, high = (middle, high) if family.events(middle) == first else (low, middle)
    return Tie(family, low, high, _kind([family.at(factor).reference(COARSE)[1] for factor in (low, high)]))


@cache
def ties(seed: int, n: int, odd: str = "", grid: int = 6) -> tuple[Tie, ...]:
    """Ties of random loops (of an odd kind), one in every interval of factors between which the events change."""
    found = []
    for family in families(seed, n, **ODD.get(odd, {})):
        factors = np.linspace(0.7, 1.3, grid)
        events = [family.events(factor) for factor in factors]
        for i in range(grid - 1):
            if events[i] != events[i + 1]:
                found.append(bisected(family, float(factors[i]), float(factors[i + 1])))
    return tuple(found)
