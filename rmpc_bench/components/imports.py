"""What the syntax tree of a Python file says about other files: imports, `depends_on`, and what it cannot show."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import NamedTuple

_LOADERS = frozenset({"importlib", "ctypes", "cffi", "runpy", "subprocess", "pkgutil"})
"""Modules that load or start code."""
_HIDDEN = frozenset({"exec", "eval", "compile", "__import__", "os.system", "os.environ", "os.getenv", "sys.path"})
"""Names through which code, or a value that changes it, comes from elsewhere."""
_READERS = frozenset(
    {
        "numpy.fromfile",
        "numpy.genfromtxt",
        "numpy.load",
        "numpy.loadtxt",
        "numpy.memmap",
        "scipy.io.loadmat",
        "pickle.load",
        "joblib.load",
        "h5py.File",
        "casadi.external",
        "casadi.Function.load",
    }
)
"""Functions that read a file."""
_READING_METHODS = frozenset({"read_text", "read_bytes", "loadmat", "loadtxt", "genfromtxt"})
"""Methods that read a file, whatever their object is called."""
_LIBRARY = "rmpc_bench.extras.library"
DEPENDS_ON = "depends_on"


class Import(NamedTuple):
    """An import statement."""

    module: str  # dotted name; empty for ``from . import a``
    names: tuple[str, ...]  # what is imported from the module; empty for ``import module``
    level: int  # number of leading dots


class Place(NamedTuple):
    """A place of a file at which something is said."""

    line: int
    column: int
    text: str


class Hidden(NamedTuple):
    """Something that the syntax tree cannot show."""

    place: Place
    reads: bool  # whether it reads a file; otherwise it loads code
    argument: str | None  # the file where it is a literal


class References(NamedTuple):
    """What a file says about other files."""

    imports: tuple[Import, ...]
    hidden: tuple[Hidden, ...]
    depends_on: tuple[Place, ...]  # files that a class or the module names in ``depends_on = [...]``
    wrong: tuple[Place, ...]  # values of `depends_on` that are no list of literal texts
    extras: tuple[str, ...] = ()  # extras of which the file imports the library with `rmpc_bench.extras.library`


def references(tree: ast.Module) -> References:
    """Return what the syntax tree of a file says about other files; imports inside functions count too."""
    nodes = list(ast.walk(tree))
    names = _names(nodes)
    entries = [entry for node in nodes for entry in _depends_on(node)]
    depends_on = tuple(entry for entry in entries if entry.text)
    wrong = tuple(entry for entry in entries if not entry.text)
    hidden = {item.place: item for node in nodes for item in _hidden(node, names)}
    extras = tuple(sorted({extra for node in nodes for extra in _extras(node, names)}))
    return References(tuple(_imports(nodes)), tuple(sorted(hidden.values())), depends_on, wrong, extras)


def _imports(nodes: list[ast.AST]) -> Iterator[Import]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, (), 0) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield Import(node.module or "", tuple(alias.name for alias in node.names), node.level)


def _names(nodes: list[ast.AST]) -> dict[str, str]:
    """Name in the file -> dotted name of what it was imported as."""
    found: dict[str, str] = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.asname: alias.name for alias in node.names if alias.asname}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    return found


def _hidden(node: ast.AST, names: dict[str, str]) -> Iterator[Hidden]:
    if isinstance(node, ast.Import | ast.ImportFrom):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
        for module in modules:
            if module.partition(".")[0] in _LOADERS:
                yield Hidden(_place(node, f"import {module}"), False, None)
    elif isinstance(node, ast.Call):
        name = _dotted(node.func, names)
        if name in _HIDDEN:
            yield Hidden(_place(node, f"{name}()"), False, None)
        elif _reads(node, name):
            argument = node.args[0].value if node.args and isinstance(node.args[0], ast.Constant) else None
            literal = argument if isinstance(argument, str) else None
            yield Hidden(_place(node, f"{name}({literal!r})" if literal else f"{name}()"), True, literal)
    elif isinstance(node, ast.Attribute) and (name := _dotted(node, names)) in ("sys.path", "os.environ"):
        yield Hidden(_place(node, name), False, None)


def _extras(node: ast.AST, names: dict[str, str]) -> Iterator[str]:
    """Yield the extra of a call ``library("filterpy", ..)``."""
    if isinstance(node, ast.Call) and node.args and _dotted(node.func, names) == _LIBRARY:
        first = node.args[0]
        if isinstance(first, ast.Constant) and isinstance(first.value, str):
            yield first.value


def _reads(call: ast.Call, name: str) -> bool:
    """Whether a call reads a file."""
    last = name.rpartition(".")[2]
    if last == "open":
        given = [*call.args, *(key.value for key in call.keywords)]
        texts = [value.value for value in given if isinstance(value, ast.Constant) and isinstance(value.value, str)]
        return not any(text.strip("bt") in ("w", "a", "x") for text in texts)
    return name in _READERS or last in _READING_METHODS or name.startswith("pandas.read_")


def _dotted(node: ast.AST, names: dict[str, str]) -> str:
    """Return the dotted name of an expression, in terms of the modules; what is no name gives a leading dot."""
    steps: list[str] = []
    while isinstance(node, ast.Attribute):
        steps.append(node.attr)
        node = node.value
    first = names.get(node.id, node.id) if isinstance(node, ast.Name) else ""
    return ".".join([first, *reversed(steps)])


def _depends_on(node: ast.AST) -> Iterator[Place]:
    """Yield the files of ``depends_on = [...]`` of a class or module, or of ``function.depends_on = [...]``."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    named = {
        target.id if isinstance(target, ast.Name) else target.attr if isinstance(target, ast.Attribute) else ""
        for target in targets
    }
    if DEPENDS_ON not in named:
        return
    try:
        value = ast.literal_eval(node.value)
    except ValueError:
        value = None
    entries = value if isinstance(value, list | tuple) else [None]
    yield from (_place(node, entry if isinstance(entry, str) else "") for entry in entries)


def _place(node: ast.AST, text: str) -> Place:
    return Place(getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1, text)
