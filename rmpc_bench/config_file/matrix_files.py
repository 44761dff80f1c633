"""Matrices from files, ``A: {file: system.mat, name: A}``, and linear systems, ``model: {linear: {from: system.mat}}``.

The numbers replace the name of the file when a configuration is read, so that they count for its identity and the
resolved configuration needs no file.  File names are relative to the file in which they stand.

.mat   a MATLAB file up to version 7.2; .npz  a NumPy archive; .csv  one matrix, a row per line, or
columns below a heading.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rmpc_bench.config_file.known_files import MAX_NAME, is_file_name
from rmpc_bench.config_file.tree import Items, Map, Mark, Problems, join, locate, locate_key
from rmpc_bench.expressions import quantity
from rmpc_bench.received.arrays import MAX_ENTRIES, ArrayFileError, matrices
from rmpc_bench.received.plain_files import content_of
from rmpc_bench.types import Array, Problem
from rmpc_bench.types.errors import unknown

SUFFIXES = (".mat", ".npz", ".csv")
SECTIONS_WITHOUT_MATRICES = ("input", "plugins", "claims")  # sections in which the key `file` has another meaning
SYSTEM = {
    "models": {"A": "A", "B": "B", "C": "C", "D": "D", "Q": "P_w", "R": "P_v"},
    "plants": dict(zip("ABCD", "ABCD", strict=True)),
}  # group of the component ``linear`` -> name in the file -> key of the component
WAYS_OUT = {
    "a struct": "save its fields: save('{file}', '-struct', '{name}')",
    "a sparse matrix": "save full({name})",
    "an object": "of a state-space model save [A, B, C, D] = ssdata({name})",
}  # what MATLAB calls a variable that is no matrix of numbers -> how its numbers are saved
SAME_STEP = 1e-9  # relative difference of two sampling times that are meant to be equal


class _FileError(Exception):
    """A file that does not contain what is asked for."""


def with_matrices(tree: Map, path: Path) -> Map:
    """Replace the names of matrix files by the numbers in them."""
    reader = _Reader(tree, path)
    result = tree.copy()
    for key, value in tree.items():
        if key not in SECTIONS_WITHOUT_MATRICES:
            result[key] = reader.replaced(value, [key])
    reader.problems.stop()
    return result


class _Reader:
    """Replaces file names in a tree and collects problems."""

    def __init__(self, tree: Map, path: Path) -> None:
        self.tree, self.path, self.problems = tree, path, Problems()
        self._read: dict[Path, Mapping[str, Array]] = {}

    def replaced(self, node: Any, path: list[str | int]) -> Any:
        """Return a node with numbers in place of file names; the node itself where it has none."""
        if isinstance(node, Map):
            if _is_matrix(node):
                return self._matrix(node, path)
            result = node.copy()
            for key, value in node.items():
                of = node.get("of") if key == "values" and isinstance(value, Map) else None
                rows = isinstance(of, Items)
                result[key] = self._table(value, [*path, key], of) if rows else self.replaced(value, [*path, key])
            source = result.get("linear")
            is_system = isinstance(source, Map) and {*source} == {"from"} and isinstance(source["from"], str)
            return self._system(result, path) if is_system else result
        if isinstance(node, Items):
            return node.like(self.replaced(value, [*path, number]) for number, value in enumerate(node))
        return node

    def _table(self, node: Map, path: list[str | int], of: Any) -> Any:
        """Return the rows of a file with the columns `of`; a mapping that names no file is an error."""
        if _is_matrix(node):
            return self._matrix(node, path, of)
        wrong = next((key for key in node if key not in ("file", "name")), "file")
        said = unknown(wrong, ("file", "name"), "key") if wrong != "file" else f"must end in {', '.join(SUFFIXES)}"
        self.problems.append(Problem(*locate_key(node, [wrong]), join([*path, wrong]), said))
        return node

    def _matrix(self, node: Map, path: list[str | int], of: Any = ()) -> Any:
        """Return a matrix; that of the columns `of`, where the file has arrays of these names."""
        mark, name = locate(node, ["file"]), node.get("name")
        try:
            content = self._content(node["file"], mark)
            if of and all(isinstance(each, str) and each in content for each in of):
                columns = [_named(content, each, node["file"]).reshape(-1) for each in of]
                if len({*map(len, columns)}) > 1:
                    raise _FileError(f"{node['file']} has columns of different lengths")
                return _numbers(np.column_stack(columns), mark)
            if name is None and len(content) != 1:
                wrong, known = [each for each in of if each not in [*content]], ", ".join(content)
                said = f"no column {wrong[0]!r}; there are {known}" if wrong else f"{known}; add `name`"
                raise _FileError(f"{node['file']} has {said}")
            return _numbers(_named(content, next(iter(content)) if name is None else str(name), node["file"]), mark)
        except _FileError as error:
            self.problems.append(Problem(*mark, join([*path, "file"]), str(error)))
            return node

    def _system(self, node: Map, path: list[str | int]) -> Any:
        """Return the keys of a linear system, below those that are given next to it."""
        source, mark = node["linear"], locate(node["linear"], ["from"])
        group = "plants" if path[-1] == "plant" else "models"
        result = node.copy()
        del result["linear"]
        try:
            content = self._content(source["from"], mark)
            self._check(content, source["from"])
            names = {name: key for name, key in SYSTEM[group].items() if name in content or name in "AC"}
            found = {key: _named(content, name, source["from"]) for name, key in names.items()}
            found = {key: matrix for key, matrix in found.items() if key != "D" or matrix.any()}
        except _FileError as error:
            self.problems.append(Problem(*mark, join([*path, "linear", "from"]), str(error)))
            return node
        result.put("kind", "linear", mark, mark)
        for key, matrix in found.items():
            if key not in node:
                result.put(key, _numbers(matrix, mark), mark, mark)
        return result

    def _check(self, content: Mapping[str, Array], text: str) -> None:
        """Refuse another sampling time."""
        if "Ts" not in content:
            return
        Ts, step = float(_named(content, "Ts", text).reshape(-1)[0]), self._step()
        if step is not None and abs(Ts - step) > SAME_STEP * max(Ts, step):
            raise _FileError(f"{text}: Ts is {Ts:g}, and time.step is {step:g}; they must be equal")

    def _step(self) -> float | None:
        """Sampling time of the configuration; None where it is no number, which is reported at its own place."""
        time = self.tree.get("time")
        try:
            return float(quantity.number(time.get("step", 1.0))) if isinstance(time, Map) else None
        except (quantity.QuantityError, ValueError, TypeError):
            return None

    def _content(self, text: str, mark: Mark) -> Mapping[str, Array]:
        """Return the matrices of a file by their names."""
        base = mark.directory(self.path)
        file = base / text
        if file not in self._read:
            self._read[file] = _read(file, text)
        return self._read[file]


def _is_matrix(node: Map) -> bool:
    """Whether a mapping names a matrix in a file."""
    file = node.get("file")
    return set(node) <= {"file", "name"} and isinstance(file, str) and file.lower().endswith(SUFFIXES)


def _read(file: Path, text: str) -> Mapping[str, Array]:
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise _FileError(f"{text}: the ending must be one of {', '.join(SUFFIXES)}")
    if not is_file_name(text):
        raise _FileError(f"the name of a file has at most {MAX_NAME} characters (got {len(text)})")
    if not file.exists():
        near = difflib.get_close_matches(file.name, [each.name for each in file.parent.glob(f"*{suffix}")], n=1)
        raise _FileError(f"{text}: there is no such file" + (f"; did you mean {near[0]!r}?" if near else ""))
    try:
        return matrices(content_of(file), suffix, file.stem)
    except ArrayFileError as error:
        raise _FileError(f"{text}: {error}") from None
    except OSError as error:
        raise _FileError(f"{text}: cannot be read ({error.strerror or error})") from None


def _named(content: Mapping[str, Array], name: str, text: str) -> Array:
    numbers = {each: matrix for each, matrix in content.items() if matrix.dtype != object}
    if name in numbers:
        return numbers[name]
    near = difflib.get_close_matches(name, numbers, n=1)
    others = {each: str(content[each].item()) for each in content if each not in numbers}
    asked = [each for each in (name, name.partition(".")[0]) if each in others]
    hint = f"; did you mean {near[0]!r}?" if near else f"; there are {', '.join(content) or 'none'}"
    for other in asked or [each for each in others if others[each] in WAYS_OUT and not near][:1]:
        way_out = WAYS_OUT.get(others[other], "save its numbers as a matrix").format(name=other, file=text)
        hint = f": {other} is {others[other]}; {way_out}"
    raise _FileError(f"{text} has no matrix {name!r}{hint}")


def _numbers(matrix: Array, mark: Mark) -> Any:
    """Return an array of a file as a configuration writes it: rows, a flat list or a number."""
    is_real = matrix.dtype.kind in "biuf"
    if not is_real or matrix.ndim > 2 or not matrix.size or not np.isfinite(matrix).all():
        raise _FileError(f"must be a matrix of finite real numbers (got shape {matrix.shape} of type {matrix.dtype})")
    if matrix.size > MAX_ENTRIES:
        raise _FileError(f"must have at most {MAX_ENTRIES} entries (got {matrix.size})")
    return _marked(matrix.astype(float).tolist(), mark)


def _marked(value: Any, mark: Mark) -> Any:
    if not isinstance(value, list):
        return value
    return Items([_marked(each, mark) for each in value], mark=mark, value_marks=[mark] * len(value))
