"""Recorded runs, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import FillBetweenPolyCollection

from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.figures.files import save
from rmpc_bench.figures.style import COLOURS, REFERENCE
from rmpc_bench.figures.trajectories import Trajectories
from rmpc_bench.types import DesignError


def trajectories(trials, **keys):
    return Trajectories(**keys).draw(trials)


TWO = {"mse": {"A": [1.0] * 50, "B": [2.0] * 50}}


def drawn(figure, panel, color):
    """Lines of a panel with a colour, those below first."""
    lines = [line for line in figure.axes[panel].lines if line.get_color() == color]
    return sorted(lines, key=lambda line: line.get_zorder())


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def held(u):
    """An input with its value at the end of the last period."""
    return np.append(u, u[-1])


def test_one_run_is_drawn_as_it_is(make_trials, record):
    """Lines for y, steps for u, the reference dashed; no title needed."""
    trials = record(make_trials(TWO, labels={"B": "robust, $c=1$"}), {"A": 1, "B": 1})
    figure = trajectories(trials)
    t = 0.5 * np.arange(41)
    for color, method in zip(COLOURS, "AB", strict=False):
        (y,), (u,) = drawn(figure, 0, color), drawn(figure, 1, color)
        signals = trials.traces[method].signals
        assert np.array_equal(y.get_xdata(), t) and np.array_equal(y.get_ydata(), signals["y"][0, :, 0])
        assert np.array_equal(u.get_xdata(), t) and np.array_equal(u.get_ydata(), held(signals["u"][0, :, 0]))
        assert (y.get_drawstyle(), u.get_drawstyle()) == ("default", "steps-post")
    (reference,) = drawn(figure, 0, REFERENCE)
    assert np.array_equal(reference.get_ydata(), trials.traces["A"].r[:, 0]) and reference.get_linestyle() == "--"
    assert drawn(figure, 1, REFERENCE) == []
    assert [axes.get_ylabel() for axes in figure.axes] == ["$y$ [rad]", "$u$ [V]"]
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "$t$ [s]"]
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim() == (0, 20)
    assert legend(figure) == ["A", "robust, $c=1$", "reference"] and figure.axes[0].get_title() == ""


def test_several_runs_are_median_and_band(make_trials, record):
    """The quantiles of numpy over the runs, at every sample; a single run thin."""
    trials = record(make_trials(TWO), {"A": 50, "B": 50})
    figure = trajectories(trials)
    for panel, name in enumerate(("y", "u")):
        values = trials.traces["B"].signals[name][:, :, 0]
        thin, thick = drawn(figure, panel, COLOURS[1])
        shown = thick.get_ydata() if name == "y" else thick.get_ydata()[:-1]
        assert np.array_equal(shown, np.quantile(values, 0.5, axis=0))
        single = thin.get_ydata() if name == "y" else thin.get_ydata()[:-1]
        assert np.array_equal(single, values[0]) and thin.get_linewidth() < thick.get_linewidth()
        bands = [one for one in figure.axes[panel].collections if isinstance(one, FillBetweenPolyCollection)]
        corners = bands[1].get_paths()[0].vertices
        for share in (0.05, 0.95):
            assert np.isin(np.quantile(values, share, axis=0), corners[:, 1]).all()
    assert figure.axes[0].get_title() == "median and 5\N{EN DASH}95 % band of 50 runs, thin: run 0"
    assert len(drawn(trajectories(trials, runs=3), 0, COLOURS[0])) == 4
    figure = trajectories(trials, runs=0)
    assert len(drawn(figure, 0, COLOURS[0])) == 1 and figure.axes[0].get_title().endswith("of 50 runs")


def test_bands_have_edges_on_request(make_trials, record):
    """At 5 and 95 %, thinner than the median; of a single run there is no band and no edge."""
    trials = record(make_trials(TWO), {"A": 50, "B": 50})
    values = trials.traces["B"].signals["y"][:, :, 0]
    low, high, median = drawn(trajectories(trials, runs=0, edges=True), 0, COLOURS[1])
    for line, share in ((low, 0.05), (high, 0.95)):
        assert np.array_equal(line.get_ydata(), np.quantile(values, share, axis=0))
        assert line.get_linewidth() < median.get_linewidth() and line.get_linestyle() == median.get_linestyle()
    one = record(make_trials(TWO), {"A": 1, "B": 1})
    assert len(drawn(trajectories(one, edges=True), 0, COLOURS[1])) == 1


@pytest.mark.parametrize("smooth", [True, False])
def test_steps_have_dashes_where_they_are_smooth(make_trials, record, smooth):
    """As in the legend; where they would be lost in rough steps, an earlier line is an edge about a later one."""
    trials = record(make_trials(TWO), {"A": 1, "B": 1})
    if smooth:
        for trace in trials.traces.values():
            trace.signals["u"][0, :, 0] = np.linspace(0.0, 5.0, 40) ** 2
    for signals in (["u"], ["y", "u"]):
        figure = trajectories(trials, signals=signals)
        (below,), (above,) = (drawn(figure, -1, color) for color in COLOURS[:2])
        assert below.get_drawstyle() == above.get_drawstyle() == "steps-post"
        assert below.get_linestyle() == "-" and (above.get_linestyle() == "--") == smooth
        assert (below.get_linewidth() > above.get_linewidth()) != smooth and below.get_zorder() < above.get_zorder()
        plain = not smooth and signals == ["u"]
        assert (figure.legends[0].get_lines()[1].get_linestyle() == "-") == plain


def test_a_signal_at_a_constant_is_smooth(make_trials, record):
    """It goes nowhere; nor does one without numbers."""
    for value in (3.0, np.nan):
        trials = record(make_trials(TWO), {"A": 1, "B": 1})
        for trace in trials.traces.values():
            trace.signals["u"][:] = value
        assert drawn(trajectories(trials), 1, COLOURS[1])[0].get_linestyle() == "--"


def test_methods_with_the_same_label(make_trials, record):
    """Each has its line in the legend; the reference one for all panels of y."""
    trials = record(make_trials(TWO, labels={"A": "MPC", "B": "MPC"}), {"A": 1, "B": 1})
    figure = trajectories(trials, signals=["y", "y.0"])
    assert legend(figure) == ["MPC", "MPC", "reference"]


def test_window(make_trials, record):
    """Both ends count, also where they are no multiple of the sampling time but for rounding."""
    trials = record(make_trials(TWO), {"A": 1, "B": 1}, Ts=0.1)
    figure = trajectories(trials, from_=0.3, to=0.7)
    (y,), (u,) = drawn(figure, 0, COLOURS[0]), drawn(figure, 1, COLOURS[0])
    signals = trials.traces["A"].signals
    assert np.array_equal(y.get_ydata(), signals["y"][0, 3:8, 0])
    assert np.array_equal(u.get_ydata(), signals["u"][0, 3:8, 0])
    assert np.allclose(y.get_xdata(), [0.3, 0.4, 0.5, 0.6, 0.7], rtol=1e-12)
    assert figure.axes[1].get_xlim() == pytest.approx((0.3, 0.7))
    (y,) = drawn(trajectories(trials, from_=3.9, to=99), 0, COLOURS[0])
    assert np.array_equal(y.get_ydata(), signals["y"][0, 39:, 0])


def test_signals_and_order(make_trials, record):
    """Components by their number, whole signals as one panel per component; a method keeps its colour."""
    trials = record(make_trials(TWO), {"A": 1, "B": 1})
    figure = trajectories(trials, signals=["x_hat.1", "x"], order=["B"])
    assert [axes.get_ylabel() for axes in figure.axes] == [r"$\hat{x}_1$", "$x_0$", "$x_1$", "$x_2$"]
    (first,) = drawn(figure, 0, COLOURS[1])
    assert np.array_equal(first.get_ydata(), trials.traces["B"].signals["x_hat"][0, :, 1])
    assert drawn(figure, 0, COLOURS[0]) == [] and legend(figure) == ["B"]
    only_y = {name: trace._replace(signals={"y": trace.signals["y"]}) for name, trace in trials.traces.items()}
    assert len(trajectories(replace(trials, traces=only_y)).axes) == 1


def test_failed_runs_do_not_count(make_trials, record):
    """Neither in median nor band; said above the panels."""
    trials = record(make_trials({"mse": {"A": [1.0] * 6, "B": ["diverged", *[2.0] * 5]}}), {"A": 6, "B": 6})
    trials.traces["B"].signals["y"][0] = np.nan
    figure = trajectories(trials)
    good = trials.traces["B"].signals["y"][1:, :, 0]
    assert np.array_equal(drawn(figure, 0, COLOURS[1])[1].get_ydata(), np.median(good, axis=0))
    title = figure.axes[0].get_title().replace("\n", " ")
    assert title == "median and 5\N{EN DASH}95 % band of 5 to 6 runs, thin: single runs, 1 failed"


@pytest.mark.parametrize("methods", ["AB", "B"])
def test_a_run_on_the_way_to_divergence(make_trials, record, tmp_path, methods):
    """It is drawn and named, no warning, and the others keep their scale."""
    trials = record(make_trials({"mse": {"A": [1.0], "B": ["diverged"]}}), {"A": 1, "B": 1})
    y, u = (trials.traces["B"].signals[name][0] for name in "yu")
    y[:, 0] = np.exp(10.0 * np.arange(41))
    y[30:], u[20:] = np.nan, 1e300
    figure = trajectories(trials, order=list(methods))
    assert "B (failed)" in legend(figure) and figure.axes[0].get_title() == "1 failed"
    assert (figure.axes[0].get_ylim()[1] < 10) == (methods == "AB")
    save(figure, tmp_path, "diverged")


def test_point_of_a_sweep(make_trials, make_sweep, record):
    """Chosen by `at`; the first one, and said so, without."""
    tables = [record(make_trials(TWO), {"A": 1, "B": 1}, seed=seed) for seed in (1, 2)]
    sweep = make_sweep(*zip([{"controller.Hp": "10 $"}, {"controller.Hp": "15"}], tables, strict=True))
    figure = trajectories(sweep, at={"controller.Hp": 15})
    (y,) = drawn(figure, 0, COLOURS[0])
    assert np.array_equal(y.get_ydata(), tables[1].traces["A"].signals["y"][0, :, 0])
    assert figure.axes[0].get_title() == "Hp=15"
    assert trajectories(sweep).axes[0].get_title() == r"Hp=10 \$ (first of 2 points)"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"signals": ["v"]}, "'v' is not recorded (recorded: y, u, x, x_hat)"),
        ({"signals": ["x.3"]}, "'x.3' is not a component (they count from x.0 to x.2)"),
        ({"signals": ["x.-1"]}, "'x.-1' is not a component (they count from x.0 to x.2)"),
        ({"signals": ["y."]}, "'y.' is not a component (they count from y.0 to y.0)"),
        ({"signals": []}, "must name at least one signal"),
        (
            {"signals": ["x", "x", "x"]},
            "9 panels do not fit into one figure (at most 8): choose components such as x.0",
        ),
        ({"order": ["D"]}, "'D' is not a known method; known: A, B, C"),
        ({"order": ["A", "C"]}, "no run of 'C' is recorded (recorded: A, B)"),
        ({"order": []}, "must name at least one method, and each one once"),
        ({"from_": 30.0}, "fewer than two samples lie between `from` and `to` (there are 0 to 20)"),
        ({"to": 0.0}, "fewer than two samples lie between `from` and `to` (there are 0 to 20)"),
        ({"at": {"controller.Hp": 1}}, "nothing is swept in this configuration"),
        ({"height": 0.1}, "must be at least 1 inch (got 0.1)"),
    ],
)
def test_errors_show_the_choices(make_trials, record, given, message):
    """A figure that cannot be drawn is left out with a reason."""
    trials = record(make_trials({"mse": {"A": [1.0], "B": [2.0], "C": [3.0]}}), {"A": 1, "B": 1})
    with pytest.raises(DesignError) as error:
        trajectories(trials, **given)
    assert str(error.value) == message and error.value.parameter in {name.rstrip("_") for name in given}


def test_nothing_recorded(make_trials, record):
    """The way out is a key of the configuration."""
    trials = make_trials({"mse": {"A": [1.0]}})
    for table in (trials, record(trials, {"A": 0})):
        with pytest.raises(DesignError, match=r"no run is recorded; record some with `record: \{runs: 1\}`"):
            trajectories(table)


@pytest.mark.parametrize("n", [2, 3, 7, 12])
def test_legend_covers_nothing(make_trials, record, n):
    """Short names, formulas, names wider than the picture: above the panels, inside the picture, no overlap."""
    names = [f"{i}" for i in range(n)]
    texts = ["S-MPC", "R-MPC1, $c=10^{-1}$", "robust model predictive control " * 3]
    for text in texts:
        labels = {name: f"{text} {name}" for name in names}
        table = make_trials({"mse": {name: [1.0, 2.0] for name in names}}, labels=labels)
        figure = trajectories(record(table, dict.fromkeys(names, 2)))
        box = figure.legends[0].get_window_extent()
        top = figure.axes[0].title.get_window_extent()
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 + 1
        assert top.y1 <= box.y0 and top.y0 >= figure.axes[0].get_window_extent().y1
        assert figure.bbox.x0 <= top.x0 and top.x1 <= figure.bbox.x1
        assert figure.axes[0].get_window_extent().height > 50  # points at 72 dpi, let alone at 100


def test_same_bytes(make_trials, record, tmp_path):
    """Drawn twice, saved twice."""
    trials = record(make_trials(TWO, labels={"A": "$c^2$"}), {"A": 20, "B": 20})
    paths = [save(trajectories(trials), tmp_path, stem) for stem in ("one", "other")]
    assert [path.read_bytes() for path in paths[0]] == [path.read_bytes() for path in paths[1]]
    assert b"dc:date" not in paths[0][0].read_bytes()


def test_keys():
    """As a configuration writes them."""
    text = "{signals: [y, x_hat.2], from: 2, to: 2*5, runs: 3, order: [A], at: {controller.Hp: 10, estimator: kalman}}"
    problems = []
    keys = validate(model_of("figures", "trajectories"), parse(text, "f.yaml"), [], problems)
    assert not problems and (keys.from_, keys.to, keys.runs) == (2, 10, 3)
    assert keys.signals == ["y", "x_hat.2"] and keys.at == {"controller.Hp": 10, "estimator": "kalman"}
    validate(model_of("figures", "trajectories"), parse("{from: -1, runs: 11}", "f.yaml"), [], problems)
    assert [str(problem).split(": ", 1)[1] for problem in problems] == [
        "from: must be >= 0 (got -1)",
        "runs: must be <= 10 (got 11)",
    ]
