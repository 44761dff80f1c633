"""Groups of a method in an SVG, by which a page hides all that belongs to the method: areas, bars, marks and texts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.legend import Legend


@contextmanager
def grouped(axes: Axes, gid: str | None) -> Iterator[None]:
    """Give `LineStyle.gid` of a method to all that is drawn into a panel meanwhile and has no group."""
    before = {id(each) for each in axes.get_children()}
    yield
    for each in axes.get_children():
        if id(each) not in before and each.get_gid() is None:
            each.set_gid(gid)


def name_entries(legend: Legend, samples: Sequence[Artist]) -> None:
    """Put the drawn copies of samples in a legend, and their labels, into the groups of the given samples."""
    for given, shown, text in zip(samples, legend.legend_handles, legend.get_texts(), strict=True):
        if (gid := given.get_gid()) is not None:
            text.set_gid(gid)
            if shown is not None:
                shown.set_gid(gid)
