"""Stage 1, read: the file of a configuration with all that it extends, and what the command line changes and adds.

``extends: other.yaml`` lays the file over the other one, deep: a mapping is merged key by key, a list or a scalar
replaces what is inherited, and ``key: !delete`` removes an inherited key.  The lists under `requires` are joined.  A
component of another kind, a noise of another law and a distribution of another name replace the inherited one whole.
The name and the claims are not inherited: results of two configurations need two names, and a claim is about the
configuration in which it stands.

Every value keeps its place, so that a path is relative to the file it stands in, and an error names that file.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rmpc_bench.config_file.keys import shown
from rmpc_bench.config_file.known_files import file_beside, is_file_name
from rmpc_bench.config_file.method_grid import EXCLUDE, GRID
from rmpc_bench.config_file.tree import (
    DELETE,
    Items,
    Map,
    Mark,
    Problems,
    join,
    locate,
    plain,
    same_kind,
    split,
    with_kind,
)
from rmpc_bench.config_file.yaml import EXTENDS, Override, load, one_line, parse, parse_override
from rmpc_bench.expressions.quantity import written_file
from rmpc_bench.registry import unknown
from rmpc_bench.types import ConfigError, Problem


class GivenConfig(NamedTuple):
    """A configuration as it was given."""

    path: Path  # file of the configuration; file names inside it are relative to its directory
    tree: Map
    overrides: tuple[Override, ...]
    problems: tuple[Problem, ...]  # errors in the texts of overrides and of added methods
    texts: tuple[str, ...] = ()  # the overrides as given
    added: Map = Map(mark=Mark("", 1, 1))  # methods that are added to those of the file
    content: str | None = None  # text of a configuration that stands in no file

    def options(self, runs: int | None, *, smoke: bool) -> tuple[str, ...]:
        """Return the options of the command line that change the experiment, its runs or size, against its file."""
        found = [f"-s {shlex.quote(text)}" for text in self.texts if not text.startswith("execution.")]
        found += [f"--runs {runs}"] if runs is not None and (smoke or self.tree.get("runs") != runs) else []
        return (*found, *["--smoke"] * smoke)


def read(
    path: str | Path, overrides: Sequence[str], add_methods: Sequence[str] = (), content: str | None = None
) -> GivenConfig:
    """Read a file, overrides PATH=VALUE and methods ``NAME: {..}``; `ConfigError` where the file is no mapping.

    A content is taken for that of the file, which then need not exist.
    """
    tree = read_extended(path, content=content)
    if not isinstance(tree, Map):
        raise ConfigError([Problem(str(path), 1, 1, "", f"must be a mapping (got {shown(tree)})")])
    problems = Problems()
    given = [problems.tried(_override, text) for text in overrides]
    parsed = tuple(each for each in given if each is not None)
    added = read_methods(add_methods, problems)
    return GivenConfig(Path(path), tree, parsed, tuple(problems), tuple(overrides), added, content)


def _override(text: str) -> Override:
    override = parse_override(text)
    if split(override.path, override.mark)[0] == EXTENDS:
        message = "cannot be set here: a file extends another before it is overridden"
        raise ConfigError([Problem(*override.mark, EXTENDS, message)])
    return override


NOT_INHERITED = ("name", "claims")  # top-level keys that every configuration has of its own

REQUIRES = "requires"
"""Top-level key whose list is joined with the inherited one: inherited components need their libraries, too."""

COMPONENTS = {
    **{"plant": "plants", "model": "models", "estimator": "estimators", "controller": "controllers"},
    **{"reference": "references", "input": "inputs"},
}  # keys of components -> their groups


def read_extended(path: str | Path, extended: tuple[Path, ...] = (), content: str | None = None) -> Any:
    """Read a configuration with all that it inherits, without the key `extends`; not a mapping where the file is none.

    `extended` has the resolved files that extend this one, `content` what this one holds unless it is to be read.
    Raises a ConfigError if a file cannot be read, extends itself, or deletes what it does not inherit.
    """
    tree = load(path) if content is None else parse(content, str(path), may_extend=True)
    if not isinstance(tree, Map) or EXTENDS not in tree:
        return tree
    base = _base_of(tree, Path(path), (*extended, Path(path).resolve()))
    own = tree.copy()
    del own[EXTENDS]
    for key in NOT_INHERITED:
        base.pop(key, None)
    merger = _Merger()
    merged = merger.merged(base, own, [])
    merger.problems.stop()
    return merged


def _base_of(tree: Map, path: Path, extended: tuple[Path, ...]) -> Map:
    """Read the configuration that a tree extends, and return it as an own copy."""
    text, mark = tree[EXTENDS], locate(tree, [EXTENDS])
    _, base = read_named(EXTENDS, text, mark, path.parent, extended)
    if not isinstance(base, Map):
        raise ConfigError([Problem(*mark, EXTENDS, f"{text}: must be a mapping (got {shown(base)})")])
    return base.copy()


def read_named(key: str, text: Any, mark: Mark, directory: Path, leading: tuple[Path, ...]) -> tuple[Path, Any]:
    """Return the file that a key names, reached by the `leading` ones, and its content; a ConfigError at the name."""
    if not is_file_name(text):
        raise ConfigError([Problem(*mark, key, f"must be the name of a configuration (got {shown(text)})")])
    if numbers := written_file(text):
        message = f"must be the name of a configuration (.yaml); matrices of a file are written A: {numbers}"
        raise ConfigError([Problem(*mark, key, message)])
    file, extends = file_beside(directory, text), key == EXTENDS
    if file.resolve() in leading:
        raise ConfigError([Problem(*mark, key, f"{text}: {'extends' if extends else 'includes'} itself")])
    try:
        return file, read_extended(file, leading if extends else ())
    except ConfigError as error:
        at_the_name = [Problem(*mark, key, f"{each.file}: {each.message}") for each in error.problems]
        raise ConfigError(error.problems if file.is_file() else at_the_name) from None


class _Merger:
    """Lays one configuration over another and collects problems."""

    def __init__(self) -> None:
        self.problems = Problems()

    def merged(self, base: Map, own: Map, path: list[str | int]) -> Map:
        """Lay a mapping over an inherited one at a path; neither is changed."""
        result = base.copy()
        result.mark = own.mark
        _drop_other_length(result, own, path)
        for key, value in own.items():
            here = [*path, key]
            if value is DELETE:
                self._delete(result, base, own, here)
                continue
            inherited = base.get(key)
            if isinstance(value, Map) and isinstance(inherited, Map) and not _replaces(inherited, value, here):
                value = self.merged(inherited, value, here)
            else:
                self._refuse_deletions(value, here)
            if here == [REQUIRES] and isinstance(value, Items) and isinstance(inherited, Items):
                value = _joined(inherited, value)
            result.put(key, value, *own.places(key))
        return result

    def _delete(self, result: Map, base: Map, own: Map, path: list[str | int]) -> None:
        key = str(path[-1])
        if key in base:
            for each in (result, result.key_marks, result.value_marks):
                each.pop(key, None)
        else:
            self._note(own, path, unknown(key, base, "inherited key"))

    def _refuse_deletions(self, value: Any, path: list[str | int]) -> None:
        """Report every `!delete` in a value that is laid over nothing."""
        steps = list(value) if isinstance(value, Map) else range(len(value)) if isinstance(value, Items) else ()
        for step in steps:
            if value[step] is DELETE:
                self._note(value, [*path, step], "there is nothing to delete: the value around it is not inherited")
            else:
                self._refuse_deletions(value[step], [*path, step])

    def _note(self, own: Map | Items, path: list[str | int], message: str) -> None:
        mark: Mark = locate(own, [path[-1]])
        self.problems.append(Problem(*mark, join(path), message))


def _joined(base: Items, own: Items) -> Items:
    """Return the entries of two lists, each once and with its place."""
    placed: list[tuple[Any, Mark]] = []
    for each in (own, base):
        for number, entry in enumerate(each):
            if entry not in [known for known, _ in placed]:
                placed.append((entry, locate(each, [number])))
    return Items([entry for entry, _ in placed], mark=own.mark, value_marks=[mark for _, mark in placed])


def _drop_other_length(result: Map, own: Map, path: list[str | int]) -> None:
    """Drop the inherited length of the runs where the other key for it is given."""
    if path != ["time"]:
        return
    for given, other in (("steps", "duration"), ("duration", "steps")):
        if given in own and other not in own:
            result.pop(other, None)


def _replaces(base: Map, own: Map, path: list[str | int]) -> bool:
    """Whether a mapping stands for something of another kind than the inherited one."""
    # methods.NAME.estimator, methods.grid.estimator.NAME
    names = path[2:3] if len(path) == (4 if path[1:2] == [GRID] else 3) and path[0] == "methods" else path
    group = COMPONENTS.get(str(names[0])) if len(names) == 1 else None
    if group is not None:
        base, own = with_kind(group, base), with_kind(group, own)
    if "kind" in base and "kind" in own:
        return not same_kind(base, own)
    if path[0] == "uncertainty" and len(path) == 2:
        return base.get("dist") != own.get("dist") and "dist" in own
    if path == ["plant", "uncertainty"]:
        # The bounds of one law have no meaning for another.
        return "law" in own
    if path[0] == "noise" or path[:2] == ["initial", "x"]:
        # A law is a mapping with its name as its only key.
        return len(path) == 2 and not {*base} & {*own}
    return False


OPTION = "--add-method"


def read_methods(texts: Sequence[str], problems: Problems) -> Map:
    """Read methods from texts such as ``NAME: {estimator: {kind: kalman}}``, in which the values keep their places."""
    found = Map(mark=Mark(OPTION, 1, 1))
    for text in texts:
        tree = problems.tried(_methods, text) or Map(mark=found.mark)
        for name, method in tree.items():
            key_mark, mark = tree.places(name)
            if name in found:
                problems.append(Problem(*key_mark, name, "is added twice"))
            elif not isinstance(method, Map):
                message = f"must be a mapping with an estimator or a controller (got {shown(method)})"
                problems.append(Problem(*mark, name, message))
            else:
                found.take(tree, name)
    return found


def _methods(text: str) -> Map:
    file = f"{OPTION} {text}"
    tree = parse(text, file)
    if not isinstance(tree, Map) or not tree:
        message = f"must be a mapping such as 'NAME: {{estimator: {{kind: kalman}}}}' (got {shown(tree)})"
        raise ConfigError([Problem(file, 1, 1, "", message)])
    return tree


def with_methods(tree: Map, added: Map) -> Map:
    """Add methods from `read_methods` to a tree with overrides and files in place; a ConfigError names taken names."""
    methods = tree.get("methods")
    if not added or not isinstance(methods, Map):
        return tree
    result, merged, problems = tree.copy(), methods.copy(), Problems()
    for name in added:
        if name in methods or name in (GRID, EXCLUDE):
            which = "method" if name in methods else "key"
            message = f"is a {which} of the configuration already; choose another name"
            problems.append(Problem(*added.places(name)[0], join(["methods", name]), message))
        else:
            merged.take(added, name)
    problems.stop()
    result["methods"] = merged
    return result


def texts_of(added: Map) -> Mapping[str, str]:
    """Return name -> the method as the command line takes it, on one line.

    >>> dict(texts_of(read_methods(["A: {estimator: {kind: kalman}}"], Problems())))
    {'A': 'A: {estimator: {kind: kalman}}'}
    """
    return {name: one_line({name: plain(method)})[1:-1] for name, method in added.items()}
