"""Fonts of figures: which family stands for a choice, and which families stand in for it in a browser."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from rmpc_bench.types.report_choices import Font

DEJAVU, STIX = "DejaVu Sans", "STIXGeneral"  # both come with matplotlib
TIMES = ("Times New Roman", "Nimbus Roman", "TeX Gyre Termes", "Tinos", "Liberation Serif", "FreeSerif")
"""Times and fonts with the same widths, the best first."""
SANS_INSTEAD = ("Verdana", "Geneva", "sans-serif")
"""Where DejaVu Sans is missing: as wide (Verdana), or narrower."""
SERIF_INSTEAD = ("Times New Roman", "Times", "Liberation Serif", "STIX Two Text", "serif")
TRUETYPE = (".ttf", ".ttc")
"""Endings of files that are embedded in PDF as Type 42."""


@cache
def family_of(font: Font) -> str:
    """Return the family that texts are set in; ``times`` is the first of `TIMES` installed as TrueType, else STIX."""
    if font == "times":
        return next(filter(_is_installed, TIMES), STIX)
    return DEJAVU if font == "dejavu" else STIX


def remark_on(font: Font) -> str:
    """Say that another font is taken in place of a missing one; empty where the font is there."""
    if font != "times" or family_of(font) != STIX:
        return ""
    return f"no Times font is installed as TrueType (looked for {', '.join(TIMES)}): the figures have STIX"


def families(name: str) -> tuple[str, ...]:
    """Return a family, or a font of matplotlib for formulas, and what a browser may take where it is missing."""
    instead = SANS_INSTEAD if name.startswith("DejaVu Sans") else SERIF_INSTEAD
    first = (name, DEJAVU) if name.startswith("DejaVu Sans ") else (name,)
    return tuple(dict.fromkeys((*first, *instead)))


@cache
def complete_fonts() -> None:
    """Put matplotlib's own fonts first in its list of fonts.

    The list is a file that all processes of a user share.  One of them may have written it without these fonts, and
    the letters of formulas are then those of another font in every figure from then on.
    """
    import matplotlib
    from matplotlib.font_manager import fontManager

    own = {str(path) for path in Path(matplotlib.get_data_path(), "fonts", "ttf").glob("*.ttf")}
    for missing in sorted(own - {entry.fname for entry in fontManager.ttflist}):
        fontManager.addfont(missing)
    fontManager.ttflist.sort(key=lambda entry: entry.fname not in own)


def _is_installed(family: str) -> bool:
    from matplotlib.font_manager import FontProperties, findfont

    try:
        return str(findfont(FontProperties(family=family), fallback_to_default=False)).lower().endswith(TRUETYPE)
    except ValueError:
        return False
