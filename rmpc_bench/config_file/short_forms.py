"""Short forms of the kind of a component: ``file: tanks.py:MHE``, ``ode: tanks.py:rhs``, ``linearise: plant``.

A component whose kind is written in a short form gets the key `kind` before it is merged with a default, so that
another form replaces the default as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rmpc_bench.config_file.tree import Map, locate, locate_key

FILE = "file"
"""Key that stands for `kind` in a component from a Python file."""

SHORT_FORMS: Mapping[str, tuple[str, ...]] = {
    "plants": ("ode", "casadi", "data", "env", "control", "scipy", "fmu"),
    "models": ("linearise", "nonlinear", "ode", "control", "scipy"),
}
"""Group -> kinds that may stand as a key; their keys of the same name are keys of these kinds."""


def with_kind(group: str, tree: Any) -> Any:
    """Return a component with its kind under `kind`; a tree of which no single kind is given is returned as it is."""
    if not isinstance(tree, Map) or "kind" in tree:
        return tree
    forms = given_forms(group, tree)
    if len(forms) != 1:
        return tree
    form, result = forms[0], tree.copy()
    if form == FILE and not (group == "inputs" and names_data(tree[FILE])):
        kind = result.pop(FILE)
        result.put("kind", kind, locate_key(tree, [FILE]), locate(tree, [FILE]))
    else:
        result.put("kind", form, locate_key(tree, [form]), locate_key(tree, [form]))
    return result


def names_data(text: Any) -> bool:
    """Whether a text names files of data and not of code.

    Examples
    --------
    >>> names_data("u.csv"), names_data("signals.py:Chirp")
    (True, False)
    """
    return isinstance(text, str) and ".py" not in text


def kind_of(data: Mapping[str, Any]) -> str:
    """Return the kind, or the file and name, of a component as plain data.

    Examples
    --------
    >>> kind_of({"file": "tanks.py:MHE", "Ne": 6})
    'tanks.py:MHE'
    """
    return str(data[FILE] if FILE in data and "kind" not in data else data["kind"])


def given_forms(group: str, tree: Map) -> list[str]:
    """Return the short forms that stand in a component."""
    return [form for form in (FILE, *SHORT_FORMS.get(group, ())) if form in tree]
