"""Sections of a plant from another file: ``plant: {from: FILE}`` and ``model: {from: plant}``, after files are read.

The keys given next to ``from`` replace those of the plant of the file.  ``model: {from: plant, ..}`` has the parameters
of the plant except for those given there.
"""

from __future__ import annotations

from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config_file.component import read_component
from rmpc_bench.config_file.key_errors import shown
from rmpc_bench.config_file.schema import model_of
from rmpc_bench.config_file.short_forms import with_kind
from rmpc_bench.config_file.tree import Map, locate, merge
from rmpc_bench.types import ConfigError, Problem

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
