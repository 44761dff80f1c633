"""Names of the components that a configuration may use, each with the module of its class or design function.

A module is imported when its component is first used.  Installed packages add components through entry points of the
groups ``rmpc_bench.plants``, ``rmpc_bench.estimators`` and so on.  A program adds components with `register`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from rmpc_bench import notices
from rmpc_bench.short_texts import SHORT

if TYPE_CHECKING:
    from rmpc_bench.installed import InstalledComponent

DesignFunction = Callable[..., Any]

BUILT_IN: dict[str, dict[str, str]] = {
    "plants": {
        "casadi": "rmpc_bench.adapters.casadi_plant:plant",
        "control": "rmpc_bench.adapters.control:plant",
        "data": "rmpc_bench.plants.data:design",
        "env": "rmpc_bench.adapters.gymnasium:design",
        "fmu": "rmpc_bench.adapters.fmu:plant",
        "linear": "rmpc_bench.plants.linear:design",
        "moving-slide": "rmpc_bench.plants.moving_slide:design",
        "ode": "rmpc_bench.plants.ode:design",
        "scipy": "rmpc_bench.adapters.scipy_signal:plant",
        "servo": "rmpc_bench.plants.servo:design",
        "servo-linear": "rmpc_bench.plants.servo:design_linear",
        "uncertain-linear": "rmpc_bench.plants.uncertain_linear:design",
    },
    "models": {
        "control": "rmpc_bench.adapters.control:model",
        "linear": "rmpc_bench.models.mixed_noise:design",
        "linearise": "rmpc_bench.models.linearised:design",
        "nonlinear": "rmpc_bench.models.nonlinear:design",
        "ode": "rmpc_bench.models.nonlinear:design_ode",
        "moving-slide": "rmpc_bench.models.moving_slide:design",
        "scipy": "rmpc_bench.adapters.scipy_signal:model",
        "servo": "rmpc_bench.models.servo:design_nonlinear",
        "servo-linear": "rmpc_bench.models.servo:design",
        "uncertain-linear": "rmpc_bench.models.uncertain_linear:design",
    },
    "estimators": {
        "oracle": "rmpc_bench.estimators.oracle:design",
        "kalman": "rmpc_bench.estimators.kalman:design",
        "directional-kalman": "rmpc_bench.estimators.directional_kalman:design",
        "fading-kalman": "rmpc_bench.estimators.fading_kalman:design",
        "wasserstein-kalman": "rmpc_bench.estimators.wasserstein_kalman:design",
        "robust-kalman": "rmpc_bench.estimators.robust_kalman:design",
        "risk-sensitive": "rmpc_bench.estimators.risk_sensitive:design",
        "h-infinity": "rmpc_bench.estimators.h_infinity:design",
        "kalman-predictor": "rmpc_bench.estimators.kalman_predictor:design",
        "enhanced-robust": "rmpc_bench.estimators.enhanced_robust:design",
        "sayed-bdu": "rmpc_bench.estimators.sayed_bdu:design",
        "robust-h-infinity": "rmpc_bench.estimators.robust_h_infinity:design",
        "lmmse": "rmpc_bench.estimators.lmmse:design",
        "lp-window": "rmpc_bench.estimators.lp_window:design",
        "student-kalman": "rmpc_bench.estimators.student_kalman:design",
        "huber-kalman": "rmpc_bench.estimators.huber_kalman:design",
        "correntropy-kalman": "rmpc_bench.estimators.correntropy_kalman:design",
        "gated-kalman": "rmpc_bench.estimators.gated_kalman:design",
        "mixed": "rmpc_bench.estimators.mixed:design",
        "set-membership": "rmpc_bench.estimators.set_membership:design",
        "moving-horizon": "rmpc_bench.estimators.moving_horizon:design",
        "nonlinear-moving-horizon": "rmpc_bench.estimators.nonlinear_moving_horizon:design",
        "kalman-disturbance": "rmpc_bench.estimators.kalman_disturbance:design",
        "extended-kalman": "rmpc_bench.estimators.extended_kalman:design",
        "unscented-kalman": "rmpc_bench.estimators.unscented_kalman:design",
        "control-lqe": "rmpc_bench.adapters.control_gains:lqe",
    },
    "controllers": {
        "gpc": "rmpc_bench.controllers.gpc:design",
        "mpc": "rmpc_bench.controllers.mpc:design",
        "minimax-lq": "rmpc_bench.controllers.minimax_lq:design",
        "lqr": "rmpc_bench.controllers.state_feedback:lqr",
        "control-lqr": "rmpc_bench.adapters.control_gains:lqr",
        "game-gain": "rmpc_bench.controllers.state_feedback:game_gain",
        "lqg": "rmpc_bench.controllers.lqg:design",
        "pid": "rmpc_bench.controllers.pid:design",
        "tube-mpc": "rmpc_bench.controllers.tube_mpc:design",
    },
    "references": {
        "constant": "rmpc_bench.simulation.reference:constant",
        "s-shape": "rmpc_bench.simulation.reference:s_shape",
        "square": "rmpc_bench.simulation.reference:square",
    },
    "inputs": {
        "file": "rmpc_bench.recordings.recorded_input:design",
        "prbs": "rmpc_bench.simulation.input_signals:prbs",
        "sine": "rmpc_bench.simulation.input_signals:sine",
        "steps": "rmpc_bench.simulation.input_signals:steps",
    },
    "noises": {
        "coloured": "rmpc_bench.noise.correlated:coloured",
        "corners": "rmpc_bench.noise.bounded:corners",
        "delayed": "rmpc_bench.noise.measurement:delayed",
        "drift": "rmpc_bench.noise.correlated:drift",
        "ellipsoid": "rmpc_bench.noise.bounded:ellipsoid",
        "gaussian": "rmpc_bench.noise.gaussian:gaussian",
        "half-normal": "rmpc_bench.noise.gaussian:half_normal",
        "missing": "rmpc_bench.noise.measurement:missing",
        "outliers": "rmpc_bench.noise.gaussian:outliers",
        "quantised": "rmpc_bench.noise.measurement:quantised",
        "student-t": "rmpc_bench.noise.gaussian:student_t",
        "uniform": "rmpc_bench.noise.bounded:uniform",
    },
    "metrics": {
        "mse": "rmpc_bench.metrics.tracking:Mse",
        "mae": "rmpc_bench.metrics.tracking:Mae",
        "rmse": "rmpc_bench.metrics.tracking:Rmse",
        "iae": "rmpc_bench.metrics.tracking:Iae",
        "input_power": "rmpc_bench.metrics.input:InputPower",
        "input_roughness": "rmpc_bench.metrics.input:InputRoughness",
        "settling_time": "rmpc_bench.metrics.tracking:SettlingTime",
        "steady_state_error": "rmpc_bench.metrics.tracking:SteadyStateError",
        "estimation_mse": "rmpc_bench.metrics.estimation:EstimationMse",
        "nees": "rmpc_bench.metrics.consistency:Nees",
        "coverage": "rmpc_bench.metrics.consistency:Coverage",
        "crps": "rmpc_bench.metrics.consistency:Crps",
        "log_score": "rmpc_bench.metrics.consistency:LogScore",
        "nis": "rmpc_bench.metrics.innovation:Nis",
        "innovation_mse": "rmpc_bench.metrics.innovation:InnovationMse",
        "whiteness": "rmpc_bench.metrics.innovation:Whiteness",
        "sample": "rmpc_bench.metrics.sample:Sample",
        "inside": "rmpc_bench.metrics.sets:Inside",
        "cost": "rmpc_bench.metrics.cost:Cost",
        "certificate": "rmpc_bench.metrics.certificate:Certificate",
        "tracking": "rmpc_bench.metrics.tracking:Tracking",
        "departures": "rmpc_bench.metrics.departures:Departures",
        "input_variation": "rmpc_bench.metrics.input:InputVariation",
        "input_rms": "rmpc_bench.metrics.input:InputRms",
        "input_peak": "rmpc_bench.metrics.input:InputPeak",
        "reported": "rmpc_bench.metrics.reported:Reported",
        "fallbacks": "rmpc_bench.metrics.reported:Fallbacks",
        "near_singular": "rmpc_bench.metrics.singular_poses:NearSingular",
        "violation": "rmpc_bench.metrics.limits:Violation",
        "largest": "rmpc_bench.metrics.limits:Largest",
        "runaway": "rmpc_bench.metrics.runaway:Runaway",
        "qp_share": "rmpc_bench.metrics.optimised_steps:QpShare",
    },
    "figures": {
        "boxplot": "rmpc_bench.figures.boxplot:Boxplot",
        "coverage": "rmpc_bench.figures.coverage:CoverageFigure",
        "elements": "rmpc_bench.figures.elements:Elements",
        "ellipses": "rmpc_bench.figures.ellipses:Ellipses",
        "rows": "rmpc_bench.figures.rows:Rows",
        "scatter": "rmpc_bench.figures.scatter:Scatter",
        "signals": "rmpc_bench.figures.signals:Signals",
        "sweep": "rmpc_bench.figures.sweep:Sweep",
        "tuning": "rmpc_bench.figures.tuning:TuningOverParameter",
    },
}
IN_SECONDS = ("env", "fmu", "moving-slide", "servo", "servo-linear")
"""Kinds of plants and models whose parameters are in seconds."""
RENAMED_FIGURES = {
    **dict.fromkeys(
        ("trajectories", "estimation-error", "tubes", "series", "variance-with-bound", "nees"), "is now 'signals'"
    ),
    **dict.fromkeys(("plane", "pareto"), "is now 'scatter'"),
    "drivers": "is no longer a figure: leave it out, the page has it",
    "heat-map": "is now 'sweep'",
    "means": "is now 'signals' with the quantity mean, or 'rows' with show: mean",
    "paired": "is now 'rows'",
    "ranking": "is now 'rows' with show: rank",
    "shares": "is now 'rows' with show: share",
    "sweep-lines": "is now 'sweep'",
}
"""Earlier kind of a figure -> what takes its place."""

NONLINEAR: Mapping[str, frozenset[str]] = {
    "estimators": frozenset({"extended-kalman", "nonlinear-moving-horizon", "unscented-kalman"}),
    "controllers": frozenset({"pid"}),
}
"""Kinds that take a nonlinear design model, too; the others of these groups need a linear one."""
BRIDGING = tuple(sorted(BUILT_IN["estimators"]))
"""Kinds of estimators that predict where a measurement is missing: all built-in ones; others may do so as well."""
TAGS = ("linear", "nonlinear", "both", "gaps")
"""Tags of `list`: the design model that a kind takes, and whether an estimator predicts where outputs are missing."""

_REGISTERED: dict[str, dict[str, DesignFunction]] = {group: {} for group in BUILT_IN}


def unknown(name: str, known: Iterable[str], noun: str, way_out: str = "") -> str:
    """Say that a name is unknown; see `rmpc_bench.types.errors.unknown`."""
    # Imported here because `types` needs NumPy, and the names of components are listed without it.
    from rmpc_bench.types import errors

    return errors.unknown(name, known, noun, way_out)


def unknown_kind(name: str, group: str) -> str:
    """Say that no component of a group has a name, and what has taken the place of an earlier kind of figure."""
    if group == "figures" and name in RENAMED_FIGURES:
        return f"{name!r} {RENAMED_FIGURES[name]} (rmpc-bench list {group})"
    return unknown(name, names(group), singular(group), f"rmpc-bench list {group}")


def singular(group: str) -> str:
    """Name one member of a group: ``estimators`` -> ``estimator``."""
    return group.removesuffix("s")


def group_named(group: str) -> str:
    """Return a group by its name or by that of one member; a ValueError where there is none."""
    if group in BUILT_IN:
        return group
    if f"{group}s" not in BUILT_IN:
        raise ValueError(f"group: {unknown(group, BUILT_IN, 'group of components')}")
    return f"{group}s"


def register(group: str, name: str, design: DesignFunction) -> None:
    """Add a design function or class under a name; see `rmpc_bench.register`, which checks it first."""
    group = group_named(group)
    if name in BUILT_IN[group]:
        raise ValueError(f"{name!r} is a built-in {singular(group)}; choose another name")
    if _REGISTERED[group].get(name, design) is not design:
        notices.say(f"{singular(group)} {name!r}: the new definition replaces the earlier one")
    elif name not in _REGISTERED[group] and name in _entry_points(group):
        notices.say(f"{singular(group)} {name!r}: replaces the one of an installed package")
    _REGISTERED[group][name] = design


def names(group: str) -> list[str]:
    """All names of a group, sorted; ``package:name`` where the name alone is not enough."""
    points = _entry_points(group)
    unique = {name for name, each in points.items() if ":" not in name and len(each.points) == 1}
    shown = [name for name in points if name.rpartition(":")[2] not in unique or name in unique]
    return sorted({*BUILT_IN[group], *shown, *_REGISTERED[group]})


def is_known(group: str, name: str) -> bool:
    """Whether a configuration may write a name after ``kind:``; ``package:name`` is one for every installed one."""
    return name in BUILT_IN[group] or name in _REGISTERED[group] or name in _entry_points(group)


def short(group: str, name: str) -> str:
    """Say what a component is: its text, else the package that it comes from, or what its docstring begins with."""
    if name in SHORT[group]:
        return SHORT[group][name]
    if package := package_of(group, name):
        return package
    return (inspect.getdoc(get(group, name)) or "").partition("\n")[0]


def tags(group: str, kind: str) -> tuple[str, ...]:
    """Return the tags of a built-in estimator or controller; of own and installed ones only a design tells."""
    if group not in NONLINEAR or kind not in BUILT_IN[group]:
        return ()
    gaps = ("gaps",) if group == "estimators" and kind in BRIDGING else ()
    return ("both" if kind in NONLINEAR[group] else "linear", *gaps)


def package_of(group: str, name: str) -> str:
    """Return distribution and version of an installed component; empty for others."""
    is_installed = name not in BUILT_IN[group] and name not in _REGISTERED[group]
    return _entry_points(group)[name].origin if is_installed else ""


def get(group: str, name: str) -> DesignFunction:
    """Import and return a design function.

    A KeyError has the nearest known name; a BrokenPackageError says that an installed package cannot be loaded.
    """
    if name in _REGISTERED[group]:
        return _REGISTERED[group][name]
    if name in BUILT_IN[group]:
        module, attribute = BUILT_IN[group][name].split(":")
        return getattr(import_module(module), attribute)  # type: ignore[no-any-return]
    if name in _entry_points(group):
        return _entry_points(group)[name].load()  # type: ignore[no-any-return]
    raise KeyError(unknown_kind(name, group))


def installed_component(group: str, name: str) -> InstalledComponent | None:
    """Return the component of an installed package that a name stands for; None for any other component."""
    return None if name in _REGISTERED[group] or name in BUILT_IN[group] else _entry_points(group).get(name)


def checked(group: str, kind: str, made: Any, provided: Mapping[str, Any]) -> Any:
    """Return a design after the checks that every component passes; see `rmpc_bench.types.contract.checked`."""
    # Imported here because `types` needs NumPy, and the names of components are listed without it.
    from rmpc_bench.types import contract

    return contract.checked(group, kind, made, provided)


@cache
def _entry_points(group: str) -> dict[str, InstalledComponent]:
    """Installed components by their names, and by ``package:name``; a name of a built-in one is not used."""
    # Imported here, because it reads the metadata of all installed packages.
    from rmpc_bench.installed import installed

    found = dict(installed(group))
    for name in sorted({*found} & {*BUILT_IN[group]}):
        origin = found.pop(name).origin
        way_out = " or ".join(each for each in found if each.endswith(f":{name}"))
        text = f"the {singular(group)} {name!r} of {origin} is not used: a built-in one has that name"
        notices.say(f"{text}; write {way_out} for it")
    return found
