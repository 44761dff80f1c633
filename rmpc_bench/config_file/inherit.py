"""Stage 2, inherit: overrides replace values, and the contents of a file replace its name in ``plant.from``.

``plant: {from: FILE, ..}`` is the plant of another configuration, in which the keys given here replace values.  The
`model`, `noise`, `initial` and `reference` of that file are used if this configuration has none.  All files are read
here, so that later stages depend on no file and the resolved configuration loads from any directory.  The methods of a
grid are written out.
``model: {from: plant, ..}`` has the parameters of the plant except for those given there.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config_file.component import read_component
from rmpc_bench.config_file.extends import GivenConfig, read_named, with_methods
from rmpc_bench.config_file.keys import model_of, shown
from rmpc_bench.config_file.method_grid import with_grid
from rmpc_bench.config_file.tree import Items, Map, Mark, Problems, assign, locate, merge, split, with_kind
from rmpc_bench.config_file.yaml import Override
from rmpc_bench.types import ConfigError, Problem

SECTIONS_OF_A_PLANT = ("model", "noise", "initial", "reference", "input")
"""Sections of the file that a plant comes from, which hold where a configuration has none."""

FILE = "file"  # key beside the sections of a file that has been read: its name as given

PATH = "plant.from"


def inherit(source: GivenConfig) -> Map:
    """Return the tree of a configuration with overrides, files and added methods in place.

    Overrides that name a file are laid first, the others after the files have been read, so that they can replace
    values of these files.  Raises a ConfigError if an override does not fit the tree, or a file cannot be read, has no
    plant, or includes itself.
    """
    problems = Problems(source.problems)
    naming = [override for override in source.overrides if _names_a_file(override)]
    others = [override for override in source.overrides if override not in naming]
    tree = _override(source.tree, naming, problems)
    if not problems:
        tree = _FileReader(source.path, (), problems).read_all(tree)
    tree = _override(tree, others, problems)
    tree = problems.tried(with_grid, tree) or tree
    tree = problems.tried(with_methods, tree, source.added) or tree
    problems.stop()
    return tree


def _names_a_file(override: Override) -> bool:
    steps = split(override.path, override.mark)
    return steps[0] == "sweep" or steps in (["plant"], ["plant", "from"])


def _override(tree: Map, overrides: Sequence[Override], problems: Problems) -> Map:
    """Replace values; an override that does not fit the tree adds to the problems."""
    for path, value, mark in overrides:
        tree = problems.tried(assign, open_section(tree, path), path, value, mark) or tree
    return tree


class _FileReader:
    """Replaces the files that a configuration names by their sections; one that cannot be used adds to the problems."""

    def __init__(self, path: Path, including: tuple[Path, ...], problems: Problems) -> None:
        self.path, self.problems = path, problems
        self.including = (*including, path.resolve())  # this file and those that led to it

    def read_all(self, tree: Map) -> Map:
        """Read the files that plant and sweep of the configuration name, relative to its own file."""
        result = tree.copy()
        plant, sweep = tree.get("plant"), tree.get("sweep")
        if isinstance(plant, Map):
            result["plant"] = self._replaced(plant, "from")
        if isinstance(sweep, Map):
            result["sweep"] = sweep.copy()
            for kind in ("grid", "zip"):
                if isinstance(sweep.get(kind), Map | Items):
                    result["sweep"][kind] = self._swept(sweep[kind])
        return result

    def _swept(self, node: Map | Items) -> Map | Items:
        """Read the files that a grid or a zip names."""
        if isinstance(node, Items):
            return node.like(self._replaced(row, PATH) if isinstance(row, Map) else row for row in node)
        values, result = node.get(PATH), node.copy()
        if isinstance(values, Map):
            for name in values:
                result[PATH] = self._replaced(result[PATH], name)
        elif isinstance(values, Items):
            result[PATH] = values.like(self._sections(each, locate(values, [i])) for i, each in enumerate(values))
        return result

    def _replaced(self, tree: Map, key: str) -> Map:
        result = tree.copy()
        if key in tree:
            result[key] = self._sections(tree[key], locate(tree, [key]))
        return result

    def _sections(self, text: Any, mark: Mark) -> Any:
        """Return the sections that a plant brings along; what is no name of a file that can be used as it is."""
        return text if not isinstance(text, str) else self.problems.tried(self._read, text, mark) or text

    def _read(self, text: str, mark: Mark) -> Map:
        """Return the sections of a file; a ConfigError where it cannot be used."""
        file, tree = read_named(PATH, text, mark, mark.directory(self.path), self.including)
        if not isinstance(tree, Map) or not isinstance(tree.get("plant"), Map):
            raise ConfigError([Problem(*mark, PATH, f"{text}: has no plant")])
        problems, without_sweep = Problems(), tree.like({key: tree[key] for key in tree if key != "sweep"})
        tree = _FileReader(file, self.including, problems).read_all(without_sweep)
        problems.stop()
        tree = lay_over_source(tree)
        sections = Map({FILE: text}, mark=mark)
        for key in ("plant", *SECTIONS_OF_A_PLANT):
            if key in tree:
                sections.take(tree, key)
        return sections


def compose(tree: Map, access: CodeAccess = NO_ACCESS) -> Map:
    """Lay what is given here over the plant, the sections and the models that come from elsewhere.

    The tree has its files read, and no sweep.  Raises a ConfigError if ``from`` is not a file, or models come from
    anything but a plant with a design model.
    """
    laid, problems = lay_over_source(tree), Problems()

    def with_model(part: Any) -> Any:
        model = part.get("model") if isinstance(part, Map) else None
        if not isinstance(model, Map) or "from" not in model:
            return part
        result = part.copy()
        result["model"] = problems.tried(_model_of_plant, laid, model, access)
        return result

    result: Map = with_model(laid).copy()
    methods = result.get("methods")
    if isinstance(methods, Map):
        result["methods"] = methods.like({name: with_model(own) for name, own in methods.items()})
    problems.stop()
    return result


def lay_over_source(tree: Map) -> Map:
    """Lay a plant over the one of its file, with the sections that are missing; a ConfigError if it names no file."""
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
            result.take(source, key)
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
    result.take(source, key)
    return result


def has_source(tree: Map) -> bool:
    """Whether the plant or a model, of all methods or of one, comes from elsewhere."""
    own = [method.get("model") for method in (tree.get("methods") or {}).values() if isinstance(method, Map)]
    return any(isinstance(part, Map) and "from" in part for part in (tree.get("plant"), tree.get("model"), *own))


def _model_of_plant(tree: Map, model: Map, access: CodeAccess) -> Map:
    """Lay a model over the parameters of the plant."""
    own, plant = model.copy(), with_kind("plants", tree.get("plant"))
    if own.pop("from") != "plant":
        message = f"must be 'plant' (got {shown(model['from'])})"
        raise ConfigError([Problem(*locate(model, ["from"]), "model.from", message)])
    kind = own.get("kind", plant.get("kind") if isinstance(plant, Map) else None)
    if isinstance(plant, Map) and plant.get("kind") not in registry.names("plants"):
        # The error is in the plant, not in the model.
        read_component("plants", plant, ["plant"], mark=plant.mark, access=access)
    if not isinstance(plant, Map) or not isinstance(kind, str) or kind not in registry.names("models"):
        message = f"there is no model of kind {kind!r}; give one of {', '.join(registry.names('models'))}"
        raise ConfigError([Problem(*locate(model, ["from"]), "model.from", message)])
    known = {field.alias or name for name, field in model_of("models", kind).model_fields.items()}
    base = Map({"kind": kind}, mark=model.mark)
    for key in plant:
        if key in known:
            base.take(plant, key)
    if _has_delay(tree.get("noise")):
        base.put("delay", "same", *model.places("from"))
    return merge(base, own)


def _has_delay(noise: Any) -> bool:
    """Whether a law of the noise is a delay, which a model with the parameters of the plant has, too."""
    if isinstance(noise, Map):
        return "delayed" in noise or any(map(_has_delay, noise.values()))
    return isinstance(noise, Items) and any(map(_has_delay, noise))
