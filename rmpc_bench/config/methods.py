"""The key `methods`: the components of every method, the defaults of all methods merged in, and its label.

A label such as ``R-MPC1, $c=${c}$`` may contain ``${path}``, the value of a parameter of the model, the estimator or
the controller of the method, defaults and overrides included.  The path is complete (``estimator.c``) or its end
(``c``), if only one parameter has that end.  Every other dollar sign belongs to a formula.

A method without a label has its name.  If other methods have components of the same kinds, its scalar parameters that
differ from theirs are added, except for those at their default and those whose value is part of the name.  The name
stands alone if more than two parameters would have to be added, or one that is a list or a mapping.
"""

from __future__ import annotations

import dataclasses
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from rmpc_bench.config.draft import DraftConfig, MethodComponents
from rmpc_bench.config.search import read_components, with_search
from rmpc_bench.config.sweep import METHOD_COMPONENTS
from rmpc_bench.config_file.component import Component, plain_data
from rmpc_bench.config_file.keys import shown
from rmpc_bench.config_file.method_grid import MAX_METHODS
from rmpc_bench.config_file.tree import Map, locate_key, plain
from rmpc_bench.config_file.yaml import dump, one_line
from rmpc_bench.received.names import wrong_label, wrong_method
from rmpc_bench.registry import unknown
from rmpc_bench.types import Count
from rmpc_bench.types.tuning import AS_PUBLISHED, DEFAULT, TuningProtocol

METHOD_KEYS = (*METHOD_COMPONENTS, "label", "tune", "parameters")


@dataclass(frozen=True)
class TunedKeys:
    """How the values of a method were tuned in another configuration.

    Parameters
    ----------
    budget : number of values that were tried
    runs : number of runs for each value
    """

    budget: Count
    runs: Count


Source: Any = Literal[AS_PUBLISHED, DEFAULT] | TunedKeys  # what the key `parameters` of a method may say


def read_methods(draft: DraftConfig) -> dict[str, MethodComponents]:
    """Read all methods of one point, whose design model is read; those that are no mapping are left out."""
    methods = draft.keys.methods
    if methods is not None and not methods:
        draft.note(["methods"], "there must be at least one method")
    if len(methods or {}) > MAX_METHODS:
        draft.note(["methods"], f"there must be at most {MAX_METHODS:,} methods (got {len(methods or {}):,})")
        return {}
    found = {}
    for name, own in (methods or {}).items():
        path: list[str | int] = ["methods", name]
        if wrong_method(name):
            draft.note(path, wrong_method(name), key=True)
        if own is None:
            own = Map(mark=locate_key(draft.tree, path))
        if isinstance(own, Map):
            found[name] = _method(draft, name, own)
        else:
            draft.note(path, f"must be a mapping (got {shown(own)})")
    return found


def _method(draft: DraftConfig, name: str, own: Map) -> MethodComponents:
    path: list[str | int] = ["methods", name]
    for key in own:
        if key not in METHOD_KEYS:
            draft.note([*path, key], unknown(key, METHOD_KEYS, "key"), key=True)
    label = own.get("label")
    if "label" in own and not isinstance(label, str):
        draft.note([*path, "label"], f"must be text (got {shown(label)})")
    elif "label" in own and (wrong := wrong_label(label)):
        draft.note([*path, "label"], wrong)
    found = read_components(draft, name, own)
    if own.get("tune") is not None:
        found = with_search(draft, name, own, found)
    if "parameters" not in own:
        return found
    source = draft.checked(Source, [*path, "parameters"]) or DEFAULT
    words = TuningProtocol(source.budget, source.runs, "").words if isinstance(source, TunedKeys) else source
    return replace(found, source=words)


def method_differences(methods: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return, per method, the keys whose values differ between the methods, and its values of them.

    Keys have dots, such as ``estimator.c``, and the given ones have every default.  A key that a method does not have
    is absent.
    """
    flat = {
        name: {key: leaf for key, leaf in _differing_leaves(parts) if key != "label"} for name, parts in methods.items()
    }
    keys = dict.fromkeys(key for leaves in flat.values() for key in leaves)
    differing = [key for key in keys if len({repr(leaves.get(key)) for leaves in flat.values()}) > 1]
    return {name: {key: leaves[key] for key in differing if key in leaves} for name, leaves in flat.items()}


def _differing_leaves(tree: Any, path: str = "") -> list[tuple[str, Any]]:
    if not isinstance(tree, dict):
        return [(path, tree)]
    return [leaf for key, value in tree.items() for leaf in _differing_leaves(value, f"{path}.{key}" if path else key)]


def short_value(value: Any) -> str:
    """Write a value of a configuration on one line.

    >>> short_value([{"B_d": [[1.0], [0.0]]}, "input"])
    '[{B_d: [[1.0], [0.0]]}, input]'
    """
    if isinstance(value, str):
        return value
    if isinstance(value, list) and value and all(isinstance(entry, int | float) for entry in value):
        return f"[{', '.join(f'{entry:g}' for entry in value)}]"
    if isinstance(value, float):
        return f"{value:g}"
    # A mapping without the outer braces.
    return one_line(plain(value)) if isinstance(value, list) else " ".join(dump(plain(value)).split())


MAX_ADDED = 2  # parameters that a label without template repeats at most
DIGITS = 6
_PARAMETER = re.compile(r"\$\{([A-Za-z_]\w*(?:\.\w+)*)\}")
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_GREEK = {"theta": r"\theta", "lam": r"\lambda", "gamma": r"\gamma", "rho": r"\rho", "eps": r"\varepsilon"}


class Parameter(NamedTuple):
    """A parameter of a method."""

    value: Any
    is_default: bool


_Kinds = frozenset[tuple[str, str]]  # path and kind of every component of a method


class LabelError(ValueError):
    """A template that cannot be filled in."""


def with_labels(drafts: Sequence[DraftConfig]) -> tuple[DraftConfig, dict[str, str]]:
    """Return the first draft without inherited templates of labels that are wrong, and the labels at all points."""
    first = drafts[0]
    labels, methods = {}, {**first.methods}
    points = {name: [_parameters(draft.methods[name]) for draft in drafts if name in draft.methods]
              for name in first.methods}  # fmt: skip
    varied = _varied([each[0] for each in points.values()])
    for name, components in first.methods.items():
        labels[name] = name
        try:
            if components.label is None:
                labels[name] = _derived(name, points[name], varied)
            elif components.is_valid:
                labels[name] = fill(components.label, name, points[name])
        except LabelError as error:
            path: list[str | int] = ["methods", name, "label"]
            if not first.is_inherited(path):
                first.note(path, str(error))
                continue
            methods[name] = replace(components, label=None)
            labels[name] = _derived(name, points[name], varied)
            first.left_out.append(f"label of {name}: {error}")
    return replace(first, methods=methods), labels


def fill(template: str, method: str, points: Sequence[Mapping[str, Parameter]]) -> str:
    """Return a template with the values of the method, which its parameters have at every point; else LabelError."""

    def value(found: re.Match[str]) -> str:
        before = _PARAMETER.sub("", template[: found.start()]).replace(r"\$", "")
        try:
            path = _complete(found[1], points[0], method)
            if any(point.get(path) != points[0][path] for point in points):
                raise LabelError(f"{path!r} changes with the sweep; figures and tables name the point, so leave it out")
        except LabelError as error:
            raise LabelError(f"column {found.start() + 1} of {template!r}: {error}") from None
        return written(points[0][path].value, math=before.count("$") % 2 == 1)

    opened = re.search(r"\$\{[^}]*$", template)
    if opened is not None:
        raise LabelError(f"column {opened.start() + 1} of {template!r}: '${{' is not closed")
    if reason := wrong_label(filled := _PARAMETER.sub(value, template)):
        raise LabelError(f"{template!r}, filled in, {reason}")
    return filled


def written(value: Any, *, math: bool) -> str:
    r"""Write plain data as papers do: powers of ten below 1, plain decimals, else a mantissa and a power.

    >>> [written(value, math=True) for value in (0.1, 1.0, 0.03, 1.5e-4)]
    ['10^{-1}', '1', '0.03', '1.5 \\cdot 10^{-4}']
    >>> [written(value, math=False) for value in (0.1, 1e-3, [0.5, 4])]
    ['0.1', '$10^{-3}$', '[0.5, 4]']
    """
    if isinstance(value, list):
        return f"[{', '.join(written(each, math=math) for each in value)}]"
    if isinstance(value, bool) or value is None:
        return "none" if value is None else str(value).lower()
    if not isinstance(value, int | float):
        return str(value)
    mantissa, exponent = f"{value:.{DIGITS - 1}e}".split("e")
    mantissa, power = mantissa.rstrip("0").rstrip("."), int(exponent)
    is_power = mantissa == "1" and power < 0
    if value == 0 or (-3 < power < DIGITS and not (is_power and math)):
        return f"{value:.{DIGITS}g}"
    text = f"10^{{{power}}}" if mantissa == "1" else rf"{mantissa} \cdot 10^{{{power}}}"
    return text if math else f"${text}$"


def _complete(path: str, known: Mapping[str, Parameter], method: str) -> str:
    """Return the complete path of a parameter."""
    ends = [each for each in known if each == path or each.endswith(f".{path}")]
    if len(ends) > 1 and path not in ends:
        raise LabelError(f"{path!r} is ambiguous; write {' or '.join(f'${{{each}}}' for each in ends)}")
    if not ends:
        short = {each.rpartition(".")[2] for each in known if not each.endswith("kind")}
        names = known if "." in path else sorted(short)
        raise LabelError(unknown(path, names, f"parameter of {method}"))
    return path if path in ends else ends[0]


def _varied(methods: Sequence[Mapping[str, Parameter]]) -> dict[_Kinds, dict[str, bool]]:
    """Return the paths whose values differ between methods of the same kinds, each with whether one is a list."""
    groups = defaultdict[_Kinds, list[Mapping[str, Parameter]]](list)
    for method in methods:
        groups[_kinds(method)].append(method)
    varied = defaultdict[_Kinds, dict[str, bool]](dict)
    for kinds, group in groups.items():
        for path in dict.fromkeys(path for each in group for path in each):
            values = [each[path].value if path in each else None for each in group]
            if any(value != values[0] for value in values[1:]):
                varied[kinds][path] = any(isinstance(value, list) for value in values)
    return varied


def _derived(name: str, points: Sequence[Mapping[str, Parameter]], varied: Mapping[_Kinds, dict[str, bool]]) -> str:
    """Make the label of a method without a template, from its parameters at every point."""
    own = points[0]
    is_list = varied[_kinds(own)]
    differing = [path for path in own if path in is_list and not own[path].is_default]
    if any(point.get(path) != own[path] for path in differing for point in points):
        return name
    values = {path: own[path].value for path in differing if not _is_in_name(path, own[path].value, name)}
    if any(is_list[path] for path in values) or len(values) > MAX_ADDED:
        return name
    return ", ".join([name, *(_equation(path.rpartition(".")[2], value) for path, value in values.items())])


def _is_in_name(path: str, value: Any, name: str) -> bool:
    """Whether the name of a method contains the value of a parameter, or the key of one that is true."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) in {float(text) for text in _NUMBER.findall(name)}
    word = path.rpartition(".")[2] if value is True else str(value)
    return word in re.split(r"[^A-Za-z0-9]+", name)


def _equation(key: str, value: Any) -> str:
    """Write a parameter and its value: a formula for a number of one letter, such as ``$c=10^{-1}$``."""
    letter = _GREEK.get(key, key if len(key) == 1 else "")
    if letter and isinstance(value, int | float) and not isinstance(value, bool):
        return f"${letter}={written(value, math=True)}$"
    return key if value is True else f"{key} = {written(value, math=False)}"


def _kinds(parameters: Mapping[str, Parameter]) -> _Kinds:
    return frozenset((path, str(value)) for path, (value, _) in parameters.items() if path.endswith(".kind"))


def _parameters(components: MethodComponents) -> dict[str, Parameter]:
    """Return the parameters of the components of a method by their path, such as ``estimator.theta_from.c``."""
    return {
        f"{role}.{path}": parameter
        for role, component in components.named.items() if component is not None
        for path, parameter in _leaves(component)
    }  # fmt: skip


def _leaves(component: Component) -> Iterator[tuple[str, Parameter]]:
    yield "kind", Parameter(component.kind, False)
    fields = component.keys.model_fields
    for name, value in component.parameters.items():
        field = fields[name]
        yield from _flat(name.rstrip("_"), value, value == field.default and not field.is_required())


def _flat(path: str, value: Any, is_default: bool) -> Iterator[tuple[str, Parameter]]:
    """Yield a parameter, or those inside a dataclass or a mapping."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and not callable(value):
        for field in dataclasses.fields(value):
            inner = getattr(value, field.name)
            yield from _flat(f"{path}.{field.name.rstrip('_')}", inner, is_default or inner == field.default)
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(f"{path}.{key}", inner, is_default)
    else:
        yield path, Parameter(plain_data(value), is_default)
