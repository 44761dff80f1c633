"""The canonical hash of Python code: comments, layout and docstrings do not count.

The syntax tree is written by this module and not by `ast.dump`, whose text depends on the version of Python.  Empty and
missing fields are left out, since later versions add fields (`type_params` in 3.12, `default_value` in 3.13).  The
parts of a formatted string are joined, and text is written in ASCII, since `repr` follows the Unicode tables of the
interpreter.  So the hash is the same in all versions of Python that can read the file.
"""

from __future__ import annotations

import ast
import hashlib
from typing import Any

_WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_NO_MEANING = frozenset({"kind", "type_comment", "type_ignores"})
"""Fields that change nothing: the prefix of ``u"text"`` and comments with types."""


def syntax_hash(tree: ast.AST) -> str:
    """Return the SHA-256 of a syntax tree without `pass`, and without docstrings unless the file reads ``__doc__``.

    Examples
    --------
    >>> syntax_hash(ast.parse("x = (1)  # one")) == syntax_hash(ast.parse("x=1"))
    True
    """
    with_docstrings = any(_reads_docstrings(node) for node in ast.walk(tree))
    hasher = hashlib.sha256()
    # A stack, since a long sum is a deep tree.
    stack: list[Any] = [tree]
    while stack:
        item = stack.pop()
        if isinstance(item, ast.AST):
            fields = _fields(item, with_docstrings)
            hasher.update(f"{type(item).__name__} {len(fields)}\n".encode())
            for name, value in reversed(fields):
                stack += [value, _Name(name)]
        elif isinstance(item, list):
            hasher.update(f"[{len(item)}\n".encode())
            stack += reversed(item)
        else:
            hasher.update(f"{_text(item)}\n".encode())
    return hasher.hexdigest()


class _Name(str):
    """Name of a field."""


def _reads_docstrings(node: ast.AST) -> bool:
    return (isinstance(node, ast.Name) and node.id == "__doc__") or (
        isinstance(node, ast.Attribute) and node.attr in ("__doc__", "getdoc")
    )


def _fields(node: ast.AST, with_docstrings: bool) -> list[tuple[str, Any]]:
    """Return the fields that have a value, sorted by name, since later versions of Python may insert some."""
    found = []
    for name in sorted(set(node._fields) - _NO_MEANING):
        value = getattr(node, name, None)
        if name == "value" and isinstance(node, ast.Constant):
            # None is a value here.
            found.append((name, value))
            continue
        if isinstance(value, list):
            value = _entries(node, name, value, with_docstrings)
        elif name == "format_spec" and isinstance(value, ast.JoinedStr):
            # An empty format and no format are one; versions of Python write it differently.
            value = value if _joined(value.values) else None
        if value is not None and value != []:
            found.append((name, value))
    return found


def _entries(node: ast.AST, name: str, entries: list[Any], with_docstrings: bool) -> list[Any]:
    """Return the entries of a list that change something."""
    if isinstance(node, ast.JoinedStr):
        return _joined(entries)
    if name == "body" and isinstance(node, _WITH_DOCSTRING) and not with_docstrings and _is_text(entries[:1]):
        entries = entries[1:]
    return [entry for entry in entries if not isinstance(entry, ast.Pass)]


def _is_text(statements: list[ast.stmt]) -> bool:
    return any(
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
        for statement in statements
    )


def _joined(parts: list[Any]) -> list[Any]:
    """Join neighbouring texts of a formatted string, and leave out empty ones."""
    found: list[Any] = []
    for part in parts:
        text = part.value if isinstance(part, ast.Constant) else None
        if isinstance(text, str) and found and isinstance(found[-1], str):
            found[-1] += text
        elif text != "":
            found.append(part if text is None else text)
    return found


def _text(value: Any) -> str:
    """Write a constant with its type, so that 1, 1.0, True and "1" differ."""
    if isinstance(value, _Name):
        return f".{value}"
    # Decimal digits of a long integer are refused by Python.
    written = hex(value) if type(value) is int else ascii(value)
    return f"{type(value).__name__} {written}"
