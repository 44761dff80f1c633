"""Warnings about an experiment before any run: what makes its results useless although every run ends well.

`control`     the plant is not stable, and there is no controller.
`stability`   a robust estimator for uncertainty of norm at most 1, and a design model that is not quadratically stable.
`loop`        a linear estimator and a linear law leave the design model unstable.
`saturation`  the input lies on its limits during (nearly) the whole run, even for the design model without noise.

Each text names the key and a way out.  They cost a few milliseconds per method and need no run of the plant.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.simulation.open_loop import Fed, OpenLoop, Rest
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Array, DesignError, Estimate, Method, Plant, PlantInfo, Status

Build = Callable[..., Any]
"""``build(group, data, **provided)`` designs a component from plain data; None where its design function refuses."""

MakeModel = Callable[[], Any]
"""Builds the design model of a method; returns None where it cannot be built."""

STABLE = 1.0 + 1e-9
"""Spectral radius up to which a system counts as stable: that of an integrator is 1 up to rounding."""
SMALL_GROWTH = 10.0
"""Growth over the run up to which an unstable system is no reason for a warning."""
ROUNDING = 1e-9
"""Relative difference of two limits that counts as none."""
SATURATED = 0.95
"""Share of the samples with the input on a limit from which on the reference counts as out of reach."""


def run_warnings(experiment: Experiment, methods: Mapping[str, Mapping[str, Any]], build: Build) -> list[str]:
    """Return one text per reason, each with the key, the numbers and a way out.

    `methods` has the plain data from which the designs of every method were made, `build` designs a component again.
    """
    checks = {"plant": _uncontrolled, "estimator": _not_quadratically_stable, "controller.limits": _saturated}
    known, found = dict[str, str | None](), dict[tuple[str, str], list[str]]()
    provided = {"Ts": experiment.plant.Ts, "n_steps": experiment.n_steps, "plant": experiment.plant}
    for method in experiment.methods:
        data = methods[method.name]
        model = partial(build, "models", data.get("model"), **provided, x_hat=data.get("x_hat", 0.0))
        for part, check in checks.items():
            # Methods with equal data share one answer.
            equal: Any = isinstance(method.controller, Rest | OpenLoop)
            if part != "plant":
                equal = json.dumps([data.get("model"), data.get(part.split(".")[0])], sort_keys=True)
            key = f"{part} {equal}"
            if key not in known:
                with np.errstate(all="ignore"):
                    known[key] = check(experiment, method, model)
            text = known[key]
            if text is not None:
                found.setdefault((part, text), []).append(method.name)
        for text in method.remarks:
            found.setdefault(("controller", text), []).append(method.name)
    n_methods = len(experiment.methods)
    return [f"{_place(part, names, n_methods)}: {text}" for (part, text), names in found.items()]


def _place(part: str, names: list[str], n_methods: int) -> str:
    """Return the key to which a text belongs."""
    if part == "plant" or len(names) == n_methods > 1:
        return part
    rest = f" (and {len(names) - 1} more)" if len(names) > 1 else ""
    return f"methods.{names[0]}.{part}{rest}"


def _uncontrolled(experiment: Experiment, method: Method, model: MakeModel) -> str | None:
    """Describe an unstable plant without a controller."""
    A = _state_matrix(experiment)
    if A is None or not isinstance(method.controller, Rest | OpenLoop):
        return None
    radius = float(np.abs(np.linalg.eigvals(A)).max())
    digits = experiment.n_steps * np.log10(max(radius, 1e-300))
    if radius <= STABLE or digits <= np.log10(SMALL_GROWTH):
        return None
    return (
        f"not stable (spectral radius of A {radius:.6g}), and there is no controller: the state grows by about "
        f"10^{digits:.0f} in {experiment.n_steps} steps; give a `controller`, fewer steps or a larger `plant.diverged`"
    )


def _state_matrix(experiment: Experiment) -> Array | None:
    """State matrix of a linear plant with nominal parameters; None of any other plant, or if it varies with k."""
    plant = experiment.plant
    if plant.system is not None:
        return None if plant.system.varies else np.asarray(plant.system.at(0).A)
    linear = plant.linear(dict(plant.nominal))
    return None if linear is None else linear.A


def _not_quadratically_stable(experiment: Experiment, method: Method, model: MakeModel) -> str | None:
    """Describe a robust estimator whose design model is not quadratically stable for its uncertainty."""
    from rmpc_bench.numerics.stability import INSIDE, hinf_peak, spectral_radius

    scale = method.estimator.uncertainty_scale
    system = getattr(model(), "system", None) if scale is not None else None
    if system is None or system.varies:
        return None
    m = system.at(0)
    if not (m.H_A.any() and m.G_x.any()):
        return None
    says = "the design model is not quadratically stable"
    means = "the error of this robust design may grow far beyond that of `kalman-predictor`; compare with it"
    radius = spectral_radius(m.A)
    if radius >= INSIDE:
        return f"{says} (spectral radius of A {radius:.6g}, must be below 1): {means}"
    norm = hinf_peak(m.A, m.H_A, scale * m.G_x).norm
    if norm < INSIDE:
        return None
    way_out = f"or take less than {1.0 / norm:.3g} times the uncertainty (H_A)"
    return f"{says} (H-infinity norm of G_x (zI - A)^-1 H_A {norm:.4g}, must be below 1): {means}, {way_out}"


def _saturated(experiment: Experiment, method: Method, model: MakeModel) -> str | None:
    """Describe a reference for which the design model, without noise, has its input on a limit all the time."""
    limits = method.controller.input_limits
    linear = model() if limits is not None else None
    if limits is None or linear is None:
        return None
    of_plant, n_steps = PlantInfo.of(experiment.plant).limits.u, experiment.n_steps
    low, high = np.maximum(limits[0], of_plant[0]), np.minimum(limits[1], of_plant[1])
    if not np.isfinite([low, high]).any():
        return None
    r = experiment.scenario.reference.sample(n_steps + 1 + method.controller.preview)
    free = seen = 0
    for u in _inputs(experiment.plant, method, linear, r, n_steps):
        seen += 1
        free += not bool(((u <= low) | (u >= high)).any())
        if free > (1.0 - SATURATED) * n_steps:
            return None
    if seen < n_steps:
        return None
    return (
        f"with the design model and without noise the input is on a limit {_pairs(low, high)} in "
        f"{100.0 * (1.0 - free / n_steps):.0f} % of the samples: the reference, up to "
        f"{np.abs(r[: n_steps + 1]).max():g}, is out of reach; check the unit of `reference`, or choose wider `limits` "
        "or a longer `time`"
    )


def _pairs(low: Float[Array, " n"], high: Float[Array, " n"]) -> str:
    """Write limits: one pair for all inputs, or one each."""
    return ", ".join(f"[{least:g}, {most:g}]" for least, most in zip(low, high, strict=True))


def _inputs(plant: Plant, method: Method, model: Any, r: Array, n_steps: int) -> Any:
    """Yield the inputs of the design model in closed loop with known states and without noise."""
    if model.feedthrough:
        return
    try:
        x = np.zeros((1, model.nx)) if method.estimator.x0 is None else method.estimator.x0[None]
        state, controller = method.controller.init(1), method.controller
        for k in range(n_steps):
            now = model.at(k)
            known = Estimate(x, None, None, np.zeros(1, dtype=np.int8), {"w_mean": np.zeros_like(x)})
            y = x @ now.C.T + now.d0
            state, command = controller.control(k, state, y, known, r[k : k + controller.preview])
            if (command.status != Status.OK).any():
                return
            u = plant.applied_inputs(np.array(command.u))
            state = controller.applied(k, state, u)
            yield u[0]
            x = x @ now.A.T + u @ now.B.T + now.f0
    except DesignError:
        # A model that depends on the state is not linear at any k.
        return


def unlimited_inputs(plant: Plant, methods: Iterable[Method]) -> Iterator[str]:
    """Yield the inputs that the plant limits, with the laws that do not."""
    found = dict[tuple[str, str], list[str]]()
    low, high = PlantInfo.of(plant).limits.u
    for name, law in ((method.name, method.controller) for method in methods):
        if not plant.limits_inputs or isinstance(law, Rest | OpenLoop):
            continue
        own = [np.broadcast_to(each, plant.nu) for each in law.input_limits or (-np.inf, np.inf)]
        wider = (own[0] < low - ROUNDING * np.abs(low)) | (own[1] > high + ROUNDING * np.abs(high))
        if isinstance(law, Fed):
            wider[law.places] = False
        for i in np.flatnonzero(wider).tolist():
            least, most = own[0][i], own[1][i]
            text = "no limits" if np.isinf([least, most]).all() else f"wider limits, [{least:g}, {most:g}]"
            found.setdefault((PlantInfo.of(plant).inputs[i], text), []).append(repr(name))
    for (signal, text), names in found.items():
        bounds = plant.signals.bounds_text(signal) if plant.signals is not None else ""
        limits = f"the plant limits `{signal}` to {bounds}; the controller of {', '.join(names)} has {text}"
        yield f"{limits}; it counts on inputs that do not act: give the controller `limits: {{u: [..]}}`"
