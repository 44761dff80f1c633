"""YAML 1.2 (core schema): text to trees with the position of every key and value, and plain data to text.

PyYAML only scans the text and delivers events.  The tree (tree.py) is built here without tags and to a limited depth
and size, so that a text cannot construct objects, exhaust memory through aliases or overflow the stack.  The only tag
is `!delete`, the value of a key that a file with `extends` does not inherit.  `yaml.compose` would lose the places of
aliases, refuse a name that two anchors have, and show an error of syntax without the other errors before it.
"""

from __future__ import annotations

import json
import re
from bisect import bisect_right
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml  # type: ignore[import-untyped]

from rmpc_bench.config_file.tree import DELETE, MAX_DEPTH, Items, Map, Mark, Problems, join, scalar, split
from rmpc_bench.received.names import wrong_formula
from rmpc_bench.received.plain_files import content_of
from rmpc_bench.types import ConfigError, Problem
from rmpc_bench.types.texts import refused_in_name, refused_in_text

MAX_NODES = 100_000
MAX_BYTES = 3_000_000
_CORE = "tag:yaml.org,2002:"
_DELETE = "!delete"
_BEHIND_DELETE = "\0 \t\r\n\x85\u2028\u2029,}]"
EXTENDS = "extends"  # key of the file that a configuration extends


def parse(text: str, file: str, *, column: int = 1, may_extend: bool = False) -> Any:
    """Read a text that holds one document; the value of an alias is shared, not copied.

    Places in it begin at `column` of `file`; a text that `may_extend` is a configuration, which may extend another one.
    """
    return _TreeBuilder(text.removeprefix("\ufeff"), file, column, may_extend).build()


def load(path: str | Path) -> Any:
    """Read a file; a ConfigError, which shows the path as given, says why it is not valid YAML."""
    where = Path(path)
    try:
        return parse(content_of(where, MAX_BYTES).decode("utf-8-sig"), str(path), may_extend=True)
    except ConfigError:
        raise
    except FileNotFoundError:
        siblings = sorted(other.name for other in where.parent.glob("*.yaml"))
        near = get_close_matches(where.name, siblings, n=1, cutoff=0.0)
        hint = f"; did you mean '{where.with_name(near[0])}'?" if near else ""
        message = "there is no such file" + hint
    except IsADirectoryError:
        message = "is a directory, not a YAML file"
    except UnicodeDecodeError as error:
        message = f"is not UTF-8 text (byte 0x{error.object[error.start]:02x} at offset {error.start})"
    except (OSError, ValueError) as error:
        message = f"cannot be read: {getattr(error, 'strerror', None) or error}"
    raise ConfigError([Problem(str(path), 1, 1, "", message)])


class Override(NamedTuple):
    """A value that replaces the one of the file."""

    path: str  # steps with dots between them, for ``assign``
    value: Any
    mark: Mark  # place of the value; columns count within the text of the override


def parse_override(text: str) -> Override:
    """Read the PATH=VALUE of ``-s``: the first ``=`` ends PATH, and VALUE is a YAML document (empty: null)."""
    path, equals, value = text.partition("=")
    file = f"-s {text}"
    if not equals:
        raise ConfigError([Problem(file, 1, 1, "", "expected PATH=VALUE; there is no '='")])
    split(path.strip(), Mark(file, 1, 1))
    column = len(path) + 2
    parsed = parse(value, file, column=column) if value.strip() else None
    return Override(path.strip(), parsed, Mark(file, 1, column))


_Role = Literal["root", "key", "value", "entry"]
"""What stands at a place: the document, a key, the value of a key, an entry of a list."""


@dataclass(slots=True)
class _Node:
    """A scalar, with its text, or a collection; size and height include the values of aliases."""

    value: Any
    text: str | None = None
    size: int = 1
    height: int = 0
    open: bool = False


class _Stop(Exception):
    """An error that ends the parsing: index in the text, message."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """PyYAML's scanner, which takes the comma behind a tag for a part of it, except behind ``!delete``."""

    def scan_tag(self) -> Any:
        """Return the token of a tag."""
        if self.prefix(len(_DELETE)) != _DELETE or self.peek(len(_DELETE)) not in _BEHIND_DELETE:
            return super().scan_tag()
        start = self.get_mark()
        self.forward(len(_DELETE))
        return yaml.TagToken(("!", _DELETE[1:]), start, self.get_mark())


class _TreeBuilder:
    """Builds the tree from events, by recursion that MAX_DEPTH limits, and collects problems."""

    def __init__(self, text: str, file: str, column: int, may_extend: bool) -> None:
        self.file, self.column, self.may_extend = file, column, may_extend
        self.starts = [0, *(end.end() for end in re.finditer(r"\r\n|\r|\n", text))]
        self.events = self._events(text)
        self.problems = Problems()
        self.deletions: list[Problem] = []  # errors for every `!delete`, in a file that extends no other
        self.anchors: dict[str, _Node] = {}
        self.steps: list[str | None] = []
        """Path of the value that is read; None in place of a key that is read or dropped."""
        self.total = 0

    def build(self) -> Any:
        """Return the value of the only document, or raise all problems."""
        root: _Node | None = None
        try:
            for event in self.events:
                if isinstance(event, yaml.DocumentStartEvent):
                    if root is not None:
                        raise _Stop(event.start_mark.index, "a second document starts here; a file holds one")
                    root, _ = self._node(next(self.events), "root")
            if root is None:
                raise _Stop(0, "the file is empty")
        except _Stop as stop:
            index, message = stop.args
            self.problems.append(Problem(*self._mark(index), "", message))
        value = None if root is None else root.value
        if not (self.may_extend and isinstance(value, Map) and EXTENDS in value):
            self.problems += self.deletions
        self.problems.stop()
        return value

    def _events(self, text: str) -> Iterator[Any]:
        loader: Any = None
        try:
            loader = _Loader(text)
            while loader.check_event():
                yield loader.get_event()
        except yaml.reader.ReaderError as error:
            raise _Stop(error.position, f"control character U+{error.character:04X} is not allowed") from None
        except yaml.MarkedYAMLError as error:
            place = error.problem_mark or error.context_mark
            line = f" that starts on line {self._mark(error.context_mark.index).line}" if error.context_mark else ""
            context = f"{error.context}{line}: " if error.context else ""
            raise _Stop(place.index, f"{context}{error.problem}") from None
        except (ValueError, OverflowError) as error:
            # PyYAML converts escapes and versions to numbers without checks.
            raise _Stop(loader.index, f"not a valid escape or number ({error})") from None

    def _node(self, event: Any, role: _Role) -> tuple[_Node, Mark]:
        """Return what begins with an event, and its place."""
        index = event.start_mark.index
        mark = self._mark(index)
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event.anchor, mark, index), mark
        before = self.total
        self._count(1, index)
        if isinstance(event, yaml.ScalarEvent):
            if role == "root" and not event.value and event.end_mark.index == index:
                raise _Stop(0, "the file is empty")
            node = _Node(self._scalar(event, mark, role), event.value)
            if event.anchor is not None:
                self.anchors[event.anchor] = node
            return node, mark
        is_map = isinstance(event, yaml.MappingStartEvent)
        if event.tag not in (None, _CORE + ("map" if is_map else "seq")):
            self._tag_problem(event.tag, mark)
        if len(self.steps) >= MAX_DEPTH:
            raise _Stop(index, f"nested deeper than {MAX_DEPTH} levels")
        node = _Node(Map(mark=mark) if is_map else Items(mark=mark), height=1, open=True)
        if event.anchor is not None:
            self.anchors[event.anchor] = node
        self.steps.append(None)
        (self._read_map if is_map else self._read_items)(node)
        self.steps.pop()
        node.open, node.size = False, self.total - before
        return node, mark

    def _read_map(self, node: _Node) -> None:
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            self.steps[-1] = None
            key_node, key_mark = self._node(event, "key")
            key = self.steps[-1] = self._key(node.value, key_node, key_mark)
            item, mark = self._node(next(self.events), "value")
            node.height = max(node.height, key_node.height + 1, item.height + 1)
            if key is not None:
                node.value.put(key, item.value, key_mark, mark)

    def _read_items(self, node: _Node) -> None:
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            self.steps[-1] = str(len(node.value))
            item, mark = self._node(event, "entry")
            node.height = max(node.height, item.height + 1)
            node.value.append(item.value)
            node.value.value_marks.append(mark)

    def _key(self, parent: Map, node: _Node, mark: Mark) -> str | None:
        """Text of a key, or None when its value will have to be dropped."""
        if node.text is None:
            self._problem(mark, "a key must be a scalar, not a list or a mapping")
        elif node.text in parent:
            first, self.steps[-1] = parent.key_marks[node.text], node.text
            self._problem(mark, f"the key is given twice; first on line {first.line}, column {first.column}")
        else:
            return node.text
        return None

    def _scalar(self, event: Any, mark: Mark, role: _Role) -> Any:
        text = event.value
        if event.tag == _DELETE:
            return self._deletion(text, mark, role)
        if not text.isascii() and re.search("[\ud800-\udfff]", text):
            self._problem(mark, "half of a surrogate pair is not a character; write \\U and eight digits")
        elif refused := (refused_in_name if role == "key" else refused_in_text)(text) or wrong_formula(text):
            self._problem(mark, refused)
        try:
            if event.tag is None:
                return scalar(text) if event.implicit[0] else text
            kind = event.tag.removeprefix(_CORE)
            if kind == event.tag or kind not in ("str", "int", "float", "bool", "null"):
                self._tag_problem(event.tag, mark)
                return None
            value = text if kind == "str" else scalar(text)
            if kind == "float" and type(value) is int:
                return float(value)
            if ("null" if value is None else type(value).__name__) == kind:
                return value
            self._problem(mark, f"{text!r} is not of type !!{kind}")
        except (ValueError, OverflowError) as error:
            self._problem(mark, str(error))
        return None

    def _deletion(self, text: str, mark: Mark, role: _Role) -> Any:
        """Return the value `!delete` of a key."""
        if text or role != "value":
            self._problem(mark, "!delete stands alone, as the value of a key that is not inherited")
            return None
        message = f"tags are not allowed (!delete, which removes an inherited key, needs `{EXTENDS}: FILE`)"
        self.deletions.append(Problem(*mark, self._path(), message))
        return DELETE

    def _alias(self, name: str, mark: Mark, index: int) -> _Node:
        node = self.anchors.get(name)
        if node is None or node.open:
            trouble = "has no anchor before it" if node is None else "refers to a collection that it stands in"
            self._problem(mark, f"alias *{name} {trouble}")
            return _Node(None, "")
        self._count(node.size, index)
        if len(self.steps) + node.height > MAX_DEPTH:
            raise _Stop(index, f"alias *{name}: nested deeper than {MAX_DEPTH} levels")
        return node

    def _count(self, nodes: int, index: int) -> None:
        self.total += nodes
        if self.total > MAX_NODES:
            raise _Stop(index, f"more than {MAX_NODES} values (those of an alias count every time)")

    def _tag_problem(self, tag: str, mark: Mark) -> None:
        short = "!!" + tag.removeprefix(_CORE) if tag.startswith(_CORE) else tag
        self._problem(mark, f"tags are not allowed ({short})")

    def _problem(self, mark: Mark, message: str) -> None:
        self.problems.append(Problem(*mark, self._path(), message))

    def _path(self) -> str:
        return join([step for step in self.steps if step is not None])

    def _mark(self, index: int) -> Mark:
        line = bisect_right(self.starts, index)
        return Mark(self.file, line, index - self.starts[line - 1] + (self.column if line == 1 else 1))


_WIDTH = 100
_LONGEST_KEY = 1000
_PLAIN = re.compile(r"[\w/$(^+][\w./$()^*+<>=~@;-]*( [\w./$()^*+<>=~@;-]+)*")
_UNPRINTABLE = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")
_STOCK = yaml.resolver.Resolver()


def dump(value: Any) -> str:
    """Write plain data as a YAML 1.2 text that ``parse`` reads back to the same data.

    Raises a TypeError if YAML has no form for a value, and a ValueError if ``parse`` would refuse the text.
    """
    _check(value, 0)
    return "\n".join(_block(value, _WIDTH, root=True)) + "\n"


def one_line(value: Any) -> str:
    """Write plain data as a YAML 1.2 text on one line that ``parse`` reads back to the same data.

    >>> one_line({"R-MPC": {"estimator": {"kind": "robust-kalman", "c": 0.03}}})
    '{R-MPC: {estimator: {kind: robust-kalman, c: 0.03}}}'
    """
    _check(value, 0)
    return _flow(value)


def _inside(value: Any) -> Collection[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list | tuple) else ()


def _check(value: Any, depth: int) -> None:
    if depth > MAX_DEPTH or (depth == MAX_DEPTH and isinstance(value, dict | list | tuple)):
        raise ValueError(f"nested deeper than {MAX_DEPTH} levels")
    if isinstance(value, dict) and (odd := [key for key in value if not isinstance(key, str)]):
        raise TypeError(f"a key must be text, not {odd[0]!r}")
    for item in _inside(value):
        _check(item, depth + 1)


def _height(value: Any) -> int:
    return 1 + max(map(_height, _inside(value)), default=0) if isinstance(value, dict | list | tuple) else 0


def _line(value: Any, width: int, root: bool = False) -> str | None:
    """Return a value on one line, or None where that is hard to read."""
    if _height(value) > 2 or (root and value and isinstance(value, dict)):
        return None
    line = _flow(value)
    return line if len(line) <= width or not _inside(value) else None


def _block(value: Any, width: int, root: bool = False) -> list[str]:
    """Lines of a value without indentation."""
    line = _line(value, width, root)
    if line is not None:
        return [line]
    lines = []
    if isinstance(value, dict):
        for key, item in value.items():
            lines += _entry(_text(key), item, width)
    else:
        for item in value:
            first, *rest = _block(item, width - 2)
            lines += [f"- {first}", *(f"  {line}" for line in rest)]
    return lines


def _entry(key: str, item: Any, width: int) -> list[str]:
    """Lines of a key and its value; a long key needs its own line."""
    *before, last = [f"{key}:"] if len(key) <= _LONGEST_KEY else [f"? {key}", ":"]
    line = _line(item, width - len(last) - 1)
    if line is not None:
        return [*before, f"{last} {line}"]
    return [*before, last, *(f"  {line}" for line in _block(item, width - 2))]


def _flow(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_text(key)}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int):
        # `scalar` refuses a number that is too long.
        return str(scalar(int.__repr__(value)))
    if isinstance(value, float):
        text = float.__repr__(value)
        return {"inf": ".inf", "-inf": "-.inf", "nan": ".nan"}.get(text, text)
    if isinstance(value, str):
        return _text(value)
    raise TypeError(f"cannot write {type(value).__name__} as YAML: {value!r}")


def _text(text: str) -> str:
    """Write text, in quotes where this reader or one of YAML 1.1 could read another type."""
    # Half of a surrogate pair raises UnicodeEncodeError, which is a ValueError.
    text.encode()
    if _PLAIN.fullmatch(text) and len(text) <= _LONGEST_KEY and isinstance(scalar(text), str):
        if _STOCK.resolve(yaml.ScalarNode, text, (True, False)) == "tag:yaml.org,2002:str":
            return text
    return _UNPRINTABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", json.dumps(text, ensure_ascii=False))
