"""Pictures of a part, read back from the artists."""

import numpy as np
import pytest

from rmpc_bench.report.figures import FORMATS, portrait, save_as
from rmpc_bench.types import Line, Panel

PANELS = (
    Panel("one", "$x$ [m]", "costs 5$", (Line("up", np.arange(3.0), np.array([0.0, np.nan, 2.0])),)),
    Panel("two", "t", "y", (Line("up", np.arange(2.0), np.ones(2)), Line("down", np.zeros(2), np.array([-1.0, 1.0])))),
)


def test_panels_are_drawn_as_they_are():
    """Every line, each panel on its own axes; a legend with every label once."""
    figure = portrait(PANELS)
    for axes, panel in zip(figure.axes, PANELS, strict=True):
        assert (axes.get_title(), axes.get_xlabel()) == (panel.title, panel.x_label)
        for drawn, line in zip(axes.lines, panel.lines, strict=True):
            assert np.array_equal(drawn.get_xdata(), line.x)
            assert np.array_equal(drawn.get_ydata(), line.y, equal_nan=True)
    assert figure.axes[0].get_ylabel() == r"costs 5\$"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["up", "down"]


@pytest.mark.parametrize("ending", FORMATS)
def test_same_bytes_in_every_format(tmp_path, ending):
    """No date, no version; the ending may be in capitals."""
    files = [tmp_path / f"one{ending}", tmp_path / f"other{ending.upper()}"]
    for file in files:
        save_as(portrait(PANELS), file)
    one, other = (file.read_bytes() for file in files)
    assert one == other
    assert not any(word in one for word in (b"matplotlib.org", b"Matplotlib v", b"CreationDate", b"dc:date"))
