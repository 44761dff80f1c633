"""Labels of the methods in figures and tables: templates, or made of what differs between the methods.

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from rmpc_bench.config.draft import DraftConfig, MethodComponents
from rmpc_bench.config_file.component import Component, plain_data
from rmpc_bench.config_file.tree import Mark, locate
from rmpc_bench.received.names import wrong_label
from rmpc_bench.registry import unknown

MAX_ADDED = 2
"""Parameters that a label without template repeats at most."""
DIGITS = 6
_PARAMETER = re.compile(r"\$\{([A-Za-z_]\w*(?:\.\w+)*)\}")
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_GREEK = {"theta": r"\theta", "lam": r"\lambda", "gamma": r"\gamma", "rho": r"\rho", "eps": r"\varepsilon"}


class Parameter(NamedTuple):
    """A parameter of a method."""

    value: Any
    is_default: bool


_Kinds = frozenset[tuple[str, str]]
"""Path and kind of every component of a method."""


class LabelError(ValueError):
    """A template that cannot be filled in."""


def labels_of(drafts: Sequence[DraftConfig], inherited: Callable[[Mark], bool] | None = None) -> dict[str, str]:
    """Return the label of every method at all points; an error in a template is a problem of the first draft.

    A template at an inherited place is dropped where it cannot be filled in.
    """
    first = drafts[0]
    labels = {}
    points = {name: [_parameters(draft.methods[name]) for draft in drafts if name in draft.methods]
              for name in first.methods}  # fmt: skip
    varied = _varied([each[0] for each in points.values()])
    for name, components in first.methods.items():
        labels[name] = name
        try:
            if components.label is None:
                labels[name] = _derived(name, points[name], varied)
            elif _is_valid(components):
                labels[name] = fill(components.label, name, points[name])
        except LabelError as error:
            path: list[str | int] = ["methods", name, "label"]
            if inherited is None or not inherited(locate(first.tree, path)):
                first.note(path, str(error))
                continue
            components.label = None
            labels[name] = _derived(name, points[name], varied)
            first.left_out.append(f"label of {name}: {error}")
    return labels


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

    Examples
    --------
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


def _is_valid(components: MethodComponents) -> bool:
    given = [components.model, components.estimator] + [components.controller] * components.controlled
    return all(component is not None for component in given)


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
    named = {"model": components.model, "estimator": components.estimator, "controller": components.controller}
    return {
        f"{role}.{path}": parameter
        for role, component in named.items() if component is not None
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
