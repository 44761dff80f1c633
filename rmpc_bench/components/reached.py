"""The part of a Python file on which one of its names depends, found from the syntax tree.

The code of a plant identifies an experiment.  An edit of another class in the same file must not make it another one.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable

_DYNAMIC = frozenset({"globals", "locals", "vars", "exec", "eval", "__import__", "import_module", "__getattr__"})
"""Names with which code reaches names that the syntax tree does not show."""
_ALWAYS = frozenset({"depends_on", "deterministic"})
"""Names that the bench itself reads from a file."""


def reached_text(text: bytes, names: Iterable[str]) -> bytes:
    """Return the statements of a file on which some names depend; all of it where the syntax tree cannot show that.

    Examples
    --------
    >>> reached_text(b"K = 0.5; g = 9.81; fall = lambda t: g * t; gain = K", ["fall"]).decode().splitlines()
    ['g = 9.81', 'fall = lambda t: g * t']
    """
    try:
        body = ast.parse(text).body
    except (SyntaxError, ValueError, RecursionError):
        return text
    used = [_used(statement) for statement in body]
    bound = [_bound(statement) for statement in body]
    wanted = {name.partition(".")[0] for name in names} | _ALWAYS
    known = set().union(*bound) if bound else set()
    if any(each & _DYNAMIC for each in used) or not wanted - _ALWAYS <= known or "*" in known:
        return text
    kept = {number for number, statement in enumerate(body) if not _is_definition(statement)}
    for number in kept:
        wanted |= used[number]
    while more := {number for number in range(len(body)) if number not in kept and bound[number] & wanted}:
        kept |= more
        for number in more:
            wanted |= used[number]
    found = ast.Module([body[number] for number in sorted(kept)], [])
    return ast.unparse(found).encode()


def _is_definition(statement: ast.stmt) -> bool:
    """Whether a statement does nothing but bind names; a docstring does not even that."""
    if isinstance(statement, ast.ImportFrom) and statement.module == "__future__":
        return False
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Constant)
    simple = isinstance(statement, ast.Assign) and all(isinstance(each, ast.Name) for each in statement.targets)
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Import, ast.ImportFrom)
    return (
        simple
        or isinstance(statement, kinds)
        or (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name))
    )


def _bound(statement: ast.stmt) -> set[str]:
    """Return the names that a statement of a module binds."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    found: set[str] = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= {each.asname or each.name.partition(".")[0] for each in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
    return found


def _used(statement: ast.stmt) -> set[str]:
    """Return the names that occur in a statement, also as text, since a name may be looked up by its text."""
    found: set[str] = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            found.add(node.value)
    return found
