"""Colours of figures and pages: names of CSS variables with their values on a light and on a dark ground.

matplotlib draws with the colours of `PRINT`, which PDF, PNG and PGF keep.  An SVG has the variables in their place.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

LIGHT: Mapping[str, str] = {
    "bg": "#ffffff",
    "fg": "#1b1f24",
    "dim": "#59636e",
    "line": "#d0d7de",
    "soft": "#f3f5f7",
    "band": "#e4e8ec",
    "better": "#0b5cad",
    "worse": "#a34700",
    "fail": "#8a0f3c",
    "m1": "#1177aa",
    "m2": "#cc4400",
    "m3": "#9900ff",
    "m4": "#660000",
    "m5": "#112288",
    "m6": "#996666",
    "m7": "#442244",
}
"""The seven colours of methods can be distinguished by readers with protan, deutan and tritan vision."""
DARK: Mapping[str, str] = {
    "bg": "#14171a",
    "fg": "#e6e9ec",
    "dim": "#a3adb8",
    "line": "#3a424a",
    "soft": "#1d2226",
    "band": "#2b3238",
    "better": "#7cb8f5",
    "worse": "#f0a35e",
    "fail": "#f58ab0",
    "m1": "#4499bb",
    "m2": "#cc7a22",
    "m3": "#bb66ff",
    "m4": "#ffdd00",
    "m5": "#77ffee",
    "m6": "#999977",
    "m7": "#ccff99",
}
PRINT: Mapping[str, str] = {**LIGHT, "fg": "#000000"}
"""Colours that matplotlib draws with; each stands for one variable."""
METHODS = tuple(PRINT[f"m{number}"] for number in range(1, 8))
INK, GROUND, DIM, LINE, BAND = (PRINT[name] for name in ("fg", "bg", "dim", "line", "band"))
FIXED_INK, FIXED_GROUND = "#010101", "#fefefe"
"""Black and white on an area whose colour is the same on a light and on a dark ground."""


def in_css(colour: str) -> str:
    """Return the variable that stands for a colour of `PRINT`; any other colour stays as it is."""
    name = _NAMES.get(colour)
    return "currentColor" if name == "fg" else f"var(--{name})" if name else colour


_NAMES = {colour: name for name, colour in PRINT.items()}


def css_variables(ground: Mapping[str, str], names: Collection[str] | None = None) -> str:
    """Return the declarations of a ground, `LIGHT` or `DARK`, such as ``--m1:#1177aa``; all if no names are given."""
    return ";".join(f"--{name}:{value}" for name, value in ground.items() if names is None or name in names)
