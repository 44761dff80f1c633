"""The boxplot, read back from its artists."""

import math
from dataclasses import replace

import matplotlib
import numpy as np
import pytest

from rmpc_bench.config.schema import model_of
from rmpc_bench.figures import style
from rmpc_bench.figures.boxes import MOST_CROSSES, box_of
from rmpc_bench.figures.boxplot import Boxplot
from rmpc_bench.figures.captions import runs_sentence
from rmpc_bench.figures.files import save
from rmpc_bench.types import DesignError, MetricInfo


def boxplot(trials, **keys):
    return Boxplot(**keys).draw(trials)


INF = math.inf


def lines(figure, panel=0, **wanted):
    """Return (x, y) of the lines of a panel that have these properties."""
    found = []
    for line in figure.axes[panel].lines:
        if all(getattr(line, f"get_{name}")() == value for name, value in wanted.items()):
            found.append(np.array(line.get_xydata()))
    return found


def boxes_of(figure, panel=0):
    """Return the corners of the boxes of a panel."""
    return [np.array(patch.get_path().vertices[:4]) for patch in figure.axes[panel].patches]


def labels(figure, panel=0):
    return [text.get_text() for text in figure.axes[panel].get_xticklabels()]


def brute_force(values):
    """Quartiles by interpolation on the sorted list, whiskers at the last values within 1.5 of their distance."""
    values = sorted(values)

    def at(share):
        place = share * (len(values) - 1)
        low = int(place)
        return values[low] + (place - low) * (values[min(low + 1, len(values) - 1)] - values[low])

    q25, median, q75 = at(0.25), at(0.5), at(0.75)
    inside = [value for value in values if q25 - 1.5 * (q75 - q25) <= value <= q75 + 1.5 * (q75 - q25)]
    outside = [value for value in values if value < inside[0] or value > inside[-1]]
    return q25, median, q75, inside[0], inside[-1], outside


def test_boxes_against_brute_force(make_trials):
    """Every artist of every method."""
    rng = np.random.default_rng(3)
    columns = {name: list(rng.standard_t(2, 101)) for name in "ABC"}
    figure = boxplot(make_trials({"mse": columns}))
    medians, boxes, outliers = lines(figure, color=style.BLACK), boxes_of(figure), lines(figure, marker="+")
    colours = [colour for colour in style.COLOURS[:3] for _ in range(4)]
    others = [line for line in figure.axes[0].lines if line.get_color() in colours and line.get_marker() != "+"]
    assert [line.get_color() for line in others] == colours
    # Two whiskers and two caps of each box.
    whiskers = [np.array(line.get_xydata()) for line in others if np.ptp(line.get_xdata()) == 0]
    assert len(medians) == len(boxes) == len(outliers) == 3 and len(whiskers) == 6
    for position, values in enumerate(columns.values(), start=1):
        q25, median, q75, low, high, outside = brute_force(values)
        box, line = boxes[position - 1], medians[position - 1]
        assert (box[:, 1].min(), box[:, 1].max(), line[0, 1]) == pytest.approx((q25, q75, median), rel=1e-12)
        assert box[:, 0].mean() == pytest.approx(position, abs=0.2) and line[:, 0].mean() == position
        ends = [whisker[1, 1] for whisker in whiskers if whisker[0, 0] == position]
        assert ends == [low, high]
        assert sorted(outliers[position - 1][:, 1]) == outside and outside
    assert labels(figure) == ["A", "B", "C"] and figure.axes[0].get_xlabel() == "n = 101 for all"


def test_failed_and_infinite(make_trials):
    """Infinite values lie above the others, as in the table; a method without a value leaves its place empty."""
    columns = {
        "A": [1.0, 2.0, 3.0, INF],
        "B": ["diverged"] * 4,
        "C": [INF] * 4,
        "D": [1.0, "diverged", "out-of-range", 2.0],
    }
    figure = boxplot(make_trials({"mse": columns}))
    assert labels(figure) == ["A\nn=4\n1 did not\noccur", "B\nno value\n0/4", "C\nn=4\n4 did not\noccur", "D\n2/4"]
    medians = lines(figure, color=style.BLACK)
    top = 3.0 + 0.16 * 2.0
    assert [(line[:, 0].mean(), line[0, 1]) for line in medians] == [(1, 2.5), (3, pytest.approx(top)), (4, 1.5)]
    assert figure.axes[0].get_xlim() == (0.5, 4.5)
    ticks = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert ticks[-1] == "did not\noccur" and figure.axes[0].get_yticks()[-1] == pytest.approx(top)
    assert figure.axes[0].get_ylim()[1] > top and len(boxes_of(figure)) == 4


@pytest.mark.parametrize("log", [False, True])
def test_a_method_that_rarely_settles_does_not_look_fast(make_trials, log):
    """Its quartiles are those of all runs: most of the box is in the strip of the runs that did not settle."""
    columns = {"A": [1.0, 2.0, 3.0, INF, INF, INF, INF], "B": [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, INF]}
    figure = boxplot(make_trials({"mse": columns}), log=log)
    (_, first), (_, second) = (line[0] for line in lines(figure, color=style.BLACK))
    strip = figure.axes[0].get_yticks()[-1]
    assert first == strip and second == pytest.approx(13.0)
    assert [line[:, 1].tolist() for line in lines(figure, marker="+")] == [[], [strip]]
    text = Boxplot(log=log).caption(make_trials({"mse": columns}))
    assert "lie in the grey strip, above every other value (A 4, B 1)" in text


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("values", [[INF, INF], ["diverged"], [1.0], [2.0, 2.0], [1e300, 1e308, 1.7e308], [1e-9, 1e9]])
def test_no_warning_on_odd_columns(make_trials, tmp_path, values, log):
    """Nothing finite, one value, equal values, the edges of floating point."""
    save(boxplot(make_trials({"mse": {"A": values}}), log=log), tmp_path, "odd")


def test_metric_order_size_and_log(make_trials):
    """The parameters a configuration may give."""
    infos = [MetricInfo("mse", "rad^2", "lower"), MetricInfo("input_power", "V^2*s^-1", "lower")]
    trials = make_trials({"mse": {"A": [1, 2], "B": [3, 4]}, "input_power": {"A": [5, 6], "B": [7, -8]}}, infos)
    figure = boxplot(trials)
    assert figure.axes[0].get_ylabel() == "MSE [rad$^{2}$]" and figure.axes[0].get_yscale() == "linear"
    figure = boxplot(trials, metric="input_power", order=["B"], width=5, height=3)
    assert figure.axes[0].get_ylabel() == "input power [V$^{2}$*s$^{-1}$]"
    assert (labels(figure), list(figure.get_size_inches())) == (["B"], [5, 3])
    assert boxplot(trials, log=True).axes[0].get_yscale() == "log"
    figure = boxplot(trials, metric="input_power", log=True)
    assert figure.axes[0].get_yscale() == "linear" and "linear" in figure.axes[0].get_ylabel()
    assert set(model_of("figures", "boxplot").model_fields) == {"metric", "width", "height", "log", "order", "at"}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"metric": "mae"}, "'mae' is not a known metric of this configuration; did you mean 'mse'?"),
        ({"order": ["A", "C"]}, "'C' is not a known method; known: A, B"),
        ({"order": ["A", "A"]}, "must name at least one method, and each one once"),
        ({"order": []}, "must name at least one method, and each one once"),
        ({"width": 0.0}, "must be at least 1 inch (got 0)"),
        ({"height": INF}, "must be at least 1 inch (got inf)"),
    ],
)
def test_errors_name_the_parameter(make_trials, given, message):
    """So that the message can point into the file."""
    with pytest.raises(DesignError) as error:
        boxplot(make_trials({"mse": {"A": [1.0], "B": [2.0]}}), **given)
    assert str(error.value) == message and error.value.parameter in given


@pytest.mark.parametrize(
    ("label", "shown"),
    [
        ("R, $c=10^{-1}$", "R, $c=10^{-1}$"),
        (r"R, $\frac{1$", r"R, \$\frac{1\$"),
        ("costs 5$", r"costs 5\$"),
        (r"$\nosuch$", r"\$\nosuch\$"),
        (r"5\$", r"5\$"),
        ("", ""),
        ("a_b^c {", "a_b^c {"),
    ],
)
def test_labels(make_trials, tmp_path, label, shown):
    """Formulas where they can be set, else the text as it is."""
    figure = boxplot(make_trials({"mse": {"A": [1.0, 2.0]}}, labels={"A": label}))
    assert labels(figure) == [shown] and figure.axes[0].get_xlabel() == "n = 2"
    save(figure, tmp_path, "labels")


def distances_along_the_axis(figure):
    """Distances between the ends of neighbouring labels, across the direction of their lines [pixels]."""
    places = [text.get_transform().transform(text.get_position())[0] for text in figure.axes[-1].get_xticklabels()]
    return np.diff(places) * math.sin(math.radians(45))


def test_wide_labels_are_broken_into_lines(make_trials):
    """At blanks outside formulas."""
    figure = boxplot(
        make_trials({"mse": {name: [1.0, 2.0] for name in "ABCD"}}, labels={"A": "robust MPC, $c = 10^{-1}$"})
    )
    assert labels(figure) == ["robust MPC,\n$c = 10^{-1}$", "B", "C", "D"]
    boxes = [text.get_window_extent() for text in figure.axes[0].get_xticklabels()]
    assert all(left.x1 <= right.x0 for left, right in zip(boxes, boxes[1:], strict=False))
    assert min(box.y0 for box in boxes) >= 0


def test_labels_that_cannot_be_broken_are_rotated(make_trials):
    """The picture becomes higher, and the lines keep a distance."""
    many = {f"method-number-{i}": [1.0, 2.0] for i in range(10)}
    figure = boxplot(make_trials({"mse": many}))
    texts = figure.axes[0].get_xticklabels()
    assert {text.get_rotation() for text in texts} == {45.0} and labels(figure) == [*many]
    assert figure.get_figheight() > 2.4 and figure.get_figwidth() == 3.5
    size = texts[0].get_fontsize() * figure.dpi / 72
    assert min(distances_along_the_axis(figure)) > size
    assert min(text.get_window_extent().y0 for text in texts) >= 0
    assert min(text.get_window_extent().x0 for text in texts) >= 0


@pytest.mark.parametrize("n", [4, 24])
def test_labels_that_would_be_taller_than_the_panel_are_numbers_with_a_key(make_trials, n):
    """A key below the panel has the labels, each with the colour of its box."""
    long = "a filter with a very long name, which nobody would want to read upright beside a panel"
    many = {f"M{i}": [1.0, 2.0] for i in range(n)}
    figure = boxplot(make_trials({"mse": many}, labels={f"M{i}": f"{long} {i}" for i in range(n)}), height=2.4)
    assert labels(figure) == [str(number) for number in range(1, n + 1)]
    (key,) = figure.legends
    texts = [" ".join(text.get_text().split()) for text in key.get_texts()]
    assert texts == [f"{number} {long} {number - 1}" for number in range(1, n + 1)]
    assert figure.axes[0].get_position().height * figure.get_figheight() > 1.0
    ticks = [text.get_window_extent() for text in figure.axes[0].get_xticklabels()]
    assert key.get_window_extent().y1 <= min(tick.y0 for tick in ticks) and key.get_window_extent().y0 >= 0


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        # The lower box would have 0.06 % of a linear axis.
        ({"A": [1.0, 1.1, 1.2, 1.3], "B": [150.0, 200.0, 230.0, 250.0]}, "log"),
        # Its quartiles are equal, so no axis makes it higher.
        ({"A": [1.0, 1.0, 1.0, 1.0], "B": [150.0, 200.0, 230.0, 250.0]}, "linear"),
        # The values differ by less than a factor of ten.
        ({"A": [1.0, 1.01, 1.02, 1.03], "B": [5.0, 6.0, 7.0, 8.0]}, "linear"),
        # Some value is not positive.
        ({"A": [0.0, 1.1, 1.2, 1.3], "B": [150.0, 200.0, 230.0, 250.0]}, "linear"),
        ({"A": [1.0, 2.0, 3.0, 4.0], "B": [5.0, 10.0, 15.0, 20.0]}, "linear"),
    ],
)
def test_the_axis_is_logarithmic_where_a_linear_one_would_flatten_boxes(make_trials, values, scale):
    """The rule of the docstring; `log: false` switches it off."""
    trials = make_trials({"mse": values})
    assert boxplot(trials).axes[0].get_yscale() == scale
    assert boxplot(trials, log=False).axes[0].get_yscale() == "linear"
    assert ("logarithmic" in Boxplot().caption(trials)) == (scale == "log")


def test_the_caption_defines_every_mark_and_states_the_numbers(make_trials):
    """Oracle: by hand; failed runs and runs without the event are counted."""
    columns = {"A": [1.0, 2.0, 3.0, 4.0, 5.0], "B": [2.0, 4.0, "diverged", INF, 6.0]}
    text = Boxplot().caption(make_trials({"mse": columns}, labels={"B": "robust, $c=1$"}))
    assert text.startswith("Distribution of MSE [rad^2] over the runs for A and robust, $c=1$.")
    assert "whiskers reach to the last values within 1.5 interquartile ranges" in text and "crosses" in text
    assert "n = 5 runs of every method; failed runs are left out (robust, $c=1$ 1)." in text
    assert "did not occur lie in the grey strip, above every other value (robust, $c=1$ 1)." in text
    assert "Medians [quartiles] in rad^2: A 3.0 [2.0, 4.0]" in text


def hp_hu(*pairs):
    """Points of a sweep over the horizons."""
    return [{"controller.Hp": hp, "controller.Hu": hu} for hp, hu in pairs]


def test_points_of_a_sweep_are_panels(make_trials, make_sweep):
    """As in Fig. 8 of zenere2018: own boxes, a common axis, labels and equal counts below the last panel only."""
    first, second = hp_hu(("10", "8"), ("15", "3"))
    values = [{"A": [1.0, 2.0, 3.0], "B": [2.0, 3.0, 4.0]}, {"A": [5.0, 6.0, 9.0], "B": [7.0, 7.5, 8.0]}]
    sweep = make_sweep(
        *((point, make_trials({"mse": columns})) for point, columns in zip((first, second), values, strict=True))
    )
    figure = boxplot(sweep)
    assert [axes.get_title() for axes in figure.axes] == ["Hp=10, Hu=8", "Hp=15, Hu=3"]
    for panel, columns in enumerate(values):
        medians = lines(figure, panel, color=style.BLACK)
        assert [line[0, 1] for line in medians] == [np.median(column) for column in columns.values()]
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
    assert labels(figure, 0) == [] and labels(figure, 1) == ["A", "B"]
    assert figure.axes[1].get_xlabel() == "n = 3 for all"
    assert list(figure.get_size_inches()) == [3.5, 3.8]
    shared = figure.get_supylabel()
    tops, bottoms = zip(*((axes.get_position().y1, axes.get_position().y0) for axes in figure.axes), strict=True)
    assert shared == "MSE [rad$^{2}$]"
    assert figure._supylabel.get_position()[1] == pytest.approx((max(tops) + min(bottoms)) / 2)
    assert boxplot(sweep, log=True).axes[1].get_yscale() == "log"


def test_counts_of_every_panel_where_they_differ(make_trials, make_sweep):
    """A run that failed at one point must be seen there."""
    tables = [make_trials({"mse": {"A": [1.0, 2.0], "B": [1.0, last]}}) for last in ("diverged", 2.0)]
    figure = boxplot(make_sweep(*zip(hp_hu(("10", "8"), ("15", "3")), tables, strict=True)))
    assert labels(figure, 0) == ["n=2", "1/2"] and labels(figure, 1) == ["A\nn=2", "B\nn=2"]


def test_runs_that_are_not_computed_are_not_counted_as_failed(make_trials):
    """B has a run less than A, as in an experiment that was interrupted; of 3 runs of A one failed."""
    trials = make_trials({"mse": {"A": [1.0, 2.0, "diverged"], "B": [1.0, 2.0, 1.5]}})
    trials = replace(trials, frame=trials.frame.iloc[:-1])
    assert labels(boxplot(trials)) == ["A\n2/3", "B\nn=2"]
    assert runs_sentence([trials], ["A", "B"]).startswith(
        "n = 2 to 3 runs of every method; failed runs are left out (A 1)"
    )


def test_labels_of_a_sweep_never_overlap(make_trials, make_sweep):
    """Many methods with long names, counts that differ, long titles."""
    names = [f"method number {i}" for i in range(12)]
    tables = [make_trials({"mse": {name: [1.0, last] for name in names}}) for last in (2.0, "diverged")]
    points = [{"estimator": f"{{kind: robust-kalman, c: 0.1, and: {i}, further: keys of the component}}"} for i in "ab"]
    figure = boxplot(make_sweep(*zip(points, tables, strict=True)))
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [text.get_window_extent() for text in axes.get_xticklabels()]
        assert all(left.x1 <= right.x0 for left, right in zip(boxes, boxes[1:], strict=False))
    title = figure.axes[1].title.get_window_extent()
    assert title.y1 <= min(text.get_window_extent().y0 for text in figure.axes[0].get_xticklabels())
    assert 0 <= title.x0 and title.x1 <= figure.bbox.x1 and "\n" in figure.axes[1].get_title()
    assert title.y0 >= figure.axes[1].get_window_extent().y1


@pytest.mark.parametrize("panels", [1, 2])
def test_same_bytes(make_trials, make_sweep, tmp_path, panels):
    """Saved twice, drawn twice, and with other parameters of the user; no date, no version."""
    table = make_trials({"mse": {"A": [1.0, 2.0, 9.0], "B": [3.0, 4.0, INF]}}, labels={"A": "$c^2$"})
    trials = make_sweep(*((point, table) for point in hp_hu(("10", "8"), ("15", "3")))) if panels > 1 else table
    figure = boxplot(trials)
    first = save(figure, tmp_path / "new" / "directory", "box")
    assert [path.name for path in first] == ["box.svg", "box.pdf", "box.png"]
    before = dict(matplotlib.rcParams)
    with matplotlib.rc_context(
        {"font.size": 20, "axes.facecolor": "black", "svg.fonttype": "none", "svg.hashsalt": "x"}
    ):
        again = [save(figure, tmp_path, "again"), save(boxplot(trials), tmp_path, "other")]
    assert dict(matplotlib.rcParams) == before
    for paths in again:
        assert [path.read_bytes() for path in paths] == [path.read_bytes() for path in first]
    svg, pdf, png = (path.read_bytes() for path in first)
    for word in (b"dc:date", b"matplotlib.org"):
        assert word not in svg
    assert b"CreationDate" not in pdf
    assert b"tEXt" not in png and b"tIME" not in png
    assert b'viewBox="0 0 252 ' in svg
    assert int.from_bytes(png[16:20], "big") == 700  # 3.5 in at 200 dpi


def test_very_many_values_beyond_the_whiskers(make_trials):
    """At most 500 crosses per box, the extreme ones among them; the caption says so.  The box is that of all runs."""
    rng = np.random.default_rng(6)
    heavy, light = rng.standard_t(2, 20_000), rng.normal(size=20_000)
    trials = make_trials({"mse": {"A": heavy, "B": light}})
    (axes,) = Boxplot().draw(trials).axes
    crosses = [line.get_ydata() for line in axes.lines if line.get_marker() == "+"]
    beyond = [box_of(values)["fliers"] for values in (heavy, light)]
    assert len(beyond[0]) > MOST_CROSSES > len(beyond[1]) > 0
    assert len(crosses[0]) == MOST_CROSSES and {min(heavy), max(heavy)} <= set(crosses[0]) <= set(beyond[0])
    np.testing.assert_array_equal(crosses[1], beyond[1])
    assert "Of more than 500 values beyond the whiskers of a box 500 are drawn" in Boxplot().caption(trials)
    assert "Of more than" not in Boxplot().caption(make_trials({"mse": {"A": heavy[:1000], "B": light[:1000]}}))
