"""Names, units and bounds of the states, inputs and outputs of a plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.types.basics import Array
from rmpc_bench.types.errors import DesignError, unknown
from rmpc_bench.types.run_info import RunInfo


def indices_of(only: Sequence[Any], names: Sequence[str], n: int, noun: str) -> list[int]:
    """Return the indices of the components of a signal that the key `only` has, as names or indices (from 0)."""
    found: list[int] = []
    for number, each in enumerate(only):
        index = names.index(each) if each in names else each
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < n:
            size = "" if isinstance(each, str) else f"the signal has {n}, counted from 0"
            raise DesignError(unknown(str(each), names, noun, size), f"only.{number}")
        if index in found:
            raise DesignError(f"names {each!r} twice; name each once", f"only.{number}")
        found.append(index)
    if not found:
        raise DesignError("must name at least one component", "only")
    return found


class NamedSignals:
    """States, inputs and outputs with names; a subclass gives the attributes."""

    states: tuple[str, ...]  # states, inputs, outputs: names
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str]  # name of a state, an input or an output -> unit; names without one are left out
    # name of a state or an input -> lower and upper bound; infinite where there is none
    bounds: Mapping[str, tuple[float, float]]

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    def places(self) -> dict[str, str]:
        """Return the names by their place in a signal: ``{"x.0": "h1", "u.0": "pump", "y.0": "level"}``."""
        signals = {"x": self.states, "u": self.inputs, "y": self.outputs}
        return {f"{signal}.{i}": name for signal, names in signals.items() for i, name in enumerate(names)}

    def component_names(self) -> dict[str, str]:
        """Return the names by their places, those left out that are places themselves: ``{"x.0": "h1"}``."""
        return {place: name for place, name in self.places().items() if place != name}

    def component_units(self) -> dict[str, str]:
        """Return the units by the places of their signals: ``{"x.0": "m"}``."""
        return {place: self.units[name] for place, name in self.places().items() if name in self.units}

    def limits(self, names: Sequence[str]) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Lower and upper bounds of states or inputs, given by their names."""
        pairs = [self.bounds.get(name, (-np.inf, np.inf)) for name in names]
        low, high = np.array(pairs, dtype=float).reshape(len(names), 2).T
        return low, high

    @property
    def limits_inputs(self) -> bool:
        """Whether an input has a bound."""
        return bool(np.isfinite(self.limits(self.inputs)).any())

    def limited_inputs(self, u: Float[Array, "runs nu"], runs: RunInfo | None = None) -> Float[Array, "runs nu"]:
        """Return the inputs within their bounds; those of running runs that were beyond are counted."""
        limited = np.clip(u, *self.limits(self.inputs))
        if runs is not None:
            beyond = np.isfinite(u) & (u != limited) & runs.alive[:, None]
            for j in np.flatnonzero(beyond.any(axis=0)).tolist():
                name = self.inputs[j]
                runs.journal.warnings[f"input {name} limited to {self.bounds_text(name)}"] += int(beyond[:, j].sum())
        return limited

    def bounds_text(self, name: str) -> str:
        """Return the bounds of a state or an input with their unit."""
        low, high = self.bounds[name]
        return f"[{low:g}, {high:g}] {self.units.get(name, '')}".rstrip()


@dataclass(frozen=True, eq=False)
class Signals(NamedSignals):
    """The signals of a plant that has no differential equation."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
