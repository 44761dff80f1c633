"""The signal that a metric of a limit reads: components of y, x or u, or an extra signal of the plant, by its name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.components import in_common, units_of
from rmpc_bench.types import Array, DesignError, MetricLayout, Plant, Record, SampleWindow
from rmpc_bench.types.errors import unknown

Letter = Literal["y", "x", "u", "u_command", "extra"]
LETTERS: tuple[Letter, ...] = ("y", "x", "u", "u_command")


@dataclass(frozen=True)
class NamedSignal:
    """A signal: one component or all components of y, x or u, or an extra signal of the plant.

    Parameters
    ----------
    letter : `y`, `x`, `u`, `u_command` (u before the bounds of the plant), or `extra`
    index : of the component; None for all
    name : as the configuration gives it
    """

    letter: Letter
    index: int | None
    name: str

    @property
    def words(self) -> str:
        """The name for labels: blanks in place of underscores."""
        return self.name.replace("_", " ")

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit that its components have in common; empty where they have none."""
        if self.letter == "extra":
            return "" if layout.plant is None else layout.plant.extra_signals.get(self.name, "")
        return in_common(units_of(layout, self.letter[0], None if self.index is None else [self.index]))

    def at_samples(self, record: Record, window: SampleWindow) -> Float[Array, "runs window n"]:
        """Return the components at the samples of a window."""
        if self.letter == "extra":
            return self._extra(record, record.x[:, window.slice])
        return self._chosen(getattr(record, self.letter)[:, window.slice])

    def at_points(self, record: Record, window: SampleWindow, between: int) -> Float[Array, "runs points n"]:
        """Return the components at the samples of a window and at `between` equally spaced times between two."""
        samples = self.at_samples(record, window)
        if not between or window.length == 1:
            return samples
        states = states_between(record, window, between)
        n_runs, n_periods = states.shape[:2]
        n = samples.shape[2]
        inner = self._of_states(record, states, window).reshape(n_runs, n_periods, between, n)
        periods = np.concatenate([samples[:, :-1, None], inner], axis=2).reshape(n_runs, -1, n)
        return np.ascontiguousarray(np.concatenate([periods, samples[:, -1:]], axis=1))

    def _of_states(
        self, record: Record, states: Float[Array, "runs periods between nx"], window: SampleWindow
    ) -> Float[Array, "runs points n"]:
        """Return the components that belong to states of the plant."""
        n_runs, n_periods, between, nx = states.shape
        if self.letter == "x":
            return self._chosen(states.reshape(n_runs, -1, nx))
        if self.letter == "extra":
            return self._extra(record, states.reshape(n_runs, -1, nx))
        plant = plant_of(record)
        y, no_noise = np.empty((n_runs, n_periods, between, plant.ny)), np.zeros((n_runs, plant.nv))
        for k in range(n_periods):
            for part in range(between):
                u = [record.u[:, window.first + k]] if plant.feedthrough else []
                y[:, k, part] = plant.output(window.first + k, record.delta, states[:, k, part], no_noise, *u)
        return self._chosen(y.reshape(n_runs, -1, plant.ny))

    def _chosen(self, values: Float[Array, "runs points n_all"]) -> Float[Array, "runs points n"]:
        if self.index is None:
            return values
        if self.index >= values.shape[2]:
            raise DesignError(unknown(self.name, _components(self.letter, values.shape[2]), "signal"), "of")
        return values[:, :, self.index : self.index + 1]

    def _extra(self, record: Record, x: Float[Array, "runs points nx"]) -> Float[Array, "runs points 1"]:
        return plant_of(record).extra_signal(self.name, record.delta, x)[:, :, None]


def signal_of(layout: MetricLayout, of: str) -> NamedSignal:
    """Find a signal by its name; a DesignError has the nearest known one."""
    plant = layout.plant
    if plant is not None and of in plant.extra_signals:
        return NamedSignal("extra", None, of)
    place = of if plant is None else _places(plant).get(of, of)
    found = re.fullmatch(r"(u_command|[xyu])(?:\.([0-9]+))?", place)
    known = [*LETTERS] if plant is None else _known(plant)
    if found is None or (plant is not None and place not in known):
        raise DesignError(unknown(of, known, "signal"), "of")
    index = None if found[2] is None else int(found[2])
    return NamedSignal(next(each for each in LETTERS if each == found[1]), index, of)


def states_between(record: Record, window: SampleWindow, between: int) -> Float[Array, "runs periods between nx"]:
    """Return the states of the plant between the samples of a window."""
    steps = slice(window.first, window.last)
    x, u = record.x[:, steps], record.u[:, steps]
    if record.runs is not None:
        # A failed run has no values; its last state may be one for which the plant has no equation.
        alive = record.runs.alive[:, None, None]
        x, u = np.where(alive, x, record.x[:, :1]), np.where(alive, u, 0.0)
    with np.errstate(all="ignore"):
        states = plant_of(record).between(record.delta, x, u, between + 1, window.first)
    return states[:, :, :between]


def plant_of(record: Record) -> Plant:
    """Return the plant of the experiment; a DesignError where the trajectories come from elsewhere."""
    if record.layout.plant is None:
        raise DesignError("needs the plant of the experiment", "of")
    return record.layout.plant


def _components(letter: str, n: int) -> list[str]:
    return [letter, *(f"{letter}.{i}" for i in range(n))]


def _places(plant: Plant) -> Mapping[str, str]:
    """Return name of a component -> its place; a state goes before an input and an output of the same name."""
    found: dict[str, str] = {}
    for letter in ("x", "u", "y"):
        for place, name in plant.names.items():
            # A plant of a user may name other things, too.
            if place.partition(".")[0] == letter:
                found.setdefault(name, place)
    return found


def _known(plant: Plant) -> list[str]:
    components = [name for letter in LETTERS for name in _components(letter, getattr(plant, f"n{letter[0]}"))]
    return [*plant.extra_signals, *_places(plant), *components]
