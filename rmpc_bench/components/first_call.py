"""The first samples of one nominal run of a method, for a check of its components before any run.

The numbers are plausible: the nominal parameters of the plant, the true initial state, and no noise.
"""

from __future__ import annotations

import io
import os
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from copy import copy
from typing import Any, NamedTuple, NoReturn, TypeVar

import numpy as np

from rmpc_bench.components.single_design import SingleDesign, run_info
from rmpc_bench.components.user_code import (
    TooLong,
    last_user_frame,
    limited,
    noted_signals,
    one_line,
    place_in,
    untouched,
)
from rmpc_bench.types import (
    Array,
    Command,
    Controller,
    Estimate,
    Estimator,
    Method,
    Plant,
    RunInfo,
    SolverError,
    Status,
    as_command,
    as_estimate,
    as_motion,
)


class Finding(NamedTuple):
    """What is wrong with a component."""

    role: str  # ``plant``, ``estimator`` or ``controller``
    message: str


class FirstAnswer(NamedTuple):
    """What a first call has found."""

    finding: Finding | None  # the first thing that is wrong; None where two samples give answers of the right form
    estimate: Estimate | None  # the estimate at k = 0, without info; None where there is none
    seconds: Mapping[str, float]  # role of a component written for one run -> duration of its last step [s]
    warnings: Mapping[str, tuple[str, ...]]  # role -> warnings of its code
    too_long: Finding | None  # where its time was over


class Sample(NamedTuple):
    """What a first call needs besides the components."""

    x0: Array  # (nx,) the true initial state
    r: Array  # (samples, ny) the reference from k = 0 on
    n_steps: int


_Design = TypeVar("_Design")


class _Stopped(Exception):
    """The first call has come to its end."""


def first_call(plant: Plant, method: Method, sample: Sample) -> FirstAnswer:
    """Simulate two samples of a method, with a limit of time in the main thread."""
    alone = method._replace(estimator=_unprepared(method.estimator), controller=_unprepared(method.controller))
    with _nothing_kept(), noted_signals() as arrived:
        return _FirstCall(_unprepared(plant), alone, sample, arrived).answer()


def _unprepared(design: _Design) -> _Design:
    """Return a design whose `prepare` is called again for the runs, which then have its warnings."""
    return copy(design) if isinstance(design, SingleDesign) else design


@contextmanager
def _nothing_kept() -> Iterator[None]:
    """Show no output, and put back what the code of a user changes for others."""
    global_state, own_state = np.random.get_state(), random.getstate()  # noqa: NPY002
    try:
        with untouched(), chdir(os.getcwd()), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            yield
    finally:
        np.random.set_state(global_state)  # noqa: NPY002
        random.setstate(own_state)


class _FirstCall:
    """One nominal run over k = 0 and k = 1; `interrupts` gets the signals that interrupt this process."""

    def __init__(self, plant: Plant, method: Method, sample: Sample, interrupts: list[int]) -> None:
        self.plant, self.method, self.sample, self.interrupts = plant, method, sample, interrupts
        self.role = ""
        self.runs: RunInfo = run_info(1)
        self.found: Finding | None = None
        self.first: Estimate | None = None
        self.warnings: dict[str, tuple[str, ...]] = {}

    def answer(self) -> FirstAnswer:
        """Simulate the two samples."""
        too_long = None
        try:
            with np.errstate(all="ignore"), limited():
                self._samples()
        except _Stopped:
            pass
        except TooLong as error:
            text = f"its first call {error}; `execution.timeout` ends runs that take too long"
            too_long = Finding(self.role, text)
        # The durations of the first step are kept apart: it may compile.
        kept = self.runs.journal.seconds
        seconds = {role: kept[role][-1] for role in ("plant", "estimator", "controller") if kept.get(role)}
        return FirstAnswer(self.found, self.first, seconds, self.warnings, too_long)

    def _samples(self) -> None:
        plant, estimator, controller = self.plant, self.method.estimator, self.method.controller
        x = self.sample.x0[None].copy()
        with self._role("plant"):
            nominal = {name: np.array([float(value)]) for name, value in plant.nominal.items()}
            delta = plant.draw(nominal, self.runs.rngs, self.sample.n_steps)
            delta = plant.start(delta, x, self.runs) if plant.starts_runs else delta
            x = np.array(plant.first_state(delta, x))
        with self._role("estimator"):
            e = _state(estimator, delta, self.runs)
        with self._role("controller"):
            c = _state(controller, delta, self.runs)
        for k in range(2):
            with self._role("plant"):
                acting = [np.zeros((1, plant.nu))] if plant.feedthrough else []
                y = np.array(plant.output(k, delta, x.copy(), np.zeros((1, plant.nv)), *acting))
                self._expect(y, "output returned y", (1, plant.ny))
            with self._role("estimator"):
                given = [np.zeros((1, plant.nu))] if estimator.takes_input else []
                e, answer = estimator.correct(k, e, y.copy(), *given)
                estimate = as_estimate(answer)
                x_hat = np.asarray(estimate.x_hat)
                if x_hat.ndim != 2 or len(x_hat) != 1:
                    self._stop(f"correct returned x_hat of shape {x_hat.shape} for one run; (1, nx) is expected")
                self._expect(x_hat, "correct returned x_hat", x_hat.shape)
                self.first = self.first or estimate._replace(info={})
            if k == self.sample.n_steps:
                return
            u, c = self._input(k, c, y, estimate)
            with self._role("plant"):
                motion = as_motion(plant.step(k, delta, x, u.copy(), np.zeros((1, plant.nw))))
                self._expect(motion.x, "step returned x", (1, plant.nx))
                x = np.array(motion.x)
            with self._role("estimator"):
                e = estimator.predict(k, e, u.copy())

    def _input(self, k: int, state: Any, y: Array, estimate: Estimate) -> tuple[Array, Any]:
        controller, r = self.method.controller, self.sample.r
        with self._role("controller"):
            state, answer = controller.control(k, state, y.copy(), estimate, r[k : k + controller.preview].copy())
            command: Command = as_command(answer)
            self._expect(command.u, "control returned u", (1, self.plant.nu))
            u = np.array(self.plant.applied_inputs(np.array(command.u)))
            return u, controller.applied(k, state, u.copy())

    def _expect(self, values: Any, what: str, shape: tuple[int, ...]) -> None:
        array = np.asarray(values)
        if array.dtype.kind not in "fiu" or array.shape != shape:
            self._stop(f"{what} of shape {array.shape} for one run; {shape} is expected")

    @contextmanager
    def _role(self, role: str) -> Iterator[None]:
        """Run code of a component; an exception or a failure that it notes ends the first call."""
        self.role = role
        try:
            yield
        except SolverError:
            # A solver may fail at these numbers.
            raise _Stopped from None
        except _Stopped:
            raise
        except (Exception, SystemExit, KeyboardInterrupt) as error:
            if isinstance(error, KeyboardInterrupt) and self.interrupts:
                raise
            place = last_user_frame(error)
            self._stop(f"{place}: {one_line(error)}" if place else one_line(error))
        known = [text for texts in self.warnings.values() for text in texts]
        self.warnings[role] = self.warnings.get(role, ()) + tuple(set(self.runs.journal.warnings) - set(known))
        for failure in self.runs.journal.failures.values():
            if failure.status != Status.CRASHED:
                raise _Stopped
            place = place_in(failure.trace)
            self._stop(f"{place}: {failure.message}" if place else failure.message, failure.component)

    def _stop(self, message: str, role: str = "") -> NoReturn:
        self.found = Finding(role or self.role, message)
        raise _Stopped


def _state(component: Estimator | Controller, delta: Any, runs: RunInfo) -> Any:
    """Return the state before the first sample."""
    init: Callable[..., Any] = component.init
    keywords = {"runs": runs} if component.starts_runs else {}
    oracle = isinstance(component, Estimator) and component.knows_uncertainty
    return init(1, delta, **keywords) if oracle else init(1, **keywords)
