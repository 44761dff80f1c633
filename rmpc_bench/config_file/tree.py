"""Trees of YAML data with the position of every key and value: finding, setting, merging, and the kind of a component.

A component whose kind is written in a short form (``file: tanks.py:MHE``, ``ode: tanks.py:rhs``, ``linearise: plant``)
gets the key `kind` before it is merged with a default, so that another form replaces the default as a whole.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, ParamSpec, TypeVar

from rmpc_bench.types import ConfigError, Problem

MAX_DEPTH = 50
MAX_DIGITS = 1000
OPTIONS = ("-s ", "--add-method ")  # starts of the file name in the place of a value that was given on the command line
_CONSTANTS: dict[str, bool | None] = dict.fromkeys(("", "~", "null", "Null", "NULL"))
_CONSTANTS |= dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_STEP = re.compile(r'(?:"([^"]*)"|([^."][^.]*))(?:\.(?!$)|$)')


P = ParamSpec("P")
T = TypeVar("T")


class Problems(list[Problem]):
    """The errors found so far, where those of several values are to be shown at once."""

    def tried(self, call: Callable[P, T], *given: P.args, **named: P.kwargs) -> T | None:
        """Call a function; None where it raises a ConfigError, whose problems are added to these."""
        try:
            return call(*given, **named)
        except ConfigError as error:
            self.extend(error.found)
            return None

    def stop(self) -> None:
        """Raise all of them, if there are any."""
        if self:
            raise ConfigError(self)


class Deletion:
    """The value ``!delete`` of a key, which removes an inherited key; there is one, `DELETE`."""

    def __repr__(self) -> str:
        return "!delete"


DELETE = Deletion()


class Mark(NamedTuple):
    """A place in a file; line and column count from 1."""

    file: str
    line: int
    column: int

    def directory(self, config: Path) -> Path:
        """Return the directory that a file name at this place is relative to; for the command line that of `config`."""
        return (config if self.file.startswith(OPTIONS) else Path(self.file)).parent


class Map(dict[str, Any]):
    """A mapping with the places of itself, its keys and its values."""

    def __init__(
        self,
        values: Mapping[str, Any] | Iterable[tuple[str, Any]] = (),
        *,
        mark: Mark,
        key_marks: Mapping[str, Mark] | None = None,
        value_marks: Mapping[str, Mark] | None = None,
    ) -> None:
        super().__init__(values)
        self.mark = mark
        self.key_marks = dict(key_marks or {})
        self.value_marks = dict(value_marks or {})

    def like(self, values: Mapping[str, Any]) -> Map:
        """Return other values with the places of these."""
        return Map(values, mark=self.mark, key_marks=self.key_marks, value_marks=self.value_marks)

    def copy(self) -> Map:
        """Copy without copying the values."""
        return self.like(self)

    __copy__ = copy

    def places(self, key: str) -> tuple[Mark, Mark]:
        """Places of a key and of its value, by default that of the mapping."""
        return self.key_marks.get(key, self.mark), self.value_marks.get(key, self.mark)

    def take(self, source: Map, key: str) -> None:
        """Set a value of another mapping together with its places."""
        self.put(key, source[key], *source.places(key))

    def put(self, key: str, value: Any, key_mark: Mark, value_mark: Mark) -> None:
        """Set a value together with its places."""
        self[key], self.key_marks[key], self.value_marks[key] = value, key_mark, value_mark


class Items(list[Any]):
    """A sequence with the places of itself and its values."""

    def __init__(self, values: Iterable[Any] = (), *, mark: Mark, value_marks: Iterable[Mark] = ()) -> None:
        super().__init__(values)
        self.mark = mark
        self.value_marks = list(value_marks)

    def like(self, values: Iterable[Any]) -> Items:
        """Return other values with the places of these."""
        return Items(values, mark=self.mark, value_marks=self.value_marks)

    def copy(self) -> Items:
        """Copy without copying the values."""
        return self.like(self)

    __copy__ = copy


def scalar(text: str) -> Any:
    """Read an unquoted scalar by the YAML 1.2 core schema, else as text; ValueError above MAX_DIGITS digits."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _INT.fullmatch(text):
        if len(text) > MAX_DIGITS:
            raise ValueError(f"an integer has at most {MAX_DIGITS} digits")
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
    if _FLOAT.fullmatch(text):
        return float(text)
    return float(text.replace(".", "")) if _SPECIAL.fullmatch(text) else text


def join(path: Sequence[str | int]) -> str:
    """Write a path with dots, in the form that ``split`` reads."""
    return ".".join(f'"{step}"' if "." in str(step) else str(step) for step in path)


def _fail(mark: Mark, path: Sequence[str | int], message: str) -> NoReturn:
    raise ConfigError([Problem(*mark, join(path), message)])


def split(path: str, mark: Mark) -> list[str]:
    """Return the steps of a dotted path, one that contains a dot in double quotes; a ConfigError if it is no path."""
    steps, end = [], 0
    while (step := _STEP.match(path, end)) and end < len(path):
        steps.append(step[1] if step[2] is None else step[2])
        end = step.end()
    if end < len(path) or not steps or len(steps) > MAX_DEPTH:
        _fail(mark, [], f'{path!r} is not a path such as plant.kind or methods."v1.2".label')
    return steps


def plain(value: Any) -> Any:
    """Copy into ordinary dicts and lists, deep."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list) else value


def merge(base: Map, override: Map) -> Map:
    """Lay one mapping over another, deep; neither is changed.

    A mapping of another ``kind`` replaces the base whole.  Every value keeps its place; a merged mapping has the
    place of the override.
    """
    if "kind" in base and "kind" in override and not same_kind(base, override):
        return override.copy()
    result = base.copy()
    result.mark = override.mark
    for key, value in override.items():
        if isinstance(value, Map) and isinstance(base.get(key), Map):
            value = merge(base[key], value)
        result.put(key, value, *override.places(key))
    return result


def same_kind(base: Map, override: Map) -> bool:
    """Whether two mappings have the same `kind`; a name in a Python file is relative to the file it stands in."""
    if base["kind"] != override["kind"] or ".py:" not in str(base["kind"]):
        return bool(base["kind"] == override["kind"])
    one, other = (Path(locate(each, ["kind"]).file).parent for each in (base, override))
    return one == other


def _child(node: Any, step: str | int) -> tuple[Any, Mark, Mark]:
    """Value, place of the key, place of the value; KeyError when there is no such child."""
    if isinstance(node, Map):
        key = str(step)
        return node[key], *node.places(key)
    if isinstance(node, Items) and re.fullmatch("[0-9]{1,9}", str(step)) and int(step) < len(node):
        mark = node.value_marks[int(step)] if int(step) < len(node.value_marks) else node.mark
        return node[int(step)], mark, mark
    raise KeyError(step)


def _follow(tree: Map | Items, path: Sequence[str | int]) -> tuple[Mark, Mark]:
    key_mark = value_mark = tree.mark
    node: Any = tree
    for step in path:
        try:
            node, key_mark, value_mark = _child(node, step)
        except KeyError:
            return value_mark, value_mark
    return key_mark, value_mark


def locate(tree: Map | Items, path: Sequence[str | int]) -> Mark:
    """Return the place of the value at a path, or of the deepest existing value on the way."""
    return _follow(tree, path)[1]


def locate_key(tree: Map | Items, path: Sequence[str | int]) -> Mark:
    """Return the place of the last key of a path, or of the deepest existing value on the way."""
    return _follow(tree, path)[0]


def problem_at(tree: Map | Items, path: Sequence[str | int], message: str, *, key: bool = False) -> Problem:
    """Return a problem at the value (or the key) of a path."""
    return Problem(*(locate_key if key else locate)(tree, path), join(path), message)


def error_at(tree: Map | Items, path: Sequence[str | int], message: str, *, key: bool = False) -> ConfigError:
    """Return an error at the value (or the key) of a path."""
    return ConfigError([problem_at(tree, path, message, key=key)])


def assign(tree: Map, path: str, value: Any, mark: Mark, key_mark: Mark | None = None) -> Map:
    """Return a tree with another value at a dotted path; it shares the unchanged values with the given one.

    The given tree is not changed.  Missing mappings are created, and a step into a list is an existing index.
    `key_mark` is the place of the key and of new mappings, by default that of the value.  Raises a ConfigError for a
    path through a value that is neither a mapping nor a list, or an index that does not exist.
    """
    result: Map = _assigned(tree, split(path, mark), 0, value, (key_mark or mark, mark))
    return result


def _assigned(node: Any, steps: list[str], done: int, value: Any, marks: tuple[Mark, Mark]) -> Any:
    if done == len(steps):
        return value
    step, last, mark = steps[done], done + 1 == len(steps), marks[0]
    if not isinstance(node, Map | Items):
        way_out = "can be set only if this is a mapping or a list: replace it first"
        _fail(mark, steps[:done], f"is {node!r}; {join(steps)} {way_out}")
    try:
        child, key_mark, value_mark = _child(node, step)
    except KeyError:
        if isinstance(node, Items):
            _fail(mark, steps[: done + 1], f"no such entry in a list of {len(node)} (they count from 0)")
        child, key_mark, value_mark = Map(mark=mark), mark, mark
    new, child = node.copy(), _assigned(child, steps, done + 1, value, marks)
    if isinstance(new, Map):
        new.put(step, child, *(marks if last else (key_mark, value_mark)))
    else:
        new[int(step)] = child
        if last:
            new.value_marks[int(step)] = marks[1]
    return new


FILE = "file"  # key that stands for `kind` in a component from a Python file

SHORT_FORMS: Mapping[str, tuple[str, ...]] = {
    "plants": ("ode", "casadi", "data", "env", "control", "scipy", "fmu"),
    "models": ("linearise", "nonlinear", "ode", "control", "scipy"),
}  # group -> kinds that may stand as a key; their keys of the same name are keys of these kinds


def with_kind(group: str, tree: Any) -> Any:
    """Return a component with its kind under `kind`; a tree of which no single kind is given is returned as it is."""
    if not isinstance(tree, Map) or "kind" in tree:
        return tree
    forms = given_forms(group, tree)
    if len(forms) != 1:
        return tree
    form, result = forms[0], tree.copy()
    if form == FILE and not (group == "inputs" and names_data(tree[FILE])):
        result.put("kind", result.pop(FILE), *tree.places(FILE))
    else:
        result.put("kind", form, tree.places(form)[0], tree.places(form)[0])
    return result


def names_data(text: Any) -> bool:
    """Whether a text names files of data and not of code.

    >>> names_data("u.csv"), names_data("signals.py:Chirp")
    (True, False)
    """
    return isinstance(text, str) and ".py" not in text


def kind_of(data: Mapping[str, Any]) -> str:
    """Return the kind, or the file and name, of a component as plain data.

    >>> kind_of({"file": "tanks.py:MHE", "Ne": 6})
    'tanks.py:MHE'
    """
    return str(data[FILE] if FILE in data and "kind" not in data else data["kind"])


def given_forms(group: str, tree: Map) -> list[str]:
    """Return the short forms that stand in a component."""
    return [form for form in (FILE, *SHORT_FORMS.get(group, ())) if form in tree]
