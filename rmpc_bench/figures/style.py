"""Style of all figures: palette, fonts, and settings of matplotlib for reproducible files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

RED, BLUE, GREY = "#d7191c", "#0b5ba8", "#d9d9d9"
BLACK, WHITE = "#000000", "#ffffff"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Palette of the methods, by Okabe and Ito: a colour-blind reader can distinguish them."""
REFERENCE = "#7f7f7f"
FONT, FONT_SIZE = "DejaVu Sans", 8  # comes with matplotlib
STYLE: dict[Any, Any] = {
    "font.family": FONT,
    "font.size": FONT_SIZE,
    "axes.labelsize": FONT_SIZE,
    "axes.titlesize": FONT_SIZE,
    "xtick.labelsize": FONT_SIZE,
    "ytick.labelsize": FONT_SIZE,
    "legend.fontsize": FONT_SIZE,
    "axes.linewidth": 0.6,
    "axes.titlepad": 3.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "ytick.minor.width": 0.4,
    "svg.fonttype": "path",  # the same picture in every viewer
    "svg.hashsalt": "rmpc-bench",
}


@contextmanager
def style() -> Iterator[None]:
    """Draw with these settings on top of the defaults of matplotlib; the user's matplotlibrc has no effect."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield
