"""Uncertain linear plant.

Model   x(k+1) = (A + H_A F_x G_x) x + B u + w~,  w~ = (Bw + H_Bw F_w G_w) w + (Bv + H_Bv F_v G_v) v,
        y(k)   = (C + H_C F_x G_x) x + D u + v~,  v~ = (Dw + H_Dw F_w G_w) w + (Dv + H_Dv F_v G_v) v.
        The section `noise` defines w and v; the law `uncertainty` defines F_x, F_w and F_v.
Source  souto2011, (20)-(25), (34)-(38); the input B u is an addition.
Cost    Five small products per run and step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.uncertain_system import (
    CHANNELS,
    Matrices,
    OfSystem,
    UncertainSystem,
    takes_matrices,
    uncertain_system,
)
from rmpc_bench.noise.distributions import Choice, Distribution, Uniform
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import Array, Channel, CompiledPlant, Motion, Period, Plant, Positive, Status, SystemMatrix, Term
from rmpc_bench.types.plant import Generators, Inputs, Outputs, ParameterValues, States

NAMES = ("x", "w", "v")


# Laws of the uncertain matrices F of a linear system: draws for every run, and moments of white laws.
#
# Model   F (r x s) is zero except on its diagonal, whose entries delta are independent.  Entries within [-1, 1] give
#         F' F <= I; larger bounds are accepted.  The F of the greedy law is a full matrix.
# Laws    uniform   delta is uniform on [low, high].
#         extremes  delta is low or high with equal probability.  Both laws draw at every step or once per run.
#         fixed     delta is a constant.
#         greedy    see simulation/adversary.py.


class Sequences(NamedTuple):
    """The uncertain matrices of a block: axis 0 = run, axis 1 = k."""

    F_x: Float[Array, "runs samples rx sx"]
    F_w: Float[Array, "runs samples rw sw"]
    F_v: Float[Array, "runs samples rv sv"]


@dataclass(frozen=True)
class Uncertainty:
    """Law of the uncertain matrices F.

    Parameters
    ----------
    law : `uniform` on [low, high], `extremes` low or high, `fixed` at value, or `greedy` against a method
    low, high : bounds of the entries (default -1 and 1)
    per : `step` draws at every k (default), `run` once per run
    value : value of a fixed law, or one per channel, such as `{x: 1, w: 0, v: -1}` (default 1)
    against : method whose error the greedy law maximises
    radius : largest norm of F of the greedy law (default 1)
    """

    law: Literal["uniform", "extremes", "fixed", "greedy"] = "uniform"
    low: float | None = None
    high: float | None = None
    per: Literal["step", "run"] | None = None
    value: float | dict[Literal["x", "w", "v"], float] | None = None
    against: str | None = None
    radius: Positive | None = None

    def __post_init__(self) -> None:
        """Set the defaults of the law and reject keys of other laws."""
        for name in (each.name for each in fields(self)[1:] if getattr(self, each.name) is not None):
            if name not in self._usual:
                raise ValueError(f"the law {self.law!r} has no {name}; it takes {', '.join(self._usual)}")
        for name, usual in self._usual.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, usual)
        if self.bounds[0] > self.bounds[1]:
            raise ValueError(f"low ({self.bounds[0]:g}) must not exceed high ({self.bounds[1]:g})")
        if self.law == "greedy" and not self.against:
            raise ValueError("against must name the method whose error the greedy law maximises")

    @property
    def _usual(self) -> Mapping[str, float | str | None]:
        """Keys of the law with their defaults."""
        if self.law == "fixed":
            return {"value": 1.0}
        return {"against": None, "radius": 1.0} if self.law == "greedy" else {"low": -1.0, "high": 1.0, "per": "step"}

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the entries of a random law."""
        return (-1.0 if self.low is None else self.low, 1.0 if self.high is None else self.high)

    @property
    def white(self) -> bool:
        """Whether F(k) is independent of the past, so that ensemble moments follow a closed recursion."""
        return self.per != "run"

    def entry(self, channel: str) -> tuple[float, float]:
        """Return mean and variance of a diagonal entry (over the runs, if drawn once per run)."""
        low, high = self.bounds
        if self.law == "fixed":
            return self.fixed[channel], 0.0
        return (low + high) / 2, (high - low) ** 2 / (12 if self.law == "uniform" else 4)

    @property
    def fixed(self) -> Mapping[str, float]:
        """Value of the entries of every channel under a fixed law."""
        if isinstance(self.value, dict):
            given: Mapping[str, float] = {str(name): value for name, value in self.value.items()}
            return {**dict.fromkeys(NAMES, 1.0), **given}
        return dict.fromkeys(NAMES, self.value or 0.0)

    def draw(self, rngs: Generators, n_samples: int, shapes: Sequence[tuple[int, int]]) -> Sequences:
        """Draw F_x, F_w and F_v of a block, with their shapes (r, s); all runs share the sequence of a fixed law.

        More samples extend a shorter draw without changing it.
        """
        n = [min(shape) for shape in shapes]
        if self.law == "fixed":
            values = np.repeat([self.fixed[name] for name in NAMES], n)
            entries = np.broadcast_to(values, (len(rngs), n_samples, sum(n)))
        else:
            n_drawn = 1 if self.per == "run" else n_samples
            shares = np.array([rng.random((n_drawn, sum(n))) for rng in rngs])
            low, high = self.bounds
            drawn = low + (high - low) * shares if self.law == "uniform" else np.where(shares < 0.5, low, high)
            entries = np.broadcast_to(drawn, (len(rngs), n_samples, sum(n)))
        parts = np.split(entries, np.cumsum(n)[:-1], axis=2)
        return Sequences(*(_diagonal(part, shape) for part, shape in zip(parts, shapes, strict=True)))


def _diagonal(entries: Float[Array, "runs samples n"], shape: tuple[int, int]) -> Float[Array, "runs samples r s"]:
    if shape == (1, 1):
        return entries[..., None]
    matrices = np.zeros((*entries.shape[:2], *shape))
    diagonal = np.arange(entries.shape[2])
    matrices[..., diagonal, diagonal] = entries
    return matrices


OK = np.int8(Status.OK)
WHITE = Uncertainty()


@dataclass(frozen=True, eq=False)
class UncertainLinear(OfSystem, Plant):
    """An uncertain linear system with the law of its uncertainty; `worst` is an adversary's sequence, k = 0..N."""

    system: UncertainSystem
    uncertainty: Uncertainty
    Ts: float
    worst: tuple[Array, ...] | None = None

    mixes_noise = True
    has_compiled_form = True
    has_period = True

    @property
    def nw(self) -> int:
        """Number of process noises."""
        return self.system.size("nw")

    @property
    def nv(self) -> int:
        """Number of measurement noises."""
        return self.system.size("nv")

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """(r, s) of F_x, F_w, F_v."""
        return tuple((self.system.size(f"r{name}"), self.system.size(f"s{name}")) for name in NAMES)

    @property
    def draws_steps(self) -> bool:
        """Whether F differs from step to step at random."""
        return self.uncertainty.law in ("uniform", "extremes") and self.uncertainty.per == "step"

    @property
    def opponent(self) -> tuple[str, float] | None:
        """Name of the method whose error the greedy law maximises, and the largest norm of its F."""
        against, radius = self.uncertainty.against, self.uncertainty.radius
        return None if against is None or radius is None else (against, radius)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warn if F exceeds the norm for which robust methods are designed."""
        law = self.uncertainty
        largest = {"fixed": max(map(abs, law.fixed.values())), "greedy": law.radius or 0.0}.get(
            law.law, max(map(abs, law.bounds))
        )
        if largest <= 1.0:
            return ()
        return (f"F reaches a norm of {largest:g}; designs for F' F <= I have no guarantee here",)

    def drawn(self, delta: Sequences) -> dict[str, Float[Array, " runs"]]:
        """Uncertain values that are constant within a run, by name, such as ``F_x.0``."""
        if self.uncertainty.per != "run":
            return {}
        found = {}
        for channel, name, F in zip(NAMES, delta._fields, delta, strict=True):
            for i in range(min(F.shape[2:]) if channel in self.system.active else 0):
                found[f"{name}.{i}"] = F[:, 0, i, i]
        return found

    def laws(self) -> dict[str, Distribution]:
        """Laws of the entries that are constant within a run; see `drawn`."""
        law, (low, high) = self.uncertainty, self.uncertainty.bounds
        if law.per != "run" or self.worst is not None:
            return {}
        of_entry = Uniform(low, high) if law.law == "uniform" else Choice((low, high))
        active = (
            (name, min(shape)) for name, shape in zip(NAMES, self.shapes, strict=True) if name in self.system.active
        )
        return {f"F_{name}.{i}": of_entry for name, n in active for i in range(n)}

    def against(self, worst: tuple[Array, ...]) -> UncertainLinear:
        """Return the plant with an adversary's sequences (samples, r, s) of F_x, F_w, F_v."""
        return replace(self, worst=worst)

    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> Sequences:
        """Draw the matrices F of a block."""
        if self.worst is not None:
            return Sequences(*(np.broadcast_to(F, (len(rngs), *F.shape)) for F in self.worst))
        if self.opponent is not None:
            raise ValueError("a greedy law has no F before `against` has given it a sequence")
        return self.uncertainty.draw(rngs, n_steps + 1, self.shapes)

    def mix(
        self, delta: Sequences, w: Float[Array, "runs samples nw"], v: Float[Array, "runs samples nv"]
    ) -> tuple[Float[Array, "runs samples nx"], Float[Array, "runs samples ny"]]:
        """Compute w~ and v~ from w and v for all samples at once."""
        if not self.system.varies:
            return self._mixed(self.system.at(0), delta, slice(None), w, v)
        parts = [self._mixed(self.system.at(k), delta, slice(k, k + 1), w, v) for k in range(w.shape[1])]
        return np.concatenate([w for w, _ in parts], axis=1), np.concatenate([v for _, v in parts], axis=1)

    def _mixed(self, m: Matrices, delta: Sequences, window: slice, w: Array, v: Array) -> tuple[Array, Array]:
        w, v = w[:, window], v[:, window]
        rows = (w.shape[0] * w.shape[1], -1)
        w_rows, v_rows = w.reshape(rows), v.reshape(rows)
        seen_w = seen_v = None
        if "w" in self.system.active:
            seen_w = mv(delta.F_w[:, window].reshape(-1, *delta.F_w.shape[2:]), mv(m.G_w, w_rows))
        if "v" in self.system.active:
            seen_v = mv(delta.F_v[:, window].reshape(-1, *delta.F_v.shape[2:]), mv(m.G_v, v_rows))

        def total(*terms: tuple[Array, Array | None]) -> Array:
            """Sum matrix times noise over the terms, skipping zero matrices."""
            parts = [mv(matrix, noise) for matrix, noise in terms if noise is not None and matrix.any()]
            mixed: Array = sum(parts) if parts else np.zeros((len(w_rows), len(terms[0][0])))  # type: ignore[assignment]
            return mixed.reshape(*w.shape[:2], -1)

        return (
            total((m.Bw, w_rows), (m.H_Bw, seen_w), (m.Bv, v_rows), (m.H_Bv, seen_v)),  # (20)
            total((m.Dw, w_rows), (m.H_Dw, seen_w), (m.Dv, v_rows), (m.H_Dv, seen_v)),  # (21)
        )

    def step(self, k: int, delta: Sequences, x: States, u: Inputs, w: States) -> Motion:
        """Return x(k+1); ``w`` is w~ of `mix`."""
        m = self.system.at(k)
        x_next = mv(m.A, x) + w
        if "x" in self.system.active:
            x_next += _through(m.H_A, delta.F_x[:, k], mv(m.G_x, x))
        if "B" in self.system.active:
            x_next += mv(m.B, u)
        return Motion(x_next, np.full(len(x), OK))

    def output(self, k: int, delta: Sequences, x: States, v: Outputs, *u: Array) -> Outputs:
        """Measure y(k); ``v`` is v~ of `mix`, and u(k) is needed with a D."""
        m = self.system.at(k)
        y = mv(m.C, x)
        if "x" in self.system.active:
            y += _through(m.H_C, delta.F_x[:, k], mv(m.G_x, x))
        if self.feedthrough:
            y += mv(m.D, *u)
        return y + v

    def compiled_form(self, delta: Sequences, n_steps: int) -> CompiledPlant:
        """Return the matrices of the system and F_x of every run."""
        m, active = self.system.over_time, self.system.active
        moved, seen = ([Term("x", (m.G_x, delta.F_x, H))] if "x" in active else [] for H in (m.H_A, m.H_C))
        driven = [Term("u", (m.B,))] if "B" in active else []
        step, output = (Term("x", (m.A,)), Term("w"), *moved, *driven), (Term("x", (m.C,)), *seen)
        return CompiledPlant(step, output, np.full(len(delta.F_x), OK))

    def period(self, k: int) -> Period | None:
        """Return the map from (x, [w; v]) to (x(k+1), y(k)) with mean and variance of F; None if F is not white."""
        if not self.uncertainty.white:
            return None
        return self._period(k) if self.system.varies or self.worst is not None else self._always

    @cached_property
    def _always(self) -> Period:
        return self._period(0)

    def _period(self, k: int) -> Period:
        m = self.system.at(k)
        M = np.block([[m.A, m.Bw, m.Bv], [m.C, m.Dw, m.Dv]])
        places = np.cumsum([0, self.nx, self.nw, self.nv])
        channels = []
        for number, name in enumerate(NAMES):
            H, H_out, G = (getattr(m, part) for part in CHANNELS[name])
            wide = np.zeros((len(G), M.shape[1]))
            wide[:, places[number] : places[number + 1]] = G
            channels.append(Channel(np.vstack([H, H_out]), wide, *self._law(k, number)))
        return Period(M, m.B, tuple(channels))

    def _law(self, k: int, number: int) -> tuple[Array, float]:
        """Mean of an F and variance of its diagonal entries at k."""
        if self.worst is not None:
            return self.worst[number][k], 0.0
        mean, variance = self.uncertainty.entry(NAMES[number]) if self.uncertainty.law != "greedy" else (0.0, 0.0)
        return mean * np.eye(*self.shapes[number]), variance

    def facts(self) -> list[tuple[str, str]]:
        """Analyse the system before any run: pairs of label and text."""
        # Imported on use, because it loads SciPy's solvers.
        from rmpc_bench.models.uncertain_system import facts

        known = self.uncertainty.law != "greedy" and self.uncertainty.white
        entries = {name: self.uncertainty.entry(name) for name in NAMES} if known else None
        return facts(self.system, entries)


def _through(H: Float[Array, "n r"], F: Float[Array, "runs r s"], seen: Float[Array, "runs s"]) -> Array:
    """Return H F z of every run, without sums in the frequent case of a scalar F."""
    if F.shape[1:] == (1, 1):
        return (F[:, 0] * seen) * H[:, 0]
    return mv(H, mv(F, seen))


@takes_matrices
def design(Ts: float, n_steps: int, *, uncertainty: Uncertainty = WHITE, **matrices: SystemMatrix) -> UncertainLinear:
    """Uncertain linear system.

    A missing matrix is zero.  A list is a diagonal for A only.  Entries may depend on k.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    matrices : the matrices of the system
    uncertainty : law of the matrices F

    Raises
    ------
    DesignError
        If the sizes are inconsistent.
    """
    return UncertainLinear(uncertain_system(n_steps, matrices), uncertainty, Ts)
