"""Writing plain data as YAML 1.2 that loads as the same data."""

from __future__ import annotations

import json
import re
from collections.abc import Collection
from typing import Any

import yaml  # type: ignore[import-untyped]

from rmpc_bench.config_file.tree import MAX_DEPTH, scalar

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

    Examples
    --------
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
