"""Loops in which the servomechanism is judged: many plants and voltages, short episodes, ties between events.

Nothing here looks into the bench's plant: it is moved by its public methods, and `servo_reference` tells the events.
"""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from loaded_configs import loaded
from plants.servo_oracle import breakaway
from plants.servo_reference import COARSE, FINE, RELEASE, STICK, Log, Tolerance, held

from rmpc_bench.plants import servo
from rmpc_bench.types import Motion, Plant, Status

TS = 0.1
NOMINAL = dict(servo.design(TS).nominal)

#: Plants apart from those of the papers; each changes the nominal ones.
ODD: dict[str, dict[str, float]] = {
    "small L": {"L": 0.01},
    "large L": {"L": 8.0},
    "no decay": {"alpha_l2": 0.0, "alpha_m2": 0.0},
    "Coulomb only": {"alpha_l1": 0.0, "alpha_m1": 0.0},
    "near standstill only": {"alpha_l0": 0.0, "alpha_m0": 0.0},
    "free load": {"alpha_l0": 0.0, "alpha_l1": 0.0},
    "free motor": {"alpha_m0": 0.0, "alpha_m1": 0.0},
    "low rigidity": {"k_theta": 60.0},
    "high rigidity": {"k_theta": 2e4},
    "undamped": {"beta_l": 0.0, "beta_m": 0.0},
    "light bodies": {"J_l": 2.0, "J_m": 0.05},
    "no gear": {"rho": 1.0, "k_theta": 50.0},
    "strong friction": {"alpha_l1": 40.0, "alpha_m1": 8.0},
    "sharp decay": {"alpha_l2": 5.0, "alpha_m2": 5.0},
}


class Case(NamedTuple):
    """A plant, the voltages of its samples and its state at the start."""

    p: dict[str, float]
    volts: Any
    x: Any = (0.0, 0.0, 0.0, 0.0, 0.0)

    def reference(self, tolerance: Tolerance = FINE) -> tuple[Any, Log]:
        """States (samples + 1, 5) and events by collocation."""
        return held(self.p, self.volts, self.x, TS, tolerance)


def bench(cases: Sequence[Case]) -> Any:
    """States (cases, samples + 1, 5) of the bench's plant on cases of equally many samples; all must end well."""
    plant = servo.design(TS)
    delta = plant.draw({name: np.array([case.p[name] for case in cases]) for name in NOMINAL}, [], 1)
    volts = np.array([case.volts for case in cases], dtype=float)
    states = [np.array([case.x for case in cases], dtype=float)]
    for k in range(volts.shape[1]):
        x, status = plant.step(k, delta, states[-1], volts[:, k : k + 1], np.zeros((len(cases), 4)))
        assert (status == Status.OK).all(), [cases[i] for i in np.flatnonzero(status)[:3]]
        states.append(x)
    return np.stack(states, axis=1)


class ReferencePlant(Plant):
    """The collocation reference in the place of the bench's plant; its record of dynamics is the parameters."""

    nx, nu, ny, nw, nv, Ts = 5, 1, 1, 4, 1, TS
    y_unit, u_unit, nominal = "rad", "V", NOMINAL

    def draw(self, parameters: Any, rngs: Any, n_steps: int) -> list[dict[str, float]]:
        """Split the parameters into one record per run."""
        return [{name: float(values[i]) for name, values in parameters.items()} for i in range(len(parameters["L"]))]

    def step(self, k: int, delta: list[dict[str, float]], x: Any, u: Any, w: Any) -> Motion:
        """Move over one sample; there is no noise."""
        assert not w.any()
        moved = [held(p, row_u, row_x)[0][1] for p, row_x, row_u in zip(delta, x, u, strict=True)]
        return Motion(np.array(moved), np.full(len(x), Status.OK, np.int8))

    def output(self, k: int, delta: Any, x: Any, v: Any) -> Any:
        """Measure the load angle."""
        return x[:, :1] + v


def fig7() -> Any:
    """Experiment of section 4.3, third simulation: plant, methods and scenario."""
    return loaded("zenere2018/fig7").experiment


def random_plant(rng: np.random.Generator, **changes: float) -> dict[str, float]:
    """Perturb a plant as section 4.3 does: +-10 %, +-20 %, and +-80 % on the load inertia."""
    eps_min, eps_max, eps_jl = rng.uniform(-1, 1, 3) * [0.1, 0.2, 0.8]
    factors = dict.fromkeys(("R", "rho", "k_theta"), 1 + eps_min) | {"J_l": 1 + eps_jl}
    factors |= dict.fromkeys(("J_m", "beta_m", "K_t", "beta_l"), 1 + eps_max)
    return {name: value * factors.get(name, 1.0) for name, value in (NOMINAL | changes).items()}


def bang_bang(seed: int, n: int, samples: int = 60, **changes: float) -> list[Case]:
    """Random plants under voltages that jump within +-220 V, rest at times, and are held for 1 to 5 samples."""
    rng, cases = np.random.default_rng(seed), []
    for _ in range(n):
        levels = rng.uniform(-1, 1, samples) * rng.choice([5, 20, 60, 220]) * (rng.random(samples) < 0.8)
        cases.append(Case(random_plant(rng, **changes), np.repeat(levels, rng.integers(1, 6))[:samples]))
    return cases


def random_states(seed: int, n: int, **changes: float) -> list[Case]:
    """Samples from states all over: each body at rest in every second, so that some leave it at once."""
    rng, cases = np.random.default_rng(seed), []
    for _ in range(n):
        p, x = random_plant(rng, **changes), rng.standard_normal(5) * [1.0, 0.5, 0.0, 5.0, 1.0]
        x[2] = p["rho"] * (x[0] + rng.normal(0, 2) * 10.5 / p["k_theta"])
        x[[1, 3]] *= rng.random(2) < 0.5
        cases.append(Case(p, [float(rng.uniform(-60, 60))], x))
    return cases


def near_breakaway(seed: int, n: int, **changes: float) -> list[Case]:
    """Bodies at rest or nearly so, under torques about as large as what holds them."""
    rng, cases = np.random.default_rng(seed), []
    for _ in range(n):
        p, x = random_plant(rng, **changes), np.zeros(5)
        load, motor = rng.choice([-1, 1], 2) * [breakaway(p, 0), breakaway(p, 1)]
        load, motor = [load, motor] * (1 + rng.choice([-1, 1], 2) * 10 ** rng.uniform(-5, -0.5, 2))
        speeds = rng.choice([-1, 1], 2) * 10 ** rng.uniform([-6, -4], [-2, 0.5]) * rng.integers(0, 2, 2)
        x[1], x[2], x[3] = speeds[0], p["rho"] * load / p["k_theta"], speeds[1]
        x[4] = (motor + load / p["rho"]) / p["K_t"]
        cases.append(Case(p, [float(rng.uniform(-60, 60))] * 4, x))
    return cases


def durations(log: Log) -> Iterator[tuple[int, bool, float]]:
    """Body, whether it slips (else it sticks), and duration of all episodes that an event ends [s]."""
    for body in (0, 1):
        own = log.body == body
        last = 0.0
        slips = bool(own.any() and log.kind[own][0] != RELEASE)
        for t, kind in zip(log.t[own].tolist(), log.kind[own].tolist(), strict=True):
            yield body, slips, t - last
            last, slips = t, bool(kind != STICK)


@cache
def short_episodes(n: int, shortest: float = 2e-3, longest: float = 4e-3) -> tuple[Case, ...]:
    """Loops with an episode of such a duration [s]: n in which each body slips, n in which it sticks."""
    found: dict[tuple[int, bool], list[Case]] = {(body, slips): [] for body in (0, 1) for slips in (False, True)}
    for seed in range(1000, 2000):
        for case in near_breakaway(seed, 50):
            log = case.reference(COARSE)[1]
            for kind in {(body, slips) for body, slips, span in durations(log) if shortest <= span <= longest}:
                found[kind].append(case)
        if all(len(cases) >= n for cases in found.values()):
            return tuple(case for cases in found.values() for case in cases[:n])
    raise AssertionError({kind: len(cases) for kind, cases in found.items()})
