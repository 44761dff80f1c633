"""Nominal plants of the bench as systems of python-control."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rmpc_bench.config.load import load_config
from rmpc_bench.extras import library
from rmpc_bench.plants.nominal_step import NominalStep
from rmpc_bench.types import Ode, Parameters, Plant


def system(config: Any) -> Any:
    """Return the nominal plant of a configuration as a system of python-control, without noise.

    Parameters
    ----------
    config : file of a configuration, what `load_config` returns, or a plant

    Returns
    -------
    A `StateSpace` with the sampling time for a linear plant, a continuous `NonlinearIOSystem` for one with a
    differential equation, and a discrete one, which simulates a sample of the plant, for any other.  The parameters of
    the plant are the `params` of a nonlinear system.  Inputs are limited to their bounds.

    Raises
    ------
    DesignError
        If the plant has a memory besides its state.
    """
    loaded = load_config(config) if isinstance(config, str | Path) else config
    plant: Plant = loaded if isinstance(loaded, Plant) else loaded.experiment.plant
    ct, signals = library("control"), plant.signals
    every = ("states", "nx"), ("inputs", "nu"), ("outputs", "ny")
    named = {noun: _labels(noun, getattr(signals, noun, ()), getattr(plant, size)) for noun, size in every}
    if plant.ode is not None:
        dt = plant.Ts if plant.ode.discrete else 0
        rhs, output = _functions(plant.ode)
        return ct.nlsys(rhs, output, **named, params=dict(plant.nominal), dt=dt)
    step, Ts = NominalStep.of(plant), plant.Ts
    if step.linear is not None:
        A, B, C, _ = step.linear
        return ct.ss(A, B, C, np.zeros((len(C), B.shape[1])), Ts, **named)
    return ct.nlsys(
        lambda t, x, u, params: step.advance(round(t / Ts), x, u, params),
        lambda t, x, u, params: step.output(round(t / Ts), x, params),
        **named,
        params=dict(plant.nominal),
        dt=Ts,
    )


def _functions(ode: Ode) -> tuple[Any, Any]:
    """Return both functions of an equation as the library calls them."""
    low, high = ode.limits(ode.inputs)

    def rhs(t: float, x: Any, u: Any, params: Mapping[str, Any]) -> Any:
        return ode.slope(t, x, np.clip(u.T, low, high).T, Parameters(params))

    def output(t: float, x: Any, u: Any, params: Mapping[str, Any]) -> Any:
        return ode.measure(x, Parameters(params))

    return rhs, output


def _labels(noun: str, names: tuple[str, ...], n: int) -> Any:
    """Return names of signals; their number where they are counted, as the library takes no points in a name."""
    return n if not names or any("." in name for name in names) else list(names)
