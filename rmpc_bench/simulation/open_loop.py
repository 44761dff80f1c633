"""Controllers of the bench itself: a given input (open loop), none, and a law that is called at every m-th sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import Ahead, Array, Command, CompiledLaw, Controller, Estimate, InputSignal, RunInfo


@dataclass(frozen=True, eq=False)
class OpenLoop(Controller):
    """A controller that applies a given input."""

    signal: InputSignal
    n_steps: int  # number of control periods N
    preview = 0
    uses_estimate = False
    starts_runs = True
    has_compiled_form = True

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return the inputs of the runs."""
        return CompiledLaw(self.signal.sample(runs, self.n_steps))

    def init(self, n_runs: int, runs: RunInfo | None = None) -> Float[Array, "runs samples nu"]:
        """Return the inputs of the runs; they are those of runs 0, 1, .. unless ``runs`` is given."""
        index = range(n_runs) if runs is None else runs.index
        return self.signal.sample(index, self.n_steps)

    def control(
        self,
        k: int,
        state: Float[Array, "runs samples nu"],
        y: Float[Array, "runs ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
    ) -> tuple[Float[Array, "runs samples nu"], Command]:
        """Return u(k) of every run."""
        return state, Command(state[:, k])


@dataclass(frozen=True)
class Rest(Controller):
    """A controller that leaves the plant alone."""

    nu: int
    preview = 0
    uses_estimate = False
    has_compiled_form = True

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return u = 0 for every k."""
        return CompiledLaw(np.zeros((1, 1, self.nu)))

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def control(
        self, k: int, state: None, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[None, Command]:
        """Return u = 0."""
        return None, Command(np.zeros((len(y), self.nu)))


PASSED = (
    *("starts_runs", "regulates", "regulates_to", "input_limits", "reports", "remarks", "cost_per_step"),
    *("deterministic", "uses_estimate", "compares_estimate", "takes_acting_input", "allows_late_outputs"),
)
"""What a controller around a law declares as that does."""


@dataclass(frozen=True, eq=False)
class Around(Controller):
    """A controller around a law; it declares what the law declares."""

    law: Controller

    def __post_init__(self) -> None:
        """Take over what the law declares."""
        self.__dict__.update({name: getattr(self.law, name) for name in PASSED})

    def warm_up(self) -> None:
        """Compile the law."""
        self.law.warm_up()

    def with_period(self, period: Float[Array, " ny"]) -> Controller:
        """Return the law for outputs of which some are angles."""
        return replace(self, law=self.law.with_period(period))


class HeldState(NamedTuple):
    """State of a law that is called at every m-th sample."""

    law: Any
    command: Command  # what holds until the next call


@dataclass(frozen=True, eq=False)
class Held(Around):
    """A law for a model over m samples that is called at k = 0, m, 2 m, ..; its input is held between."""

    every: int  # m
    held: Float[Array, "nx nx"]  # what a constant mean of the process noise adds up to over m samples
    knows_ahead: bool = True  # whether the law gets r(k+1), ..; otherwise it gets r(k) in their place

    @property
    def allows_delay(self) -> bool:
        """Whether it is called at every sample: a prediction would have another phase."""
        return self.every == 1 and self.law.allows_delay

    def __post_init__(self) -> None:
        """Take over what the law declares."""
        super().__post_init__()
        ahead = (self.law.preview - 1) * self.every if self.knows_ahead else 0
        self.__dict__["preview"] = ahead + 1 if self.law.preview else 0

    def init(self, n_runs: int, **runs: RunInfo) -> HeldState:
        """Start the law."""
        return HeldState(self.law.init(n_runs, **runs), Command(np.zeros((n_runs, 0))))

    def control(
        self, k: int, state: HeldState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[HeldState, Command]:
        """Call the law, or hold its input."""
        if k % self.every:
            return state, state.command
        if "w_mean" in estimate.info:
            estimate = estimate._replace(info={**estimate.info, "w_mean": mv(self.held, estimate.info["w_mean"])})
        r = r[:: self.every] if self.knows_ahead else np.repeat(r[:1], self.law.preview, axis=0)
        after, command = self.law.control(k // self.every, state.law, y, estimate, r)
        # A failure counts once.
        return HeldState(after, Command(command.u, info=command.info)), command

    def control_ahead(
        self, k: int, state: HeldState, y: Array, estimate: Estimate, r: Array, ahead: Ahead
    ) -> tuple[HeldState, Command]:
        """Call the law, which is called at every sample, with a prediction; without preview r(k) stands for all r."""
        r = r if self.knows_ahead else np.repeat(r[:1], len(ahead.y_hat) + self.law.preview, axis=0)
        after, command = self.law.control_ahead(k, state.law, y, estimate, r, ahead)
        return HeldState(after, command), command

    def applied(self, k: int, state: HeldState, u: Float[Array, "runs nu"]) -> HeldState:
        """Pass the input that acts to the law."""
        return state if k % self.every else state._replace(law=self.law.applied(k // self.every, state.law, u))


class FedState(NamedTuple):
    """State of a law beside a signal."""

    law: Any
    d: Float[Array, "runs samples nd"]


@dataclass(frozen=True, eq=False)
class Fed(Around):
    """A law of some inputs beside a signal of the others, such as a measured disturbance d."""

    signal: InputSignal  # d
    n_steps: int
    places: Sequence[int]  # positions of d
    rest: Sequence[int]  # positions of the inputs of the law
    # effect of d, which the law gets with an estimated mean of the process noise; None if d is not known
    B: Float[Array, "nx nd"] | None
    point: Float[Array, " nd"]  # d at the operating point, which a method assumes that does not know it
    allows_delay = False

    def __post_init__(self) -> None:
        """Take over what the law declares."""
        super().__post_init__()
        self.__dict__.update(preview=self.law.preview, starts_runs=True)
        if self.law.input_limits is not None:
            limits = np.tile([[-np.inf], [np.inf]], len(self.places) + len(self.rest))
            limits[:, self.rest] = [np.broadcast_to(each, len(self.rest)) for each in self.law.input_limits]
            self.__dict__["input_limits"] = (limits[0], limits[1])

    def init(self, n_runs: int, runs: RunInfo | None = None) -> FedState:
        """Start the law, and sample d of the runs."""
        index = range(n_runs) if runs is None else runs.index
        given = {"runs": runs} if runs is not None and self.law.starts_runs else {}
        return FedState(self.law.init(n_runs, **given), self.signal.sample(index, self.n_steps))

    def control(
        self, k: int, state: FedState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[FedState, Command]:
        """Add the inputs of the law to d(k)."""
        d = state.d[:, k]
        if self.B is not None:
            moved = d - self.point
            mean = mv(self.B, moved) + estimate.info.get("w_mean", 0.0)
            estimate = estimate._replace(info={**estimate.info, "w_mean": mean, "measured": moved})
        law, command = self.law.control(k, state.law, y, estimate, r)
        u = np.empty((len(y), len(self.places) + len(self.rest)))
        u[:, self.places], u[:, self.rest] = d, command.u
        return state._replace(law=law), command._replace(u=u)

    def applied(self, k: int, state: FedState, u: Float[Array, "runs nu"]) -> FedState:
        """Pass the input that acts to the law."""
        return state._replace(law=self.law.applied(k, state.law, u[:, self.rest]))

    def known_inputs(self, u: Float[Array, "runs nu"]) -> Float[Array, "runs nu"]:
        """Return the input for the estimator, with d at the operating point where it is not known."""
        if self.B is None:
            u = u.copy()
            u[:, self.places] = self.point
        return u
