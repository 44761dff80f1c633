"""Model mismatch (`check --deep`): distance of the plants from the design model, stability and convergence of gains."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.diagnostics.run_warnings import Build
from rmpc_bench.diagnostics.stability import LinearPair, constant_model, design_radius, linear_pair, spectral_radius
from rmpc_bench.diagnostics.tolerance import divergence_over_time
from rmpc_bench.noise.gaussian import Gaussian
from rmpc_bench.simulation.open_loop import OpenLoop, Rest
from rmpc_bench.simulation.scenario import Experiment, Scenario, initial_covariance, initial_state
from rmpc_bench.types import Array, DesignError, LinearPlant, Method, Model

MAX_PLANTS = 20
ROUNDING = 1e-12
"""A smaller divergence is that of equal densities, up to rounding."""
STEADY = 0.01
"""A gain this close to its limit, relative to it, has converged."""
LIMIT = 1e-3
"""A gain that changes less than this over the second half of a recursion has reached its limit."""
MAX_STEPS, MAX_ENTRIES = 40_000, 10_000_000
"""Steps of a recursion, and entries of its covariances, beyond which it is not continued."""


class NoiseScale(NamedTuple):
    """Size of the noise of the plant relative to that of the design model."""

    scale: float | None
    """Ratio of the standard deviations; None where there is no noise, or that of its law is not known."""
    channel: str
    """``measurement`` or ``process``, the noise that was compared; else ``none`` or ``unknown``."""


class MeanDivergence(NamedTuple):
    """Parts of the divergence (10) of zenere2018, averaged over time, of every plant."""

    covariance: Array
    mismatch: Array
    """The mean part at the noise of the design model; at s times its standard deviation it is 1 / s^2 of this."""
    noise: Array
    """What the noise adds to the mean part, at every s."""

    def at(self, scale: float) -> Array:
        """Return the mean part at a scale of the noise."""
        return np.asarray(self.mismatch / scale**2 + self.noise)


class GainConvergence(NamedTuple):
    """Convergence of an estimator's gain."""

    off: float = 0.0
    """Distance from its limit when the experiment ends, relative to it."""
    after: float | None = 0.0
    """Time from which on it is within STEADY of its limit [s]; None where it has not converged by `until`."""
    until: float = 0.0
    """Time over which the recursion was continued [s]; 0 for a constant gain."""
    missing: str = ""
    """Reason why the convergence is not known."""


class MethodMismatch(NamedTuple):
    """Mismatch of one method."""

    c: float | None
    """The tolerance it is designed for."""
    noise: NoiseScale
    divergence: MeanDivergence | str
    """Or the reason why there is none."""
    model_radius: float | None
    """Spectral radius of the loop with the design model, at the last gains; None where there is no linear law."""
    plant_radii: Array
    """Those of the loop with the plants."""
    gain: GainConvergence


class Mismatch(NamedTuple):
    """Mismatch of an experiment."""

    plant: str
    n_plants: int
    """Number of plants that were compared; 0 where the kind has no linear part."""
    n_steps: int
    Ts: float
    methods: dict[str, MethodMismatch]
    confounded: dict[str, list[str]]
    """Method that differs from the baseline in the estimator -> keys of its controller that differ too."""
    time_unit: str = "s"


class _MethodModel(NamedTuple):
    """A method with the design model and the start of its estimator."""

    method: Method
    data: Mapping[str, Any]
    pair: LinearPair | None
    model: Model | None
    P0: Array | None


def model_mismatch(
    experiment: Experiment,
    methods: Mapping[str, Mapping[str, Any]],
    *,
    plant: str,
    baseline: str,
    build: Build,
    known: dict[str, GainConvergence] | None = None,
) -> Mismatch:
    """Compare the plants of the first runs with the design models, and find when the gains converge.

    `methods` has the plain data from which the designs of every method were made, `build` designs a component for
    another number of steps.  `known` has the convergence of gains of other experiments, and gets the new ones.
    """
    known = {} if known is None else known
    plants, found = _plants(experiment), {}
    for method in experiment.methods:
        data = methods[method.name]
        made = _redesigned(build, data, experiment, experiment.n_steps, estimator=False) or (None, None, None)
        each = _MethodModel(method, data, linear_pair(method.estimator, method.controller), *made[:2])
        found[method.name] = MethodMismatch(
            _configured_c(each.data),
            _noise_scale(experiment.scenario, each.model),
            _divergence(experiment, each, plants),
            *_radii(each, plants),
            _gain(experiment, each, known, build),
        )
    Ts, confounded = experiment.plant.Ts, _confounded(methods, baseline)
    return Mismatch(plant, len(plants), experiment.n_steps, Ts, found, confounded, experiment.time_unit)


def _redesigned(
    build: Build, data: Mapping[str, Any], experiment: Experiment, n_steps: int, *, estimator: bool
) -> tuple[Any, Array, Any] | None:
    """Design model without disturbances, P0 of x, and estimator from plain data, for some number of steps."""
    plant = experiment.plant
    model = build("models", data.get("model"), Ts=plant.Ts, n_steps=n_steps, plant=plant, x_hat=data["x_hat"])
    of_x = constant_model(model)
    if of_x is None:
        return None
    n = of_x.nx
    try:
        x0 = initial_state(data["x_hat"], n)
        P0 = of_x.Q_w if isinstance(data["P"], str) else initial_covariance(data["P"], n)
    except DesignError:
        return None
    start = model.start(x0, P0, np.zeros((n, n)))
    provided = {"model": model, "n_steps": n_steps, "x0": start["x0"], "P0": start["P0"], "plant": None}
    # The plant has no disturbance: what is compared with it is the model of x.
    return of_x, P0, build("estimators", data.get("estimator"), **provided) if estimator else None


def _plants(experiment: Experiment) -> list[LinearPlant]:
    """Linear parts of the plants of the first runs; a single one where nothing is uncertain."""
    plant, scenario = experiment.plant, experiment.scenario
    found = []
    for run in range(min(experiment.n_runs, MAX_PLANTS) if scenario.uncertainty else 1):
        values = scenario.named_values(run)
        changed = {name: change(values) for name, change in scenario.parameters.items()}
        linear = plant.linear({**plant.nominal, **changed})
        found += [linear] if linear is not None else []
    return found


def _configured_c(data: Mapping[str, Any]) -> float | None:
    estimator = data["estimator"]
    nested = [value.get("c") for value in estimator.values() if isinstance(value, Mapping)]
    return next((float(value) for value in (estimator.get("c"), *nested) if value is not None), None)


def _noise_scale(scenario: Scenario, model: Model | None) -> NoiseScale:
    """Compare the noise of the plant with that of a design model."""
    if model is None or not (scenario.measurement or scenario.process):
        return NoiseScale(None, "none")
    for channel, terms, cov in (
        ("measurement", scenario.measurement, model.R_v),
        ("process", scenario.process, model.Q_w),
    ):
        roots = [term.root if isinstance(term, Gaussian) else None for term in terms]
        power = sum(float(np.square(root).sum()) for root in roots if root is not None)
        if roots and power == 0.0 and all(root is not None for root in roots):
            continue
        if power > 0.0 and all(root is not None for root in roots) and np.trace(cov) > 0.0:
            return NoiseScale(float(np.sqrt(power / np.trace(cov))), channel)
    silent = all(isinstance(term, Gaussian) for term in (*scenario.measurement, *scenario.process))
    return NoiseScale(None, "none" if silent else "unknown")


def _without_law(each: _MethodModel) -> str:
    if isinstance(each.method.controller, Rest | OpenLoop):
        return "no controller"
    if each.method.estimator.gain_schedule is None:
        return "the gains of the estimator depend on the data"
    return "no constant linear design model" if each.model is None else "no linear law with known gains"


def _divergence(experiment: Experiment, each: _MethodModel, plants: Sequence[LinearPlant]) -> MeanDivergence | str:
    """Average the parts of (10) over time."""
    if each.pair is None or each.model is None or each.P0 is None:
        return _without_law(each)
    if each.pair.law.state is not None:
        return "a law with a state of its own"
    if each.pair.law.affine:
        return "a law with constant terms"
    if not plants:
        return "no linear plant"
    stacked = LinearPlant(*(np.stack(matrices) for matrices in zip(*plants, strict=True)))
    if (stacked.E.shape[1], stacked.C.shape[1]) != (len(each.model.A), len(each.model.C)):
        return f"a model of {len(each.model.A)} states"
    n_steps, scenario = experiment.n_steps, experiment.scenario
    r = scenario.reference.sample(n_steps + 1 + each.method.controller.preview)
    try:
        found = divergence_over_time(stacked, each.model, each.pair, scenario.x0, each.P0, r, n_steps)
    except np.linalg.LinAlgError:
        return "the model's density is singular"
    averages = (part.mean(axis=1) for part in found)
    return MeanDivergence(*(np.where(np.abs(part) < ROUNDING, 0.0, part) for part in averages))


def _radii(each: _MethodModel, plants: Sequence[LinearPlant]) -> tuple[float | None, Array]:
    """Spectral radii of the loop with the model and with the plants."""
    if each.pair is None or each.model is None:
        return None, np.empty(0)
    fitting = [plant for plant in plants if len(plant.C) == len(each.model.C)]
    return design_radius(each.model, each.pair), np.array([spectral_radius(plant, each.pair) for plant in fitting])


def _gain(
    experiment: Experiment, each: _MethodModel, known: dict[str, GainConvergence], build: Build
) -> GainConvergence:
    """Return the convergence of a gain, computed once per description."""
    described = [each.data.get(key) for key in ("model", "estimator", "x_hat", "P")]
    key = json.dumps([experiment.plant.Ts, experiment.n_steps, *described], sort_keys=True)
    if key not in known:
        known[key] = _convergence(experiment, each, build)
    return known[key]


def _convergence(experiment: Experiment, each: _MethodModel, build: Build) -> GainConvergence:
    """Find the limit of an estimator's gain by a longer recursion."""
    if each.pair is None or each.model is None:
        return GainConvergence(missing=_without_law(each))
    Ts, n_steps = experiment.plant.Ts, experiment.n_steps
    schedule, n = each.pair.schedule, n_steps
    if len(schedule.K) == 1 and len(schedule.L) == 1:
        return GainConvergence()
    while 2 * n <= min(MAX_STEPS, MAX_ENTRIES // len(each.model.A) ** 2):
        n *= 2
        longer = _redesigned(build, each.data, experiment, n, estimator=True)
        if longer is None or longer[2] is None or linear_pair(longer[2], each.method.controller) is None:
            return GainConvergence(missing=f"its design refuses {n} steps")
        # A predictor has L = 0.
        gains = longer[2].L if np.any(longer[2].L) else longer[2].K
        distance = np.linalg.norm(gains - gains[-1], axis=(1, 2)) / max(float(np.linalg.norm(gains[-1])), 1e-300)
        if distance[n // 2 :].max() <= LIMIT:
            late = np.flatnonzero(distance > STEADY)
            return GainConvergence(float(distance[n_steps]), float(Ts * (late[-1] + 1 if len(late) else 0)), Ts * n)
    return GainConvergence(np.nan, None, Ts * n)


def _confounded(methods: Mapping[str, Any], baseline: str) -> dict[str, list[str]]:
    """Return the methods that differ from the baseline in the estimator and in the controller."""
    of_baseline, found = _leaves(methods[baseline].get("controller", {})), {}
    for name, data in methods.items():
        of_method = _leaves(data.get("controller", {}))
        every = dict.fromkeys([*of_baseline, *of_method])
        keys = [key for key in every if of_baseline.get(key) != of_method.get(key)]
        if keys and data["estimator"] != methods[baseline]["estimator"]:
            found[name] = keys
    return found


def _leaves(tree: Any, path: str = "controller") -> dict[str, str]:
    if not isinstance(tree, Mapping):
        return {path: json.dumps(tree, sort_keys=True)}
    return {leaf: text for key, value in tree.items() for leaf, text in _leaves(value, f"{path}.{key}").items()}
