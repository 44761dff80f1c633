"""Configurations made from others: ``plant.from: FILE`` and ``model: {from: plant}``.

``plant: {from: FILE, ..}`` is the plant of another configuration with the keys given here laid over it; that file's
`model`, `noise`, `initial` and `reference` hold too where this one has none.  Files are read first, all at once, and
take the place of their names; so what a configuration means does not depend on files any more, and its resolved form
can be read anywhere.  ``model: {from: plant, ..}`` believes the plant's parameters but for those given here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rmpc_bench import registry
from rmpc_bench.config import reader
from rmpc_bench.config.component import read_component
from rmpc_bench.config.reader import Items, Map, Mark, locate, merge
from rmpc_bench.config.schema import model_of, shown
from rmpc_bench.types import ConfigError, Problem

TAKEN = ("model", "noise", "initial", "reference")
"""Sections of the file that a plant comes from, which hold where this one has none."""

FILE = "file"
"""Key beside the sections of a file that has been read: its name as given."""

PATH = "plant.from"


def inlined(tree: Map, path: Path, seen: tuple[Path, ...] = ()) -> Map:
    """Read the files that plants come from, the swept ones too.

    Parameters
    ----------
    tree : a configuration
    path : where it was read from; names of files are relative to its directory
    seen : the files on the way here

    Raises
    ------
    ConfigError
        If a file cannot be read, has no plant, or comes from itself.
    """
    seen = (*seen, path.resolve())
    result = tree.copy()
    plant = tree.get("plant")
    if isinstance(plant, Map) and isinstance(plant.get("from"), str):
        result["plant"] = _replaced(plant, "from", path, seen)
    sweep = tree.get("sweep")
    if isinstance(sweep, Map):
        result["sweep"] = sweep.copy()
        for kind in ("grid", "zip"):
            if isinstance(sweep.get(kind), Map | Items):
                result["sweep"][kind] = _swept(sweep[kind], path, seen)
    return result


def _swept(node: Any, path: Path, seen: tuple[Path, ...]) -> Any:
    """Read the files that a grid or a zip names."""
    if isinstance(node, Items):  # rows, each with a value of its own
        rows = [
            _replaced(row, PATH, path, seen) if isinstance(row, Map) and isinstance(row.get(PATH), str) else row
            for row in node
        ]
        return Items(rows, mark=node.mark, value_marks=node.value_marks)
    if PATH not in node:
        return node
    values, found = node[PATH], node.copy()
    if isinstance(values, Map):
        found[PATH] = values.copy()
        for name, text in values.items():
            if isinstance(text, str):
                found[PATH] = _replaced(found[PATH], name, path, seen)
    elif isinstance(values, Items):
        marks = [locate(values, [number]) for number in range(len(values))]
        items = [
            _sections(text, mark, path, seen) if isinstance(text, str) else text
            for text, mark in zip(values, marks, strict=True)
        ]
        found[PATH] = Items(items, mark=values.mark, value_marks=marks)
    return found


def _replaced(tree: Map, key: str, path: Path, seen: tuple[Path, ...]) -> Map:
    found = tree.copy()
    found[key] = _sections(tree[key], locate(tree, [key]), path, seen)
    return found


def _sections(text: str, mark: Mark, path: Path, seen: tuple[Path, ...]) -> Map:
    """Read a file and keep what a plant brings along."""
    file = path.parent / text
    if not text.strip():
        raise ConfigError([Problem(*mark, PATH, f"must be the name of a configuration (got {shown(text)})")])
    if file.resolve() in seen:
        raise ConfigError([Problem(*mark, PATH, f"{text}: comes from itself")])
    try:
        tree = reader.load(file)
    except ConfigError as error:
        problems = [Problem(*mark, PATH, f"{each.file}: {each.message}") for each in error.problems]
        raise ConfigError(error.problems if file.is_file() else problems) from None
    if not isinstance(tree, Map) or not isinstance(tree.get("plant"), Map):
        raise ConfigError([Problem(*mark, PATH, f"{text}: has no plant")])
    tree = Map({key: tree[key] for key in tree if key != "sweep"}, mark=tree.mark, key_marks=tree.key_marks,
               value_marks=tree.value_marks)  # fmt: skip
    tree = _based(inlined(tree, file, seen))
    found = Map({FILE: text}, mark=mark)
    for key in ("plant", *TAKEN):
        if key in tree:
            found.put(key, tree[key], tree.key_marks.get(key, mark), tree.value_marks.get(key, mark))
    return found


def opened(tree: Map, path: str) -> Map:
    """Let a path lead into a section that comes along with the plant: the section, whole, then stands in the tree.

    Parameters
    ----------
    tree : a configuration whose files have been read
    path : of what is to be set
    """
    key, _, rest = path.partition(".")
    plant = tree.get("plant")
    source = plant.get("from") if isinstance(plant, Map) else None
    if not rest or key not in TAKEN or key in tree or not isinstance(source, Map) or key not in source:
        return tree
    result = tree.copy()
    result.put(key, source[key], source.key_marks.get(key, source.mark), locate(source, [key]))
    return result


def composed(tree: Map) -> Map:
    """Lay what is given here over what comes from elsewhere; ConfigError where that makes no sense."""
    tree = _based(tree).copy()
    if _from_plant(tree.get("model")):
        tree["model"] = _believed(tree, tree["model"])
    methods = tree.get("methods")
    if isinstance(methods, Map):
        tree["methods"] = methods.copy()
        for name, own in methods.items():
            if isinstance(own, Map) and _from_plant(own.get("model")):
                tree["methods"][name] = own.copy()
                tree["methods"][name]["model"] = _believed(tree, own["model"])
    return tree


def comes_from(tree: Map) -> bool:
    """Whether a plant or a model, of all methods or of one, comes from elsewhere."""
    own = [method.get("model") for method in (tree.get("methods") or {}).values() if isinstance(method, Map)]
    return any(isinstance(part, Map) and "from" in part for part in (tree.get("plant"), tree.get("model"), *own))


def _based(tree: Map) -> Map:
    """Lay a plant over the one it comes from."""
    plant = tree.get("plant")
    if not isinstance(plant, Map) or "from" not in plant:
        return tree
    source, own = plant["from"], plant.copy()
    del own["from"]
    if not isinstance(source, Map) or not isinstance(source.get("plant"), Map):
        message = f"must be the name of a configuration (got {shown(source)})"
        raise ConfigError([Problem(*locate(plant, ["from"]), PATH, message)])
    result = tree.copy()
    result["plant"] = merge(source["plant"], own)
    law = own.get("uncertainty")
    if isinstance(law, Map) and "law" in law:
        result["plant"]["uncertainty"] = law  # as another kind would be: bounds of one law mean nothing to another
    for key in TAKEN:
        if key in source and key not in tree:
            result.put(key, source[key], source.key_marks.get(key, source.mark), locate(source, [key]))
    return result


def _from_plant(model: Any) -> bool:
    return isinstance(model, Map) and "from" in model


def _believed(tree: Map, model: Map) -> Map:
    """Lay a model over the plant's parameters."""
    own, plant = model.copy(), tree.get("plant")
    if own.pop("from") != "plant":
        message = f"a model comes from the plant or from nowhere (got {shown(model['from'])})"
        raise ConfigError([Problem(*locate(model, ["from"]), "model.from", message)])
    kind = own.get("kind", plant.get("kind") if isinstance(plant, Map) else None)
    if isinstance(plant, Map) and plant.get("kind") not in registry.names("plants"):
        problems: list[Problem] = []
        read_component("plants", plant, ["plant"], problems, mark=plant.mark)  # the plant's mistake, not the model's
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
