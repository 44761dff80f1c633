"""What `check` says of a configuration: the short text, and with ``--full`` every setting.  It imports no pandas."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench import registry
from rmpc_bench.config.methods import method_differences, short_value
from rmpc_bench.config_file.component import build_component
from rmpc_bench.config_file.keys import model_of
from rmpc_bench.config_file.tree import kind_of, plain
from rmpc_bench.diagnostics import run_warnings
from rmpc_bench.engines.blocks import megabytes_of, seconds_of
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types.texts import cut, in_columns, width_of, wrapped

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig


MOST_METHODS, FIRST_METHODS = 40, 30  # methods that have a line; of more the first ones
MOST_REMARKS = 5  # remarks that the short text shows
MOST_NAMED = 6  # methods that a remark names
MAX_VALUES = 100  # characters of the values of a swept path that are shown
NAME = 24  # characters of a method's name
WIDTH = 80  # columns up to which methods stand in columns
CELL = 34  # characters of a line of the columns of plant and design model
_FACTOR = re.compile(r"1 \+ (\w+)")


def short_lines(path: Path, config: ExperimentConfig, *, full: bool = False, measured: bool = False) -> list[str]:
    """Return validity, size and time, a line per method, what is simulated, and remarks; long lines are not broken."""
    about = f", about {seconds_of(config):.0f} s" if "runs" in config.evaluate else ""
    lines = [f"{path} is valid: {_size(config)}{about}", "", *_method_lines(config), ""]
    plant, model = config.first_point["plant"], next(iter(config.methods.values()))["model"]
    parts = {
        "plant": _plant(config, plant),
        "model": _model(plant, model),
        "noise": f"plant: {_noise(config.first_point['noise'])}",
        "metrics": ", ".join(
            f"{metric.name}{' (primary)' * (metric.name == config.primary)}" for metric in config.experiment.metrics
        ),
        "sweep": "; ".join(f"{name}: {_values(config, name)}" for name in config.paths),
        "tuning": " ".join(tuning_line(config)),
    }
    lines += [f" {name:9}{text}" for name, text in parts.items() if text]
    found = remarks(config)
    shown = found if full else found[:MOST_REMARKS]
    more = [f" and {len(found) - len(shown)} more: --full"] if len(found) > len(shown) else []
    lines += ["", *(f" -  {text}" for text in shown), *more] if found else []
    hints = [] if full else [f" every setting: rmpc-bench check {path} --full"]
    deep = f" measure time and model mismatch: rmpc-bench check {path if full else '...'} --deep"
    hints += [] if measured or not about else [deep]
    return [*lines, *([""] if hints else []), *hints]


def full_lines(config: ExperimentConfig) -> list[str]:
    """Return every setting: plant beside design model, differences of the methods, what is left out, assumptions."""
    rows = [("", "plant", "design model"), *_plant_and_model(config)]
    lines = ["", config.title or config.name, "", *_beside(rows)]
    for each in config.model_facts:
        lines += ["", f" {each.where}", *in_columns(each.facts, indent="  ")] if each.facts else []
    differing = method_differences(config.first_point["methods"])
    lines += ["", " differences between the methods"]
    lines += in_columns([(name, _differing(keys)) for name, keys in differing.items()], indent="  ")
    lines += ["", " inherited and left out", *(f"  {text}" for text in config.left_out)] if config.left_out else []
    # Several claims may have an assumption in common.
    assumptions = dict.fromkeys(assumption for claim in config.claims for assumption in claim.assumptions)
    lines += ["", " assumptions (not stated in the paper)"] if assumptions else []
    lines += [f"  -  {text}" for text in assumptions]
    if config.paths and "runs" in config.evaluate:
        lines += ["", f" {config.n_trials():,} trials; those that points share count once"]
    if "runs" in config.evaluate:
        lines += ["", f" memory   {megabytes_of(config):.0f} MB per process for the trajectories of a block"]
    return lines


def _size(config: ExperimentConfig) -> str:
    experiment = config.experiment
    what = f"{experiment.n_runs} runs" if "runs" in config.evaluate else "exact moments"
    if config.stop is not None:
        what = f"at most {what} (stop: {config.stop.text})"
    points = f"{len(config.points)} points x " if config.paths else ""
    n = len(experiment.methods)
    return f"{points}{what} x {n} method{'s' * (n > 1)} x {experiment.n_steps} steps"


def _method_lines(config: ExperimentConfig) -> list[str]:
    """Write a line per method: name, estimator, controller and design model with their own values, and its part."""
    methods = config.first_point["methods"]
    n = len(methods) if len(methods) <= MOST_METHODS else FIRST_METHODS
    rows = []
    for name, method in [*methods.items()][:n]:
        cells = [_component(methods, name, part) if part in method else "" for part in _GROUPS]
        part = "baseline" if name == config.baseline and len(methods) > 1 else ""
        rows.append([cut(name, NAME), *cells, part])
    kept = [k for k in range(len(rows[0])) if any(row[k] for row in rows)]
    lines = in_columns([[row[k] for k in kept] for row in rows])
    if max(map(width_of, lines)) > WIDTH:
        lines = in_columns([(name, "; ".join(filter(None, cells))) for name, *cells in rows])
    return lines + ([f" and {len(methods) - n} more: --full"] if len(methods) > n else [])


_GROUPS = {"estimator": "estimators", "controller": "controllers", "model": "models"}


def _component(methods: Mapping[str, Any], method: str, part: str) -> str:
    """Write the kind of a component with its own values: no defaults; of other parts than estimators what differs."""
    own = methods[method][part]
    kind, group = kind_of(own), _GROUPS[part]
    alike = {name: {part: each[part]} for name, each in methods.items() if part in each}
    kinds = {kind_of(each[part]) for each in alike.values()}
    if part != "estimator":
        alike = {name: each for name, each in alike.items() if kind_of(each[part]) == kind}
    fields = model_of(group, kind).model_fields if registry.is_known(group, kind) else {}
    shown = []
    for path, value in method_differences(alike)[method].items():
        key = path.removeprefix(f"{part}.")
        is_default = key in fields and fields[key].default == value or key.endswith(".kl") and value == "printed"
        if key not in ("kind", "file") and not is_default:
            shown.append(f"{key.replace('.', ' ')} {short_value(value)}")
    return ", ".join([*([kind] if part != "model" or len(kinds) > 1 else []), *shown])


def _plant(config: ExperimentConfig, plant: Mapping[str, Any]) -> str:
    """Write the kind of the plant with what is random in it."""
    groups: dict[str, list[str]] = {}
    laws = config.first_point["uncertainty"]
    for name, text in plant.get("perturb", {}).items():
        factor = _FACTOR.fullmatch(str(text))
        law = laws.get(factor[1], {}) if factor is not None else {}
        same = law.get("dist") == "uniform" and law["low"] == -law["high"]
        groups.setdefault(f"+-{100 * law['high']:g} %" if same else f"x ({text})", []).append(name)
    texts = [f"{', '.join(names)} {law}" for law, names in groups.items()]
    texts += [f"{name} = {text}" for name, text in plant.get("set", {}).items()]
    found = f"; uncertain per run: {'; '.join(texts)}" if texts else ""
    own = plant.get("uncertainty")
    if isinstance(own, Mapping):
        rest = {key: value for key, value in own.items() if key != "per"}
        found += (
            f"; uncertain per {own.get('per', 'run')}: {', '.join(f'{k} {short_value(v)}' for k, v in rest.items())}"
        )
    return kind_of(plant) + found


def _model(plant: Mapping[str, Any], model: Mapping[str, Any]) -> str:
    """Write the kind of the design model, what it lacks against the plant, and which values differ."""
    names = {name for name, value in plant.items() if not isinstance(value, str | Mapping)}
    at = f" at {short_value(model['at'])}" if "at" in model else ""
    if not names & {*model}:
        return kind_of(model) + at
    lacking = [name for name in plant if name in names - {*model}]
    common = [name for name in plant if name in names & {*model} and plain(plant[name]) != plain(model[name])]
    other = [f"{name} {short_value(model[name])}, not {short_value(plant[name])}" for name in common]
    texts = [f"it has no {', '.join(lacking)}"] * bool(lacking) + other
    return "; ".join([kind_of(model) + at, *texts])


def _noise(noise: Any) -> str:
    if not isinstance(noise, Mapping):
        return short_value(noise)
    return ", ".join(f"{name} {_term(law)}" for name, law in noise.items())


def _term(law: Any) -> str:
    if isinstance(law, Mapping) and [*law] == ["same"]:
        scale = law["same"].get("scale", 1.0)
        return "as the design model" if scale == 1 else f"{scale:g} x design model"
    if isinstance(law, Mapping) and [*law] == ["sum"]:
        return " + ".join(map(_term, law["sum"]))
    return short_value(law)


def remarks(config: ExperimentConfig) -> list[str]:
    """Return what matters for the comparison, the severest first: warnings, equal methods, components."""
    keys: dict[tuple[str, ...], list[str]] = {}
    for name in config.methods:
        keys.setdefault(tuple(point.method_keys.get(name, name) for point in config.points), []).append(name)
    same = [f"{other} is the same as {first}" for first, *others in keys.values() for other in others]
    return [f"warning: {text}" for text in warning_texts(config)] + same + [*dict.fromkeys(_of_components(config))]


def _of_components(config: ExperimentConfig) -> Iterator[str]:
    """Yield remarks on plant, design models, noises, estimators, controllers and metrics."""
    from rmpc_bench.components.single_design import SingleDesign
    from rmpc_bench.diagnostics.run_warnings import unlimited_inputs
    from rmpc_bench.simulation.closed_loop import metric_remarks

    experiment = config.experiment
    named = [("plant", experiment.plant.remarks), *((each.where, each.remarks) for each in config.model_facts)]
    for method in experiment.methods:
        named += [(method.name, method.estimator.remarks), (method.name, method.controller.remarks)]
    yield from (f"{name}: {text}" for name, texts in named for text in texts)
    for name, law in config.first_point["noise"].items():
        size = experiment.plant.nw if name == "process" else experiment.plant.nv
        terms = experiment.scenario.process if name == "process" else experiment.scenario.measurement
        moments = [moment for term in terms for moment in (term.mean, term.cov)]
        is_silent = all(moment is not None and not moment.any() for moment in moments)
        if isinstance(law, dict) and "same" in law and size and is_silent:
            yield f"{name} noise: `same` as that of the design model, which has none"
    # A class for one run cannot say whether it has limits.
    laws = [method for method in experiment.methods if not isinstance(method.controller, SingleDesign)]
    yield from (*metric_remarks(experiment), *unlimited_inputs(experiment.plant, laws))
    for name, part in config.first_point["methods"].items():
        if part["estimator"].get("kind") == "moving-horizon" and "at" in part["model"]:
            yield f"moving-horizon of {name!r} is linear, around `at`; without active bounds it is `kalman`"
    forms: dict[bool, list[str]] = {True: [], False: []}
    for method in experiment.methods:
        if method.estimator.form is not None:
            forms[method.estimator.form == "filter"].append(method.name)
    if all(forms.values()):
        with_y, without = (
            ", ".join(names) if len(names) <= MOST_NAMED else f"{len(names)} methods" for names in forms.values()
        )
        yield f"x_hat(k) uses y(k) in {with_y}, and not in {without}"


def _values(config: ExperimentConfig, path: str) -> str:
    values = dict.fromkeys(point.coordinates[path] for point in config.points)
    text = ", ".join(values)
    return text if len(text) <= MAX_VALUES else f"{len(values)} values, from {cut(next(iter(values)), MAX_VALUES // 2)}"


def _differing(keys: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {short_value(value)}" for key, value in keys.items()) or "nothing"


def _beside(rows: list[tuple[str, str, str]]) -> list[str]:
    """Put the cells of plant and design model beside each other, broken in their columns."""
    lines: list[tuple[str, str, str]] = []
    for name, *cells in rows:
        parts = [wrapped(cell, CELL) for cell in cells]
        lines += [
            (name if k == 0 else "", one, other) for k, (one, other) in enumerate(zip_longest(*parts, fillvalue=""))
        ]
    return in_columns(lines)


def _plant_and_model(config: ExperimentConfig) -> list[tuple[str, str, str]]:
    resolved = config.first_point
    plant, model = dict(resolved["plant"]), dict(next(iter(config.methods.values()))["model"])
    rows = [("kind", kind_of(plant), kind_of(model))]
    for part in (plant, model):
        part.pop("kind" if "kind" in part else "file")
    perturbed, replaced = plant.pop("perturb", {}), plant.pop("set", {})
    assumed, nominal = model.pop("noise", None), config.experiment.plant.nominal
    # Parameters of a differential equation have no keys of their own.
    for name in dict.fromkeys([*plant, *model, *perturbed, *replaced]):
        true = short_value(plant[name] if name in plant else nominal.get(name, "-"))
        true = f"{true} x ({perturbed[name]})" if name in perturbed else str(replaced.get(name, true))
        rows.append(
            (name, true if name in {**plant, **perturbed, **replaced} else "-", short_value(model.get(name, "-")))
        )
    initial, noise = resolved["initial"], resolved["noise"]
    given = {key: initial[key] for key in ("x_hat", "P", "M") if key in initial}
    start = ", ".join(f"{key} = {short_value(each) if isinstance(each, list) else each}" for key, each in given.items())
    rows += _terms("noise", noise, "-" if assumed is None else short_value(assumed))
    rows += [("input", short_value(resolved["input"]), "-")] if "input" in resolved else []
    if "x" not in initial:
        return [*rows, ("initial", "x is the plant's own", start)]
    return rows + _terms("initial", {"x": initial["x"]}, start)


def _terms(label: str, laws: Any, model: str) -> list[tuple[str, str, str]]:
    """Return a row for laws, and one for every term of a sum."""
    terms = [
        (f"{'+' if number else f'{name} ='} {short_value(term)}")
        for name, law in (laws.items() if isinstance(laws, Mapping) else [("", laws)])
        for number, term in enumerate(law["sum"] if isinstance(law, dict) and "sum" in law else [law])
    ]
    return [
        (label if k == 0 else "", text.removeprefix(" = "), model if k == 0 else "") for k, text in enumerate(terms)
    ]


def tuning_line(config: ExperimentConfig, only: Collection[str] | None = None) -> list[str]:
    """Return what is still to be tuned of the methods that are computed, as one line; no line where nothing is."""
    if config.tuning is None:
        return []
    protocol = config.tuning.protocol
    names = dict.fromkeys(each.method for each in config.tuning.missing if only is None or each.method in only)
    if not names:
        return []
    tuning, tested = config.tuning.n_trials(list(names))
    points = f"{len(config.points)} points x " if config.paths else ""
    methods = f"{len(names)} method{'s' if len(names) > 1 else ''}"
    size = f"{points}{methods} x {protocol.budget} values x {protocol.runs} runs"
    return [f"at most {tuning:,} trials ({size})" + (f", and {tested:,} for the regret" if tested else "")]


MAX_POINTS = 12  # points of a sweep that are examined, the first ones


def warning_texts(config: ExperimentConfig) -> list[str]:
    """Return one text per warning; equal warnings of the points of a sweep share one."""
    found: dict[str, list[str]] = {}
    with single_thread():
        for point in config.points[:MAX_POINTS]:
            for text in run_warnings.run_warnings(point.experiment, point.methods, build_component):
                found.setdefault(text, []).append(point.title)
    n_points = len(config.points[:MAX_POINTS])
    return [
        *map(str, config.warnings),
        *(
            text + (f" (at {', '.join(titles[:2])}{' ..' * (len(titles) > 2)})" if n_points > 1 else "")
            for text, titles in found.items()
        ),
    ]
