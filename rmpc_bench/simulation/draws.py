"""The random inputs of a block of runs, and what alters its measurements."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types import Array, Noise


class Alteration(NamedTuple):
    """A law that alters the measurements, with its random numbers."""

    law: Noise
    drawn: Float[Array, "runs samples ny"]


class Draws(NamedTuple):
    """Everything that is random or given from outside, for a block of runs."""

    delta: Any
    x0: Float[Array, "runs nx"]
    w: Float[Array, "runs samples nw"]
    v: Float[Array, "runs samples nv"]
    bursts: Bool[Array, "runs samples"] | None = None
    """Whether a term of v is in a burst; None where none has bursts."""
    alterations: tuple[Alteration, ...] = ()
    """What alters the measurements after v was added, in order."""

    @property
    def omits_measurements(self) -> bool:
        """Whether a measurement may be missing."""
        return any(law.omits_measurements for law, _ in self.alterations)

    def altered(self, k: int, y: Float[Array, "runs ny"]) -> Float[Array, "runs ny"]:
        """Return what is measured at k, as the laws that alter measurements leave it.

        Parameters
        ----------
        k : sample
        y : outputs with all noise that adds to them
        """
        for law, drawn in self.alterations:
            y = np.array(law.altered(y, drawn[:, k]))
        return y
