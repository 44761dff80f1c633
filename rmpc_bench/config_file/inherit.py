"""Stage 2, inherit: overrides replace values, and the contents of a file replace its name in ``plant.from``.

``plant: {from: FILE, ..}`` is the plant of another configuration, in which the keys given here replace values.  The
`model`, `noise`, `initial` and `reference` of that file are used if this configuration has none.  All files are read
here, so that later stages depend on no file and the resolved configuration loads from any directory.
``model: {from: plant, ..}`` has the parameters of the plant except for those given there.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config_file.component import read_component
from rmpc_bench.config_file.keys import model_of, shown
from rmpc_bench.config_file.known_files import file_beside, is_file_name
from rmpc_bench.config_file.source import GivenConfig, read_extended, with_methods
from rmpc_bench.config_file.tree import Items, Map, Mark, assign, locate, merge, split, with_kind
from rmpc_bench.config_file.yaml import Override
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


SECTIONS_OF_A_PLANT = ("model", "noise", "initial", "reference", "input")
"""Sections of the file that a plant comes from, which hold where a configuration has none."""

FILE = "file"
"""Key beside the sections of a file that has been read: its name as given."""

PATH = "plant.from"


def compose(tree: Map, access: CodeAccess = NO_ACCESS) -> Map:
    """Lay what is given here over the plant, the sections and the models that come from elsewhere.

    The tree has its files read, and no sweep.  Raises a ConfigError if ``from`` is not a file, or a model comes from
    anything but a plant with a design model.
    """
    tree = lay_over_source(tree).copy()
    if _from_plant(tree.get("model")):
        tree["model"] = _model_of_plant(tree, tree["model"], access)
    methods = tree.get("methods")
    if isinstance(methods, Map):
        tree["methods"] = methods.copy()
        for name, own in methods.items():
            if isinstance(own, Map) and _from_plant(own.get("model")):
                tree["methods"][name] = own.copy()
                tree["methods"][name]["model"] = _model_of_plant(tree, own["model"], access)
    return tree


def lay_over_source(tree: Map) -> Map:
    """Lay a plant over the one of its file, and take the other sections of that file where there are none.

    Raises a ConfigError if ``from`` is not the name of a file.
    """
    plant = tree.get("plant")
    if not isinstance(plant, Map) or "from" not in plant:
        return tree
    source, own = plant["from"], plant.copy()
    del own["from"]
    if not isinstance(source, Map) or not isinstance(source.get("plant"), Map):
        message = f"must be the name of a configuration (got {shown(source)})"
        raise ConfigError([Problem(*locate(plant, ["from"]), PATH, message)])
    result = tree.copy()
    result["plant"] = merge(with_kind("plants", source["plant"]), with_kind("plants", own))
    law = own.get("uncertainty")
    if isinstance(law, Map) and "law" in law:
        # Replaced as a component of another kind is: the bounds of one law have no meaning for another.
        result["plant"]["uncertainty"] = law
    for key in SECTIONS_OF_A_PLANT:
        if key in source and key not in tree and not (key == "input" and _has_controller(tree)):
            result.put(key, source[key], source.key_marks.get(key, source.mark), locate(source, [key]))
    return result


def _has_controller(tree: Map) -> bool:
    """Whether a method of a configuration has a controller, so that the input of another file does not hold."""
    methods = tree.get("methods")
    own = methods.values() if isinstance(methods, Map) else ()
    return "controller" in tree or any(isinstance(method, Map) and "controller" in method for method in own)


def open_section(tree: Map, path: str) -> Map:
    """Copy a section that comes with the plant into the tree, so that a value inside it can be set at a path."""
    key, _, rest = path.partition(".")
    plant = tree.get("plant")
    source = plant.get("from") if isinstance(plant, Map) else None
    if not rest or key not in SECTIONS_OF_A_PLANT or key in tree or not isinstance(source, Map) or key not in source:
        return tree
    result = tree.copy()
    result.put(key, source[key], source.key_marks.get(key, source.mark), locate(source, [key]))
    return result


def has_source(tree: Map) -> bool:
    """Whether the plant or a model, of all methods or of one, comes from elsewhere."""
    own = [method.get("model") for method in (tree.get("methods") or {}).values() if isinstance(method, Map)]
    return any(isinstance(part, Map) and "from" in part for part in (tree.get("plant"), tree.get("model"), *own))


def _from_plant(model: Any) -> bool:
    return isinstance(model, Map) and "from" in model


def _model_of_plant(tree: Map, model: Map, access: CodeAccess) -> Map:
    """Lay a model over the parameters of the plant."""
    own, plant = model.copy(), with_kind("plants", tree.get("plant"))
    if own.pop("from") != "plant":
        message = f"must be 'plant' (got {shown(model['from'])})"
        raise ConfigError([Problem(*locate(model, ["from"]), "model.from", message)])
    kind = own.get("kind", plant.get("kind") if isinstance(plant, Map) else None)
    if isinstance(plant, Map) and plant.get("kind") not in registry.names("plants"):
        problems: list[Problem] = []
        # The error is in the plant, not in the model.
        read_component("plants", plant, ["plant"], problems, mark=plant.mark, access=access)
        if problems:
            raise ConfigError(problems)
    if not isinstance(plant, Map) or not isinstance(kind, str) or kind not in registry.names("models"):
        message = f"there is no model of kind {kind!r}; give one of {', '.join(registry.names('models'))}"
        raise ConfigError([Problem(*locate(model, ["from"]), "model.from", message)])
    known = {field.alias or name for name, field in model_of("models", kind).model_fields.items()}
    base = Map({"kind": kind}, mark=model.mark)
    for key, value in plant.items():
        if key in known:
            base.put(key, value, plant.key_marks.get(key, plant.mark), plant.value_marks.get(key, plant.mark))
    return merge(base, own)
