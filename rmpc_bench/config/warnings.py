"""What is probably not meant in a valid configuration: findings of stage 6 that are no errors, with the way out.

Angles in degrees, factors that look like absolute values, a missing sampling time, windows between two samples, a
filter without noise, a noise whose covariance a filter takes for its scale, estimates that start far from an operating
point or with too large a covariance, and unstable modes of the design model that are unobservable or uncontrollable.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import pi
from typing import Any

import numpy as np

from rmpc_bench.config.designs import MethodBuilder
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.plant import gap_warnings
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map, join, locate
from rmpc_bench.models.dynamics import OdeDynamics, neglected
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import Density, DesignNoise
from rmpc_bench.noise.gaussian import StudentT
from rmpc_bench.noise.measurement import Delayed, Missing
from rmpc_bench.simulation.scenario import Experiment, initial_covariance, initial_state
from rmpc_bench.types import Array, Model, Noise, Plant, Problem

TURNS = 2  # turns from 0 beyond which an angle of the reference is suspected to be in degrees
LARGEST_FACTOR = 5.0  # factor of `perturb`, or its inverse, beyond which it is suspected to be an absolute value
UNSTABLE = 1.0 + 1e-9  # modulus of an eigenvalue beyond which its mode is unstable; integrators are not
RANK = 1e-9  # smallest singular value, relative to the largest one, at which a mode counts as connected
NOISE_KEYS: Mapping[str, tuple[str, str]] = {
    "linear": ("P_w", "P_v"),
    "uncertain-linear": ("W", "V"),
}  # kind of a model -> its keys of the process and of the measurement noise; other kinds have `noise`

_LARGEST_RATIO = 1e14
"""Ratio of variances up to which the roots of covariances give nine digits, see numerics/square_root.py."""
_SAME = 1e-9  # relative difference of covariances that count as the same

Finding = tuple[list[str | int], str]  # a path of the configuration and a message


def warnings_of(draft: DraftConfig, experiment: Experiment, designs: MethodBuilder) -> list[Problem]:
    """Return what is probably not meant, each with its place and the way out; the draft has no errors."""
    found = [*_time(draft), *_windows(draft, experiment), *_angles(experiment), *_factors(draft, experiment)]
    found += [*_initial(draft, designs), *gap_warnings(draft, experiment), *_without_noise(draft, designs, experiment)]
    found += _densities(draft, designs, experiment.plant)
    for path, component in _models(draft).items():
        made = designs.undisturbed(component)
        for message in _of_model(component, made, designs.start(made)["P0"], draft, experiment):
            found.append(([*path], message))
    return [Problem(*locate(draft.tree, path), join(path), message) for path, message in found]


def _densities(draft: DraftConfig, designs: MethodBuilder, plant: Plant) -> Iterator[Finding]:
    """Say how far Ts Q_c is from the covariance over a sample, where no operating point gives that."""
    given: list[tuple[list[str | int], Any, Any]] = []
    for path, component in _models(draft).items():
        noise, made = component.parameters.get("noise"), designs.undisturbed(component)
        if isinstance(noise, DesignNoise) and isinstance(noise.process, Density) and made.operating_point is None:
            given.append(([*path, "noise", "process"], getattr(made, "dynamics", None), noise.process.density))
    if plant.ode is not None and (draft.model is None or designs.undisturbed(draft.model).operating_point is None):
        laws = [term.law for term in draft.noise.of("process") if term.law is not None]
        given += [(["noise", "process"], OdeDynamics(plant.ode), law.parameters.get("density")) for law in laws]
    for where, dynamics, density in given:
        if density is None or not isinstance(dynamics, OdeDynamics):
            continue
        nx = dynamics.ode.nx
        S, x = initial_covariance(density, nx), initial_state(draft.initial.x_hat, nx)
        largest = 100 * neglected(dynamics, S, x, draft.time.step)
        way = "its covariance over a sample there; an operating point `at` of the model gives that covariance"
        yield where, f"without an operating point Q_w = Ts Q_c: at `initial.x_hat` up to {largest:.3g} % off {way}"


def swept_noise(axes: Sequence[Sequence[str]], draft: DraftConfig) -> Iterator[Problem]:
    """Find covariances per sample beside a sweep over the sampling time, of models that take a density."""
    for path, component in _models(draft).items() if any("time.step" in axis for axis in axes) else ():
        noise = component.parameters.get("noise")
        if isinstance(noise, DesignNoise) and not isinstance(noise.process, Density):
            where = [*path, "noise", "process"]
            yield Problem(*locate(draft.tree, where), join(where), "P_w stays at every step; `density` follows it")


def _initial(draft: DraftConfig, designs: MethodBuilder) -> Iterator[Finding]:
    """Find an operating point beside an initial estimate that is not given, which then is 0."""
    if "x_hat" in draft.section("initial"):
        return
    for component in _models(draft).values():
        x = designs.undisturbed(component).x_op
        if x.any():
            numbers = ", ".join(f"{value:.6g}" for value in x)
            message = f"has no `x_hat`, so that estimates start at 0; the operating point is x = {numbers}"
            yield ["initial"], f"{message}; give `x_hat`, as a physical state"
            return


def _without_noise(draft: DraftConfig, designs: MethodBuilder, experiment: Experiment) -> Iterator[Finding]:
    """Find laws that lose or delay measurements, and no noise, although a design model has measurement noise."""
    laws = experiment.scenario.measurement
    covariances = (designs.undisturbed(component).v_law[1] for component in _models(draft).values())
    if laws and all(isinstance(law, Missing | Delayed) for law in laws) and any(map(np.any, covariances)):
        kinds = ", ".join(term.law.kind for term in draft.noise.of("measurement") if term.law is not None)
        message = f"has only laws that change y ({kinds}); it adds no noise, although the design model has one"
        yield ["noise", "measurement"], f"{message}: {{sum: [same, ..]}}"


def _scales(names: list[str], R_v: Array, draft: DraftConfig, experiment: Experiment) -> Iterator[str]:
    """Find Student's t noise with the covariance that a filter for such noise takes for its scale matrix."""
    laws = [law for law in experiment.scenario.measurement if isinstance(law, StudentT) and law.cov is not None]
    for name in names:
        estimator = draft.methods[name].estimator
        if estimator is None or estimator.kind != "student-kalman" or estimator.resolved().get("R_v") == "covariance":
            continue
        for law in laws:
            if law.cov is not None and law.cov.shape == R_v.shape and np.allclose(law.cov, R_v, rtol=_SAME, atol=0.0):
                message = f"R_v of this model is the covariance of the noise (t with dof = {law.dof:g})"
                way = "give its estimator `R_v: covariance`"
                yield f"{message}; method {name} takes it for the scale matrix: {way}"


def _digits(now: LinearModel, P0: Array) -> Iterator[str]:
    """Find an initial covariance beside which the measurement noise has too few digits."""
    try:
        seen = np.linalg.inv(np.linalg.cholesky(now.R_v)).dot(now.C)
    except np.linalg.LinAlgError:
        return
    ahead = [seen.dot(np.linalg.matrix_power(now.A, j)) for j in range(now.nx)]
    ratio = max(float(np.linalg.norm(each.dot(P0).dot(each.T), 2)) for each in ahead)
    if ratio > _LARGEST_RATIO:
        message = f"the variance of a measurement due to `initial.P` is {ratio:.2g} times that of its noise; beyond"
        yield f"{message} {_LARGEST_RATIO:g} the filters have fewer than nine correct digits: choose a smaller P"


def _time(draft: DraftConfig) -> Iterator[Finding]:
    given = draft.tree.get("time")
    if isinstance(given, Map) and "duration" in given and "step" not in given:
        yield ["time"], "has no `step`, so the sampling time is 1; give it, such as {step: 0.1, duration: 20}"


def _windows(draft: DraftConfig, experiment: Experiment) -> Iterator[Finding]:
    """Find bounds of windows between two samples, which probably are seconds."""
    if experiment.tick != 1.0 or draft.time.duration is not None:
        return
    for number, component in enumerate(draft.metrics):
        keys = {} if component is None else component.resolved()
        for key in ("from", "to"):
            value = keys.get(key)
            if isinstance(value, float) and value != int(value):
                before, after = experiment.metric_layout.around(value)
                message = f"{value:g} is between the samples {before} and {after}, because `time` is given in steps"
                yield ["metrics", number, key], f"{message}; for seconds give time.duration and time.step"


def _angles(experiment: Experiment) -> Iterator[Finding]:
    plant = experiment.plant
    r = experiment.scenario.reference.sample(experiment.n_steps + 1)
    for i, column in enumerate(r.T):
        largest = float(column[np.argmax(np.abs(column))])
        if plant.units.get(f"y.{i}", plant.y_unit) == "rad" and abs(largest) > 2 * pi * TURNS:
            message = f"reaches {largest:g} rad, {abs(largest) / (2 * pi):.3g} turns; angles are in radians"
            yield ["reference"], f"{message}: {largest:g} degrees are written {largest:g}*pi/180"


def _factors(draft: DraftConfig, experiment: Experiment) -> Iterator[Finding]:
    medians: dict[str, float] = {}
    for name, law in draft.uncertainty.scaled.items():
        medians |= zip(law.names(name), law.draw([0.5] * len(law.streams(name))), strict=True)
    for name, change in draft.changes.items():
        if not change.relative:
            continue
        factor, nominal = change.expression(medians), experiment.plant.nominal[name]
        path: list[str | int] = ["plant", "perturb", name]
        if change.expression.names and factor <= 0.0:
            uncertain = ", ".join(sorted(change.expression.names))
            message = f"`perturb` multiplies the nominal value {nominal:g} by {factor:g} at the median of {uncertain}"
            yield path, f"{message}; a factor around 1 is written 1 + {change.expression.text}"
        elif not 1 / LARGEST_FACTOR <= factor <= LARGEST_FACTOR:
            message = (
                f"`perturb` multiplies the nominal value {nominal:g} by {factor:g}, which gives {factor * nominal:g}"
            )
            yield path, f"{message}; an absolute value is written plant.set: {{{name}: {change.expression.text}}}"


def _models(draft: DraftConfig) -> dict[tuple[str | int, ...], Component]:
    """Return the design models by their path, that of all methods and those of single methods."""
    found: dict[tuple[str | int, ...], Component] = {}
    for name, components in draft.methods.items():
        if components.model is draft.model and draft.model is not None:
            found["model",] = draft.model
        elif components.model is not None:
            found["methods", name, "model"] = components.model
    return found


def _of_model(component: Component, model: Any, P0: Array, draft: DraftConfig, experiment: Experiment) -> Iterator[str]:
    names = [name for name, each in draft.methods.items() if each.model is component]
    methods = [method for method in experiment.methods if method.name in names]
    if any(method.estimator.gain_schedule is not None for method in methods):
        yield from _noise(component.kind, model, experiment)
    if model.varies or not (model.has_sets or model.is_linear_model or component.kind in NOISE_KEYS):
        return
    now = model.at(0)
    yield from _digits(now, P0)
    yield from _scales(names, now.R_v, draft, experiment)
    unseen = _disconnected(now.A.T, now.C.T)
    if unseen is not None:
        yield f"has an unobservable unstable mode (|z| = {unseen:.4g}); no estimator is stable: see A and C"
    fixed = _disconnected(now.A, now.B)
    if fixed is not None and any(draft.methods[name].controlled for name in names):
        yield f"has an uncontrollable unstable mode (|z| = {fixed:.4g}); no controller is stabilising: see A and B"


def _noise(kind: str, model: Model, experiment: Experiment) -> Iterator[str]:
    """Find noises that a filter needs and the design model lacks."""
    process, measurement = NOISE_KEYS.get(kind, ("noise.process", "noise.measurement"))
    no_w = not (model.w_law[1].any() or model.M_w(0).any())
    no_v = not (model.v_law[1].any() or model.M_v(0).any())
    scenario, plant = experiment.scenario, experiment.plant
    # A model with other noises than the plant may describe the measurement noise as a part of w.
    alike = (len(model.w_law[0]), len(model.v_law[0])) == (plant.nw, plant.nv)
    if no_w and no_v:
        message = "has neither process nor measurement noise, so that a filter ignores or fits every measurement"
        yield f"{message}; give {process} and {measurement}"
    elif no_v and alike and not _silent(scenario.measurement):
        yield f"has no measurement noise, but the plant has: a filter fits every measurement; give {measurement}"
    elif no_w and alike and not _silent(scenario.process):
        yield f"has no process noise, but the plant has: the gain of a filter tends to 0; give {process}"


def _silent(terms: tuple[Noise, ...]) -> bool:
    """Whether a noise is known to be always 0; a missing measurement is no noise."""
    added = [term for term in terms if not term.omits_measurements and not isinstance(term, Delayed)]
    return all(moment is not None and not moment.any() for term in added for moment in (term.mean, term.cov))


def _disconnected(A: Array, B: Array) -> float | None:
    """Largest modulus of an unstable eigenvalue z at which [zI - A, B] loses rank (Popov, Belevitch, Hautus)."""
    found = []
    for z in np.linalg.eigvals(A):
        if abs(z) > UNSTABLE:
            sigma = np.linalg.svd(np.hstack([z * np.eye(len(A)) - A, B]), compute_uv=False)
            if sigma[-1] <= RANK * sigma[0]:
                found.append(float(abs(z)))
    return max(found, default=None)
