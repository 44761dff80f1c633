"""Enlarged panels, differences to the baseline, widths and patterns of bands, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import FillBetweenPolyCollection

from rmpc_bench.figures.files import save
from rmpc_bench.figures.style import COLOURS
from rmpc_bench.figures.trajectories import Trajectories
from rmpc_bench.figures.zoom import Zoom
from rmpc_bench.types import DesignError

TWO = {"mse": {"A": [1.0] * 20, "B": [2.0] * 20}}


def drawn(axes, color):
    return [line for line in axes.lines if line.get_color() == color]


@pytest.fixture
def coinciding(make_trials, record):
    """An input that jumps once, with small differences between the methods afterwards; y is the same for both."""

    def make(small=0.01, n=1):
        trials = record(make_trials(TWO), {"A": n, "B": n}, n_steps=70, Ts=0.1)
        for place, trace in enumerate(trials.traces.values()):
            u = trace.signals["u"]
            u[:] = 0.0
            u[:, :10] = 200.0
            u[:, 30:, 0] = small * (1 + place) * np.sin(np.arange(40))
            trace.signals["y"][:] = np.linspace(0.0, 1.0, 71)[:, None]
        return trials

    return make


def test_a_configured_zoom_is_a_panel_of_its_own(coinciding):
    """Its own limits; the part is marked in the panel of the signal."""
    figure = Trajectories(zoom=Zoom("u", 4.0, 6.0)).draw(coinciding())
    y, u, enlarged = figure.axes
    assert enlarged.get_xlim() == pytest.approx((4.0, 6.0)) and y.get_xlim() == u.get_xlim() == pytest.approx((0, 7))
    assert max(map(abs, enlarged.get_ylim())) < 0.05 < u.get_ylim()[1]
    assert enlarged.get_title(loc="left") == "enlarged" and len(u.patches) == 1 and not y.patches
    (line,) = drawn(enlarged, COLOURS[1])
    assert line.get_xdata()[0] == pytest.approx(4.0) and line.get_xdata()[-1] == pytest.approx(6.0)


@pytest.mark.parametrize(("small", "n_panels"), [(0.01, 3), (1e-9, 2), (100.0, 2)])
def test_an_automatic_zoom_where_curves_coincide(coinciding, small, n_panels):
    """Not where they differ by rounding only, nor where they differ on the scale of the panel."""
    trials = coinciding(small)
    assert len(Trajectories().draw(trials).axes) == n_panels
    assert len(Trajectories(zoom="none").draw(trials).axes) == 2
    assert len(Trajectories(order=["A"]).draw(trials).axes) == 2


def test_the_enlarged_panel_of_several_runs_shows_one_of_them(coinciding):
    """A median is smoother than any run."""
    trials = coinciding(n=20)
    for trace in trials.traces.values():
        trace.signals["u"][:, 30:, 0] *= np.linspace(0.5, 1.5, 20)[:, None]
    enlarged = Trajectories(zoom=Zoom("u", 4.0, 6.0)).draw(trials).axes[-1]
    (line,) = drawn(enlarged, COLOURS[1])
    assert np.array_equal(line.get_ydata()[:-1], trials.traces["B"].signals["u"][0, 40:60, 0])
    assert enlarged.get_title(loc="left") == "enlarged, run 0"
    assert "run 0 of every method" in Trajectories(zoom=Zoom("u", 4.0, 6.0)).caption(trials)


@pytest.mark.parametrize(
    ("zoom", "key", "message"),
    [
        (Zoom("v", 1.0, 2.0), "zoom.signal", "'v' is not recorded (recorded: y, u, x, x_hat)"),
        (Zoom("x", 1.0, 2.0), "zoom.signal", "must be one component, such as x.0"),
        (Zoom("u", 2.0, 2.0), "zoom.from", "must be less than `to` (got 2 and 2)"),
    ],
)
def test_a_zoom_that_is_not_possible(coinciding, zoom, key, message):
    """The message names the key."""
    with pytest.raises(DesignError) as error:
        Trajectories(zoom=zoom).draw(coinciding())
    assert (error.value.parameter, str(error.value)) == (key, message)


def test_differences_are_those_of_the_same_run(make_trials, record):
    """Oracle: subtraction by hand, in the runs that both recorded and the baseline finished."""
    trials = record(make_trials({"mse": {"A": ["diverged", 1.0, 1.0], "B": [2.0] * 3}}), {"A": 3, "B": 3})
    b = trials.traces["B"]
    traces = {**trials.traces, "B": b._replace(runs=np.array([1, 2, 5]))}
    figure = Trajectories(difference=True, runs=0, zoom="none").draw(replace(trials, traces=traces))
    for axes, name in zip(figure.axes, "yu", strict=True):
        expected = b.signals[name][:2, :, 0] - trials.traces["A"].signals[name][1:, :, 0]
        (median,) = drawn(axes, COLOURS[1])
        values = median.get_ydata() if name == "y" else median.get_ydata()[:-1]
        np.testing.assert_allclose(values, np.median(expected, axis=0), rtol=1e-12)
        assert not drawn(axes, COLOURS[0])
    assert figure.axes[0].get_ylabel() == "\N{GREEK CAPITAL LETTER DELTA}$y$ [rad]"
    assert "difference to A" in figure.axes[0].get_title()
    assert "from A in paired runs" in Trajectories(difference=True).caption(trials)


def test_differences_need_another_method_and_a_shared_run(make_trials, record):
    """Each with a reason."""
    trials = record(make_trials(TWO), {"A": 2, "B": 2})
    with pytest.raises(DesignError, match="method besides the baseline 'A'"):
        Trajectories(difference=True, order=["A"]).draw(trials)
    failed = record(make_trials({"mse": {"A": ["diverged"] * 2, "B": [2.0] * 2}}), {"A": 2, "B": 2})
    with pytest.raises(DesignError, match="'B' and the baseline 'A' share no recorded run"):
        Trajectories(difference=True).draw(failed)
    alone = {"B": trials.traces["B"]}
    with pytest.raises(DesignError, match="no run of the baseline 'A' is recorded"):
        Trajectories(difference=True).draw(replace(trials, traces=alone))


def test_bands_of_several_methods_do_not_mix(make_trials, record):
    """The first is filled, the second has a pattern and no colour inside."""
    figure = Trajectories(zoom="none").draw(record(make_trials(TWO), {"A": 20, "B": 20}))
    first, second = (one for one in figure.axes[0].collections if isinstance(one, FillBetweenPolyCollection))
    assert first.get_hatch() is None and first.get_facecolor()[0][3] == 1.0
    assert second.get_hatch() == "////" and not len(second.get_facecolor())


def test_the_width_of_the_bands(make_trials, record, tmp_path):
    """Oracle: quantiles of numpy; the caption states the mean widths, and thin lines show them."""
    trials = record(make_trials(TWO), {"A": 20, "B": 20})
    figure = Trajectories(signals=["y"], width_of_band=True).draw(trials)
    (axes,) = figure.axes
    width, mean = drawn(axes, COLOURS[1])
    low, high = np.quantile(trials.traces["B"].signals["y"][:, :, 0], [0.05, 0.95], axis=0)
    np.testing.assert_allclose(width.get_ydata(), high - low, rtol=1e-12)
    assert mean.get_ydata()[0] == pytest.approx(np.mean(high - low), rel=1e-12)
    assert f"B {np.mean(high - low):.3g}" in Trajectories(signals=["y"], width_of_band=True).caption(trials)
    assert axes.get_ylabel() == "width of $y$ [rad]"
    one, other = (save(Trajectories(signals=["y"]).draw(trials), tmp_path, stem) for stem in ("one", "other"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]
