"""What is random in a run: stored uncertain quantities, and what else there is."""

from __future__ import annotations

import numpy as np

from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Noise


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
