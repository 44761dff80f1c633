"""Builds the noise of the plant from the noise laws of a configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rmpc_bench.config.draft import DraftConfig, NoiseTerm
from rmpc_bench.config.same_law import SameLaw
from rmpc_bench.noise.bounded import ellipsoid
from rmpc_bench.simulation.scenario import Scenario, with_cross_covariance
from rmpc_bench.types import Array, DesignError, Noise, Plant


class NoiseLaws:
    """Builds the noise of a draft; errors are added to its problems.

    Parameters
    ----------
    draft : the sections of one point
    model : returns the default design model, whose noise is `same`; None where it cannot be built
    """

    def __init__(self, draft: DraftConfig, model: Callable[[], Any]) -> None:
        self.draft, self.model = draft, model

    def terms(self, laws: tuple[NoiseTerm, ...], n: int, channel: str, ny: int | None = None) -> tuple[Noise, ...]:
        """Build the terms of a sum for a vector of length n.

        The channel is ``process``, ``measurement`` or ``initial``, the deviation of the true initial state.  Laws that
        alter a measurement get the number `ny` of outputs, by default n.
        """
        return tuple(term for law in laws for term in self._terms(law, n, channel, n if ny is None else ny))

    def _terms(self, law: NoiseTerm, n: int, channel: str, ny: int) -> tuple[Noise, ...]:
        if law.law is not None:
            made = law.law.build(self.draft.problems, n=n, ny=ny, Ts=self.draft.values["time"].step)
            if made is None:
                return ()
            reason, key = _unfit(made, law.law.kind, channel)
            if reason:
                self.draft.problems.append(law.law.problem(reason, key))
            return () if reason else (made,)
        path: list[str | int] = ["initial", "x"] if channel == "initial" else ["noise"]
        model = self._common_model(path)
        if model is None:
            return ()
        mean, cov, shape = _model_law(model, n, channel)
        if channel != "initial" and _varies(model, channel, self.draft.values["time"].n_steps):
            self.draft.note(
                path, f"'same' must be one law at all k, but the {channel} noise of the design model changes with k"
            )
            return ()
        if len(cov) != n:
            self.draft.note(path, f"'same' gives {len(cov)} components of {channel} noise; the plant has {n}")
            return ()
        same = law.same or SameLaw()
        first = same.noise(mean, cov)
        return (first, ellipsoid(n, shape=shape, scale=same.scale)) if np.any(shape) else (first,)

    def _common_model(self, path: list[str | int]) -> Any:
        """Return the design model of all methods; None, with an error at the path, where there is none."""
        if "model" not in self.draft.tree:
            self.draft.note(path, "'same' is the law of the common design model: 'model' is missing")
        return self.model()

    def refuse_names(self, scenario: Scenario) -> None:
        """Refuse uncertain quantities with the name of a quantity of random bursts: both are columns of one table."""
        for name in sorted({*scenario.burst_names} & {*scenario.uncertainty}):
            message = f"{name!r} is the name of a quantity of the random bursts; choose another name"
            self.draft.note(["uncertainty", name], message, key=True)

    def correlated(self, plant: Plant, scenario: Scenario) -> Scenario:
        """Return a scenario of independent noises with their cross-covariance; their sizes are those of the plant."""
        cross = self.draft.cross
        if cross == "same":
            model = self._common_model(["noise"])
            cross = None if model is None else model.S
        if cross is None or not np.any(cross):
            return scenario
        try:
            return with_cross_covariance(scenario, np.atleast_2d(np.array(cross, dtype=float)), plant.nw, plant.nv)
        except DesignError as error:
            given = self.draft.tree.get("noise")
            self.draft.note(
                ["noise", "cross"] if isinstance(given, Mapping) and "cross" in given else ["noise"], str(error)
            )
            return scenario


def _unfit(law: Noise, kind: str, channel: str) -> tuple[str, str]:
    """Return why a law cannot be one of a channel, and the key with the error; empty where it can."""
    if law.alters_output and channel != "measurement":
        return f"{kind!r} alters a measurement; put it under noise.measurement", ""
    if channel == "initial" and law.has_bursts:
        return "an initial state has no bursts", "bursts"
    if channel == "initial" and not law.is_white:
        return f"an initial state is a single sample, and {kind!r} describes a correlation over time; use gaussian", ""
    return "", ""


def _model_law(model: Any, n: int, channel: str) -> tuple[Array, Array, Any]:
    """Return mean, covariance and set (its shape, or 0) of a noise of the design model."""
    if channel == "initial":
        # The covariance of the process noise, as `P: process`; states that the design model lacks start at their mean.
        return np.zeros(n), np.pad(model.Q_w, (0, max(0, n - len(model.Q_w)))), 0.0
    mean, cov = model.v_law if channel == "measurement" else model.w_law
    if not model.has_sets:
        return mean, cov, 0.0
    return mean, cov, model.M_v(0) if channel == "measurement" else model.M_w(0)


def _varies(model: Any, channel: str, n_steps: int) -> bool:
    """Whether a noise of the design model depends on k: that of a model with sets, or of one with bursts."""
    if channel == "measurement" and model.R_v_varies:
        return True
    if not model.has_sets:
        return False

    def at(k: int) -> tuple[Array, Array]:
        now = model.at(k)
        return (now.Q_w, model.M_w(k)) if channel == "process" else (now.R_v, model.M_v(k))

    pairs = ((a, b) for k in range(1, n_steps + 1) for a, b in zip(at(0), at(k), strict=True))
    return any(a is not b and not np.array_equal(a, b) for a, b in pairs)
