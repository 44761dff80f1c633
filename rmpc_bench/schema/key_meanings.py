"""Meaning of every key of a component, from the numpydoc sections of its design function or class."""

from __future__ import annotations

import inspect
from typing import Any


def key_meanings(design: Any) -> dict[str, str]:
    """Return the meaning of every documented parameter; a class has those of its base classes too."""
    documented = reversed(design.__mro__) if inspect.isclass(design) else (design,)
    return {key: text for each in documented for key, text in meanings_in(inspect.getdoc(each) or "").items()}


def meanings_in(doc: str) -> dict[str, str]:
    r"""Return the meaning of every parameter in a numpydoc section.

    Examples
    --------
    >>> meanings_in("Parameters\n----------\nc : radius of the ball\nHp, Hu : horizons\n    [samples]")
    {'c': 'radius of the ball', 'Hp': 'horizons [samples]', 'Hu': 'horizons [samples]'}
    """
    meanings: dict[str, str] = {}
    names: list[str] = []
    for line in doc.split("\n"):
        head, colon, text = line.partition(" : ")
        if colon and not line.startswith(" "):
            names = head.split(", ")
            meanings |= dict.fromkeys(names, text)
        elif names and line.startswith("    "):
            meanings |= {name: f"{meanings[name]} {line.strip()}" for name in names}
        elif not line.strip():
            names = []
    return meanings
