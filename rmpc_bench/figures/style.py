"""The look of every figure: small type, colours that a colour-blind reader can tell apart, the same bytes each time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib

RED, BLUE, GREY = "#d7191c", "#0b5ba8", "#d9d9d9"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Of lines, one per method: the palette of Okabe and Ito."""
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
    """Draw with our parameters on top of matplotlib's own, whatever the user's matplotlibrc says."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield
