"""What the designs of single-run components have in common, also in deviations from an operating point."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np

from rmpc_bench.components.user_class import HELD, UserClass
from rmpc_bench.components.user_runs import Failed, UserRuns, failed_call, is_ctrl_c
from rmpc_bench.types import OperatingPoint, RunInfo
from rmpc_bench.types.run_info import Journal


def in_deviation(user: UserClass, given: Mapping[str, Any]) -> tuple[Mapping[str, Any], OperatingPoint | None]:
    """Return what a design is made from, and the operating point to move its signals by where the class asks for it.

    A class with ``deviation = True`` gets `model.deviation` as its model, without constant parts in a steady state.
    Its signals are deviations: y - y_op, u(k-1) - u_op, r - y_op, x_hat - x_op, limits of u - u_op.  What it returns is
    moved back.
    """
    model = given.get("model")
    point = getattr(model, "operating_point", None)
    if model is None or point is None or not user.constant("deviation", False):
        return given, None
    moved = {**given, "model": model.deviation}
    if "x0" in given:
        moved["x0"] = np.asarray(given["x0"], dtype=float) - point.x
    if given.get("plant_info") is not None:
        info = given["plant_info"]
        low, high = info.limits.u
        moved["plant_info"] = info._replace(limits=info.limits._replace(u=(low - point.u, high - point.u)))
    return moved, point


TYPICAL_COST = 3e-5
"""Time of a step with a few small NumPy operations [s]."""


class SingleDesign:
    """A design that makes one object of the user per run, of what the bench provides and the keys."""

    role = ""
    starts_runs = True

    def __init__(self, user: UserClass, given: Mapping[str, Any]) -> None:
        self.user = user
        given, self.point = in_deviation(user, given)
        names = set(user.provided)
        self.given = {name: value for name, value in given.items() if name in names}
        self.keys = {name: value for name, value in given.items() if name in user.keys}
        self.on_failure: str = given.get("on_failure", "stop")
        self.max_held: float = given.get("max_held", 0.1)
        self.seconds_per_step = TYPICAL_COST
        """Time of a step of one run [s], once it has been measured."""
        self._prepared: tuple[Any] | None = None

    @property
    def cost_per_step(self) -> float:
        """As the user's class declares, or as measured in its first call."""
        return float(self.user.constant("cost_per_step", self.seconds_per_step))

    @property
    def deterministic(self) -> bool:
        """As the user's class declares."""
        return bool(getattr(self.user.component, "deterministic", True))

    @property
    def expected_failures(self) -> Mapping[str, str]:
        """As the user's class declares."""
        return getattr(self.user.component, "expected_failures", {})

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what `prepare` returned: every process makes it again."""
        return {**self.__dict__, "_prepared": None}

    @property
    def holds(self) -> bool:
        """Whether a failed step is held."""
        return self.user.group in HELD and self.on_failure == "hold"

    def may_hold(self, held: int) -> bool:
        """Whether a step of a run with so many held steps may be held."""
        # 10 % of 30 steps are 3, although 0.1 * 30 is a little more or less.
        return self.holds and held < int(np.floor(self.max_held * self.given["n_steps"] + 1e-9))

    def user_runs(self, n_runs: int, runs: RunInfo | None, signals: Mapping[str, Any]) -> UserRuns:
        """Make the objects of a block."""
        runs = run_info(n_runs) if runs is None else runs
        fixed = dict(self.given)
        if "model" in fixed:
            fixed["model"] = read_only(fixed["model"])
        if "plant_info" in fixed:
            fixed["limits"] = fixed["plant_info"].limits
        prepared, failure = None, None
        if "prepare" in self.user.arguments:
            prepared, failure = self._prepare(fixed, runs.journal)
        made = UserRuns(self.role, self.user, runs, {**fixed, "prepared": prepared}, self.given["Ts"])
        if failure is None:
            made.make(self.keys, signals)
        else:
            for row in range(n_runs):
                made.fail(failure._replace(row=row), None, {})
        return made

    def _prepare(self, fixed: Mapping[str, Any], journal: Journal) -> tuple[Any, Failed | None]:
        """Call `prepare` once in this process; return its answer, and why it failed."""
        if self._prepared is not None:
            return self._prepared[0], None
        arguments = self.user.arguments["prepare"]
        known = {**fixed, **self.keys}
        given = {name: known[name] for name in arguments.names}
        if arguments.takes_all:
            given = {**self.keys, **given}
        with journal.user_code():
            try:
                self._prepared = (self.user.constant("prepare", None)(**given),)
            except BaseException as error:
                if is_ctrl_c(error):
                    raise
                return None, failed_call(0, error)
        return self._prepared[0], None


def read_only(model: Any) -> Any:
    """Return a copy of a model whose matrices cannot be changed in place, which would change them for all runs."""
    copied = copy(model)
    for name, value in vars(copied).items() if hasattr(copied, "__dict__") else ():
        if isinstance(value, np.ndarray):
            locked = value.view()
            locked.setflags(write=False)
            # A frozen dataclass refuses an assignment.
            object.__setattr__(copied, name, locked)
    return copied


def run_info(n_runs: int) -> RunInfo:
    """Return runs 0, 1, .. with generators that depend on the index alone, for a design used without a simulation."""
    rngs = (np.random.Generator(np.random.PCG64(np.random.SeedSequence(0, spawn_key=(i,)))) for i in range(n_runs))
    return RunInfo(tuple(range(n_runs)), tuple(rngs), np.ones(n_runs, dtype=bool), Journal())
