"""Components that a configuration may use: their names, the modules of their classes or design functions, short texts.

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

if TYPE_CHECKING:
    from rmpc_bench.installed import InstalledComponent

DesignFunction = Callable[..., Any]

KINDS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "plants": {
        "casadi": ("adapters.casadi_plant:plant", "CasADi function or differential-algebraic equation"),
        "control": ("adapters.control:plant", "system of python-control, linear or nonlinear"),
        "data": ("plants.data:design", "recorded runs from files in place of a simulation"),
        "env": ("adapters.gymnasium:design", "environment of Gymnasium"),
        "fmu": ("adapters.fmu:plant", "co-simulation unit (FMI 2 or 3)"),
        "linear": ("plants.linear:design", "linear system with given matrices"),
        "moving-slide": ("plants.moving_slide:design", "planar parallel robot with four driven arms"),
        "ode": ("plants.ode:design", "nonlinear ODE in a Python function"),
        "scipy": ("adapters.scipy_signal:plant", "linear system of scipy.signal"),
        "servo": ("plants.servo:design", "servomechanism with inductance and dry friction"),
        "servo-linear": ("plants.servo:design_linear", "servomechanism without inductance and dry friction"),
        "uncertain-linear": ("plants.uncertain_linear:design", "linear system with uncertain matrices"),
    },
    "models": {
        "control": ("adapters.control:model", "system of python-control"),
        "linear": ("models.mixed_noise:design", "linear, with stochastic and bounded noises"),
        "linearise": ("models.linearised:design", "the plant, linearised at a point or at the estimate"),
        "nonlinear": ("models.nonlinear:design", "the plant as nonlinear functions f(x, u) and h(x)"),
        "ode": ("models.nonlinear:design_ode", "differential equation of its own"),
        "moving-slide": ("models.moving_slide:design", "planar parallel robot, linearised at the estimate"),
        "scipy": ("adapters.scipy_signal:model", "linear system of scipy.signal"),
        "servo": ("models.servo:design_nonlinear", "servomechanism with inductance and dry friction"),
        "servo-linear": ("models.servo:design", "servomechanism without inductance and dry friction"),
        "uncertain-linear": ("models.uncertain_linear:design", "linear, with uncertain matrices"),
    },
    "estimators": {
        "oracle": ("estimators.oracle:design", "knows the true uncertainty (reference)"),
        "kalman": ("estimators.kalman:design", "Kalman filter of the nominal model"),
        "directional-kalman": ("estimators.directional_kalman:design", "process noise where the uncertainty acts"),
        "fading-kalman": ("estimators.fading_kalman:design", "covariance grows by a factor per step"),
        "wasserstein-kalman": ("estimators.wasserstein_kalman:design", "worst density in a Wasserstein ball"),
        "robust-kalman": ("estimators.robust_kalman:design", "worst model in a divergence ball"),
        "risk-sensitive": ("estimators.risk_sensitive:design", "robust-kalman with a constant multiplier"),
        "h-infinity": ("estimators.h_infinity:design", "bounds the energy gain, noises to error"),
        "kalman-predictor": ("estimators.kalman_predictor:design", "one-step predictor, correlated noises"),
        "enhanced-robust": ("estimators.enhanced_robust:design", "predictor with a bound of its error"),
        "sayed-bdu": ("estimators.sayed_bdu:design", "least squares with bounded uncertainty"),
        "robust-h-infinity": ("estimators.robust_h_infinity:design", "bounds error moment and energy gain"),
        "lmmse": ("estimators.lmmse:design", "linear, uncertainty of known moments"),
        "lp-window": ("estimators.lp_window:design", "linear program over a window"),
        "student-kalman": ("estimators.student_kalman:design", "Student-t measurement noise"),
        "huber-kalman": ("estimators.huber_kalman:design", "clips large residuals or innovations"),
        "correntropy-kalman": ("estimators.correntropy_kalman:design", "far outputs have almost no weight"),
        "gated-kalman": ("estimators.gated_kalman:design", "leaves out outputs that are too unlikely"),
        "mixed": ("estimators.mixed:design", "stochastic and bounded noises together"),
        "set-membership": ("estimators.set_membership:design", "ellipsoid that contains the state"),
        "moving-horizon": ("estimators.moving_horizon:design", "linear, window with bounds"),
        "nonlinear-moving-horizon": ("estimators.nonlinear_moving_horizon:design", "nonlinear, window with bounds"),
        "kalman-disturbance": ("estimators.kalman_disturbance:design", "estimates the mean of the process noise"),
        "extended-kalman": ("estimators.extended_kalman:design", "linearises at every estimate"),
        "unscented-kalman": ("estimators.unscented_kalman:design", "sigma points, by default cubature points"),
        "control-lqe": ("adapters.control_gains:lqe", "steady filter, gain of python-control"),
    },
    "controllers": {
        "gpc": ("controllers.gpc:design", "generalised predictive control"),
        "mpc": ("controllers.mpc:design", "model predictive control, with clipping or with a QP"),
        "minimax-lq": ("controllers.minimax_lq:design", "linear-quadratic, for the worst bounded noise"),
        "lqr": ("controllers.state_feedback:lqr", "linear-quadratic, over a receding horizon"),
        "control-lqr": ("adapters.control_gains:lqr", "linear-quadratic, with the gain of python-control"),
        "game-gain": ("controllers.state_feedback:game_gain", "linear-quadratic against penalised worst-case noise"),
        "lqg": ("controllers.lqg:design", "linear-quadratic, with integrals of the control error"),
        "pid": ("controllers.pid:design", "parallel PID, one loop per input; uses no model"),
        "tube-mpc": ("controllers.tube_mpc:design", "keeps limits for all noise in a box"),
    },
    "references": {
        "constant": ("simulation.reference:constant", "constant values"),
        "s-shape": ("simulation.reference:s_shape", "S-shaped path in the plane, from rest to rest"),
        "square": ("simulation.reference:square", "alternates between two values"),
    },
    "inputs": {
        "file": ("recordings.recorded_input:design", "recorded input from csv or npz files"),
        "prbs": ("simulation.input_signals:prbs", "pseudorandom binary signal of maximum length"),
        "sine": ("simulation.input_signals:sine", "sine wave"),
        "steps": ("simulation.input_signals:steps", "values that hold until the next time"),
    },
    "noises": {
        "coloured": ("noise.correlated:coloured", "first-order coloured, stationary from the start"),
        "corners": ("noise.bounded:corners", "corners of a box, all equally likely"),
        "delayed": ("noise.measurement:delayed", "samples that arrive late"),
        "drift": ("noise.correlated:drift", "random walk"),
        "ellipsoid": ("noise.bounded:ellipsoid", "inside an ellipsoid"),
        "gaussian": ("noise.gaussian:gaussian", "normal"),
        "half-normal": ("noise.gaussian:half_normal", "half-normal, never below its centre"),
        "missing": ("noise.measurement:missing", "lost samples, gaps, slow sensors"),
        "outliers": ("noise.gaussian:outliers", "normal, and sometimes a much wider normal"),
        "quantised": ("noise.measurement:quantised", "measurements rounded to a grid"),
        "student-t": ("noise.gaussian:student_t", "Student's t, with heavy tails"),
        "uniform": ("noise.bounded:uniform", "uniform in a box"),
    },
    "metrics": {
        "mse": ("metrics.tracking:Mse", "mean square control error"),
        "mae": ("metrics.tracking:Mae", "mean absolute control error"),
        "rmse": ("metrics.tracking:Rmse", "root of the mean square control error"),
        "iae": ("metrics.tracking:Iae", "integral of the absolute control error"),
        "input_power": ("metrics.input:InputPower", "mean square of the input"),
        "input_roughness": ("metrics.input:InputRoughness", "standard deviation of the input increments"),
        "settling_time": ("metrics.tracking:SettlingTime", "time until the output stays near the reference"),
        "steady_state_error": ("metrics.tracking:SteadyStateError", "mean signed control error at the end"),
        "estimation_mse": ("metrics.estimation:EstimationMse", "mean square error of the estimate"),
        "nees": ("metrics.consistency:Nees", "estimation error in terms of its reported covariance"),
        "coverage": ("metrics.consistency:Coverage", "share of errors in the region of the reported P"),
        "crps": ("metrics.consistency:Crps", "error and reported P of a state in one score"),
        "log_score": ("metrics.consistency:LogScore", "log density of the state, from x_hat and reported P"),
        "nis": ("metrics.innovation:Nis", "innovation in terms of its reported covariance"),
        "innovation_mse": ("metrics.innovation:InnovationMse", "mean square of the innovation"),
        "whiteness": ("metrics.innovation:Whiteness", "correlation of successive innovations"),
        "sample": ("metrics.sample:Sample", "a component of a signal at one sample"),
        "inside": ("metrics.sets:Inside", "share of samples with the state in the reported set"),
        "cost": ("metrics.cost:Cost", "quadratic cost of states and inputs"),
        "certificate": ("metrics.certificate:Certificate", "worst cost found, relative to the certified bound"),
        "tracking": ("metrics.tracking:Tracking", "size of the control error, also in bursts of noise"),
        "departures": ("metrics.departures:Departures", "how often the control error is unusually large"),
        "input_variation": ("metrics.input:InputVariation", "mean size of the input increments"),
        "input_rms": ("metrics.input:InputRms", "root of the mean square of the input"),
        "input_peak": ("metrics.input:InputPeak", "largest size of an input"),
        "reported": ("metrics.reported:Reported", "a signal that methods report, as a number"),
        "fallbacks": ("metrics.reported:Fallbacks", "samples with a simpler estimate than the own one"),
        "near_singular": ("metrics.singular_poses:NearSingular", "samples close to a singular pose"),
        "violation": ("metrics.limits:Violation", "how often or how far a signal exceeds its limit"),
        "largest": ("metrics.limits:Largest", "largest size of a component of a signal"),
        "runaway": ("metrics.runaway:Runaway", "whether the output goes far beyond the reference"),
        "qp_share": ("metrics.optimised_steps:QpShare", "share of samples with a given result of the QP"),
    },
    "figures": {
        "boxplot": ("figures.boxplot:Boxplot", "a box of the runs of every method"),
        "coverage": ("figures.coverage:CoverageFigure", "share of covered errors against its level"),
        "elements": ("figures.elements:Elements", "elements of a reported matrix over time"),
        "ellipses": ("figures.ellipses:Ellipses", "covariance ellipses of the methods among their runs"),
        "rows": ("figures.rows:Rows", "a row per method: its runs, its change and more"),
        "scatter": ("figures.scatter:Scatter", "two metrics or two outputs against each other"),
        "signals": ("figures.signals:Signals", "signals of single runs or ensembles over time"),
        "sweep": ("figures.sweep:Sweep", "a metric, or its change, over swept values"),
        "tuning": ("figures.tuning:TuningOverParameter", "tuning objective over the tuned parameter"),
    },
}
"""Group -> kind -> where it is in this package, and what it is, in at most 55 characters (estimators 40)."""
BUILT_IN = {
    group: {kind: f"{__package__}.{place}" for kind, (place, _) in kinds.items()} for group, kinds in KINDS.items()
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
    if name in KINDS[group]:
        return KINDS[group][name][1]
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
