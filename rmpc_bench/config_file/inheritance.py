"""Stage 2, inherit: overrides replace values, and the contents of a file replace its name in ``plant.from``.

``plant: {from: FILE, ..}`` is the plant of another configuration, in which the keys given here replace values.  The
`model`, `noise`, `initial` and `reference` of that file are used if this configuration has none (plant_source.py).  All
files are read here, so that later stages depend on no file and the resolved configuration loads from any directory.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rmpc_bench.config_file.added_methods import with_methods
from rmpc_bench.config_file.extension import read_extended
from rmpc_bench.config_file.key_errors import shown
from rmpc_bench.config_file.known_files import file_beside, is_file_name
from rmpc_bench.config_file.plant_source import FILE, PATH, SECTIONS_OF_A_PLANT, lay_over_source, open_section
from rmpc_bench.config_file.reader import Override
from rmpc_bench.config_file.source import GivenConfig
from rmpc_bench.config_file.tree import Items, Map, Mark, assign, locate, split
from rmpc_bench.types import ConfigError, Problem


def inherit(source: GivenConfig) -> Map:
    """Return the tree of a configuration with overrides, files and added methods in place.

    Overrides that name a file are laid first, the others after the files have been read, so that they can replace
    values of these files.  Raises a ConfigError if an override does not fit the tree, or a file cannot be read, has no
    plant, or includes itself.
    """
    problems = list(source.problems)
    naming = [override for override in source.overrides if _names_a_file(override)]
    others = [override for override in source.overrides if override not in naming]
    tree = _override(source.tree, naming, problems)
    if not problems:
        tree = _FileReader(problems).read_all(tree, source.path, ())
    tree = _override(tree, others, problems)
    tree = with_methods(tree, source.added, problems)
    if problems:
        raise ConfigError(problems)
    return tree


def _names_a_file(override: Override) -> bool:
    steps = split(override.path, override.mark)
    return steps[0] == "sweep" or steps in (["plant"], ["plant", "from"])


def _override(tree: Map, overrides: Sequence[Override], problems: list[Problem]) -> Map:
    """Replace values; an override that does not fit the tree adds to the problems."""
    for path, value, mark in overrides:
        try:
            tree = assign(open_section(tree, path), path, value, mark)
        except ConfigError as error:
            problems += error.problems
    return tree


class _FileReader:
    """Replaces file names by the sections of these files; a file that cannot be used adds to the problems."""

    def __init__(self, problems: list[Problem]) -> None:
        self.problems = problems

    def read_all(self, tree: Map, path: Path, including: tuple[Path, ...]) -> Map:
        """Read the files that plant and sweep of a configuration name, relative to its own file `path`.

        `including` has the files that led to this one.
        """
        including = (*including, path.resolve())
        result = tree.copy()
        plant = tree.get("plant")
        if isinstance(plant, Map) and isinstance(plant.get("from"), str):
            result["plant"] = self._replaced(plant, "from", path, including)
        sweep = tree.get("sweep")
        if isinstance(sweep, Map):
            result["sweep"] = sweep.copy()
            for kind in ("grid", "zip"):
                if isinstance(sweep.get(kind), Map | Items):
                    result["sweep"][kind] = self._swept(sweep[kind], path, including)
        return result

    def _swept(self, node: Any, path: Path, including: tuple[Path, ...]) -> Any:
        """Read the files that a grid or a zip names."""
        if isinstance(node, Items):
            rows = [
                self._replaced(row, PATH, path, including)
                if isinstance(row, Map) and isinstance(row.get(PATH), str)
                else row
                for row in node
            ]
            return Items(rows, mark=node.mark, value_marks=node.value_marks)
        if PATH not in node:
            return node
        values, result = node[PATH], node.copy()
        if isinstance(values, Map):
            for name, text in values.items():
                if isinstance(text, str):
                    result[PATH] = self._replaced(result[PATH], name, path, including)
        elif isinstance(values, Items):
            marks = [locate(values, [number]) for number in range(len(values))]
            items = [
                self._sections(text, mark, path, including) if isinstance(text, str) else text
                for text, mark in zip(values, marks, strict=True)
            ]
            result[PATH] = Items(items, mark=values.mark, value_marks=marks)
        return result

    def _replaced(self, tree: Map, key: str, path: Path, including: tuple[Path, ...]) -> Map:
        result = tree.copy()
        result[key] = self._sections(tree[key], locate(tree, [key]), path, including)
        return result

    def _sections(self, text: str, mark: Mark, path: Path, including: tuple[Path, ...]) -> Any:
        """Return the sections that a plant brings along; the name itself where the file cannot be used."""
        try:
            file = file_beside(mark.directory(path), text)
            tree = _plant_file(text, mark, file, including)
            before = len(self.problems)
            tree = self.read_all(tree, file, including)
            if len(self.problems) > before:
                return text
            tree = lay_over_source(tree)
        except ConfigError as error:
            self.problems += error.problems
            return text
        sections = Map({FILE: text}, mark=mark)
        for key in ("plant", *SECTIONS_OF_A_PLANT):
            if key in tree:
                sections.put(key, tree[key], tree.key_marks.get(key, mark), tree.value_marks.get(key, mark))
        return sections


def _plant_file(text: str, mark: Mark, file: Path, including: tuple[Path, ...]) -> Map:
    """Read a configuration that has a plant, without its sweep; ConfigError at the place of its name."""
    if not is_file_name(text):
        raise ConfigError([Problem(*mark, PATH, f"must be the name of a configuration (got {shown(text)})")])
    if file.resolve() in including:
        raise ConfigError([Problem(*mark, PATH, f"{text}: includes itself")])
    try:
        tree = read_extended(file)
    except ConfigError as error:
        at_the_name = [Problem(*mark, PATH, f"{each.file}: {each.message}") for each in error.problems]
        raise ConfigError(error.problems if file.is_file() else at_the_name) from None
    if not isinstance(tree, Map) or not isinstance(tree.get("plant"), Map):
        raise ConfigError([Problem(*mark, PATH, f"{text}: has no plant")])
    without_sweep = {key: tree[key] for key in tree if key != "sweep"}
    return Map(without_sweep, mark=tree.mark, key_marks=tree.key_marks, value_marks=tree.value_marks)
