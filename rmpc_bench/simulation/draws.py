"""The random inputs of a block of runs: what alters its measurements, copies for every method, and what is random."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.simulation.scenario import Experiment, Scenario
from rmpc_bench.types import Array, Noise, Plant


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


_CONSTANTS = (str, bytes, bool, int, float, complex, np.generic, type(None))


def own_draws(scenario: Scenario, plant: Plant, runs: range, n_steps: int, draws: Draws) -> Draws:
    """Return random inputs that a method may write into.

    Parameters
    ----------
    scenario, plant, runs, n_steps : from which ``draws`` was drawn
    draws : the random inputs, which stay as they are

    Returns
    -------
    Copies of the arrays; a record of the plant that consists of anything but arrays and numbers is drawn again.  What
    alters the measurements is not handed to any component, and is not copied.
    """
    try:
        delta = _copied(draws.delta)
    except TypeError:
        delta = scenario.draw_delta(plant, runs, n_steps)
    return draws._replace(delta=delta, x0=draws.x0.copy(), w=draws.w.copy(), v=draws.v.copy())


def _copied(value: Any) -> Any:
    """Copy the arrays in tuples, lists and mappings; raise a TypeError if there is anything else."""
    if type(value) is np.ndarray and value.dtype != object:
        # Nothing can be written into a read-only array, such as one broadcast to all runs.
        return value.copy() if value.flags.writeable else value
    if isinstance(value, _CONSTANTS):
        return value
    if isinstance(value, tuple):
        parts = [_copied(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if type(value) is list:
        return [_copied(each) for each in value]
    if type(value) is dict:
        return {name: _copied(each) for name, each in value.items()}
    raise TypeError(f"cannot copy a {type(value).__name__}")


def random_besides(experiment: Experiment) -> tuple[str, ...]:
    """Name what differs from run to run and is not stored as an uncertain quantity.

    Parameters
    ----------
    experiment : the experiment at one point of its sweep

    Returns
    -------
    some of ``noise``, ``initial state``, ``matrices of the plant`` and ``random numbers of a component``
    """
    scenario, plant = experiment.scenario, experiment.plant
    designs = (plant, *(design for method in experiment.methods for design in (method.estimator, method.controller)))
    found = {
        "noise": any(_is_random(term) for term in (*scenario.process, *scenario.measurement)),
        "initial state": any(_is_random(term) for term in scenario.x0_noise),
        "matrices of the plant": plant.draws_steps,
        "random numbers of a component": not all(design.deterministic for design in designs),
    }
    return tuple(name for name, is_random in found.items() if is_random)


def stores_quantities(experiment: Experiment) -> bool:
    """Whether values of uncertain quantities are stored of every run: named ones, bursts, or matrices of the plant."""
    scenario, plant = experiment.scenario, experiment.plant
    of_plant = plant.system is not None and not plant.draws_steps
    return bool(scenario.uncertainty or scenario.burst_names or of_plant)


def _is_random(term: Noise) -> bool:
    """Whether a law has a spread; one that does not know its covariance has some."""
    return term.cov is None or bool(np.any(term.cov))
