"""Laws of the uncertain matrices F of a linear system: draws for every run, and moments of white laws.

Model   F (r x s) is zero except on its diagonal, whose entries delta are independent.  Entries within [-1, 1] give
        F' F <= I; larger bounds are accepted.  The F of the greedy law is a full matrix.
Laws    uniform   delta is uniform on [low, high].
        extremes  delta is low or high with equal probability.  Both laws draw at every step or once per run.
        fixed     delta is a constant.
        greedy    see simulation/adversary.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, Positive

NAMES = ("x", "w", "v")


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
    value : value of a fixed law: a number, or one per channel, such as `{x: 1, w: 0, v: -1}` (default 1)
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
        random = self.law in ("uniform", "extremes")
        own = {"fixed": ("value",), "greedy": ("against", "radius")}.get(self.law, ("low", "high", "per"))
        for name in ("low", "high", "per", "value", "against", "radius"):
            if name not in own and getattr(self, name) is not None:
                raise ValueError(f"the law {self.law!r} has no {name}; it takes {', '.join(own)}")
        for name, usual in (("low", -1.0), ("high", 1.0), ("per", "step")) if random else ():
            if getattr(self, name) is None:
                object.__setattr__(self, name, usual)
        if random and self.bounds[0] > self.bounds[1]:
            raise ValueError(f"low ({self.bounds[0]:g}) must not exceed high ({self.bounds[1]:g})")
        if self.law == "fixed" and self.value is None:
            object.__setattr__(self, "value", 1.0)
        if self.law == "greedy" and not self.against:
            raise ValueError("against must name the method whose error the greedy law maximises")
        if self.law == "greedy" and self.radius is None:
            object.__setattr__(self, "radius", 1.0)

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

    def draw(self, rngs: Sequence[np.random.Generator], n_samples: int, shapes: Sequence[tuple[int, int]]) -> Sequences:
        """Draw the matrices of a block; all runs share the sequence of a fixed law.

        Parameters
        ----------
        rngs : one generator per run; more samples extend a shorter draw without changing it
        n_samples : number of samples k
        shapes : (r, s) of F_x, F_w, F_v
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
