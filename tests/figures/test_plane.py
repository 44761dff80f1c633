"""The path of a run in a plane, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from matplotlib.colors import to_hex

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.figures.files import save_as
from rmpc_bench.figures.plane import Plane
from rmpc_bench.figures.style import COLOURS, GREY, REFERENCE
from rmpc_bench.types import DesignError


def plane(trials, **keys):
    return Plane(**keys).draw(trials)


N, RUNS, TS = 80, 2, 0.1
NAMES = ("A", "B")


@pytest.fixture
def trials(make_trials):
    """A circle in y[0] and y[1] that takes 8 s, and another output; runs beside it."""
    table = make_trials({"mse": dict.fromkeys(NAMES, [1.0] * RUNS)})
    angle = 2 * np.pi * np.arange(N + 1) / N
    r = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), angle], axis=1)
    rng = np.random.default_rng(6)
    traces = {name: Traces(np.arange(RUNS), {"y": r + 1e-3 * rng.normal(size=(RUNS, N + 1, 3))}, r) for name in NAMES}
    return replace(table, traces=traces, Ts=TS, units={"y.0": "m", "y.1": "m", "y.2": "rad"})


def path(figure, color, *, marker="None", width=None):
    """Points of the only line of a colour."""
    found = [
        np.array(line.get_xydata())
        for line in figure.axes[0].lines
        if to_hex(line.get_color()) == color
        and line.get_marker() == marker
        and (width is None or line.get_linewidth() == width)
    ]
    (points,) = found
    return points


def marks(figure):
    """Time -> place of the marks."""
    return {text.get_text(): text.xy for text in figure.axes[0].texts}


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_paths_and_reference(trials):
    """Both outputs at the samples of the window, one scale, units on the axes."""
    figure = plane(trials, run=1, from_=2.0, to=6.0)
    for name, color in zip(NAMES, COLOURS, strict=False):
        np.testing.assert_array_equal(path(figure, color), trials.traces[name].signals["y"][1, 20:61, :2])
    np.testing.assert_array_equal(path(figure, REFERENCE), trials.traces["A"].r[20:61, :2])
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$y_0$ [m]", "$y_1$ [m]")
    assert axes.get_aspect() == 1.0 and legend(figure) == ["A", "B", "reference"]
    assert axes.get_title() == "run 1, marks every 1 s"
    scale = np.ptp([axes.get_xlim(), axes.get_ylim()], axis=1) / axes.bbox.size
    assert scale[0] == pytest.approx(scale[1], rel=1e-9)  # limits move by rounding when they are made equal


def test_time_marks(trials):
    """At multiples of the time, on the reference and on the paths, with the time beside them."""
    figure = plane(trials, from_=1.5, to=5.0, marks=1.5)
    places = {"1.5": 15, "3": 30, "4.5": 45}
    assert marks(figure) == {text: pytest.approx(trials.traces["A"].r[k, :2]) for text, k in places.items()}
    for name, color in zip(NAMES, COLOURS, strict=False):
        expected = trials.traces[name].signals["y"][0, [15, 30, 45], :2]
        np.testing.assert_array_equal(path(figure, color, marker="o"), expected)
    assert marks(plane(trials, marks=0.0)) == {} and "marks" not in plane(trials, marks=0.0).axes[0].get_title()
    assert list(marks(plane(trials, marks=2.0))) == ["0", "2", "4", "6", "8"]


def test_numbers_lie_beside_the_paths_and_not_on_each_other(trials):
    """Inside the panel, too."""
    figure = plane(trials)
    panel = figure.axes[0].get_window_extent()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert len(boxes) == 9
    for number, box in enumerate(boxes):
        assert panel.x0 <= box.x0 and box.x1 <= panel.x1 and panel.y0 <= box.y0 and box.y1 <= panel.y1
        assert not any(box.overlaps(other) for other in boxes[:number])


def test_magnified(trials):
    """r + 20 (y - r), and the picture says so; the reference stays."""
    figure = plane(trials, magnify=20.0, components=(1, 0))
    for name, color in zip(NAMES, COLOURS, strict=False):
        r, y = trials.traces[name].r, trials.traces[name].signals["y"][0]
        np.testing.assert_allclose(path(figure, color), (r + 20.0 * (y - r))[:, [1, 0]], **ROUND)
    np.testing.assert_array_equal(path(figure, REFERENCE), trials.traces["A"].r[:, [1, 0]])
    assert figure.axes[0].get_xlabel() == "$y_1$ [m], errors ×20"


def test_outputs_of_different_units_have_scales_of_their_own(trials):
    """A metre and a radian have nothing in common."""
    axes = plane(trials, components=(0, 2)).axes[0]
    assert axes.get_aspect() == "auto" and axes.get_ylabel() == "$y_2$ [rad]"


def test_bursts_lie_under_the_reference(trials):
    """A broad band where the noise is in one, and nothing where runs do not agree or the window has none."""
    flags = np.zeros((RUNS, N + 1, 1))
    flags[:, 34:41] = flags[:, 62:67] = 1.0
    traces = {name: each._replace(signals={**each.signals, "bursts": flags}) for name, each in trials.traces.items()}
    table = replace(trials, traces=traces)
    figure = plane(table)
    band = path(figure, GREY)
    inside = flags[0, :, 0] > 0
    np.testing.assert_array_equal(band[inside], trials.traces["A"].r[inside, :2])
    assert np.isnan(band[~inside]).all() and legend(figure) == ["A", "B", "reference", "burst"]
    assert "burst" not in legend(plane(table, to=3.0)) and "burst" not in legend(plane(trials))


def test_samples_without_a_sampling_time(trials):
    """Then marks count in samples."""
    figure = plane(replace(trials, Ts=0.0), marks=20.0)
    assert list(marks(figure)) == ["0", "20", "40", "60", "80"]
    assert figure.axes[0].get_title() == "run 0, marks every 20 samples"


def test_a_run_that_failed(trials):
    """It is named and does not shrink the others; alone it is drawn as it is."""
    frame = trials.frame.copy()
    frame.loc[(frame["method"] == "B") & (frame["run"] == 0), "status"] = "diverged"
    wild = trials.traces["B"]
    y = wild.signals["y"].copy()
    y[0, 40:] = 1e300
    traces = trials.traces | {"B": wild._replace(signals={"y": y})}
    table = replace(trials, frame=frame, traces=traces)
    figure = plane(table)
    assert figure.axes[0].get_title() == "run 0, marks every 1 s, B diverged"
    assert max(np.abs(figure.axes[0].get_xlim())) < 0.3
    assert plane(table, order=["B"], magnify=1e10).axes


@pytest.mark.parametrize(
    ("given", "parameter", "message"),
    [
        ({"run": 2}, "run", "run 2 is not recorded (recorded: 0, 1)"),
        ({"components": (0, 3)}, "components", "there is no output 3 (they count from 0 to 2)"),
        ({"components": (1, 1)}, "components", "must be two different outputs"),
        ({"marks": 0.1}, "marks", "more than 50 time marks overlap: choose a longer time between two marks"),
        ({"order": ["D"]}, "order", "'D' is not a known method; known: A, B"),
        ({"from_": 8.0}, "from", "fewer than two samples lie between `from` and `to` (there are 0 to 8)"),
        ({"height": 0.5}, "height", "must be at least 1 inch (got 0.5)"),
    ],
)
def test_errors_show_the_choices(trials, given, parameter, message):
    """A figure that cannot be drawn is left out with a reason."""
    with pytest.raises(DesignError) as error:
        plane(trials, **given)
    assert (str(error.value), error.value.parameter) == (message, parameter)


def test_nothing_to_draw(trials):
    """The way out is a key of the configuration."""
    blind = {name: each._replace(signals={"u": np.zeros((RUNS, N, 1))}) for name, each in trials.traces.items()}
    for table, message in (
        (replace(trials, traces={}), "needs recorded y: record: {runs: 1, signals: [y]}"),
        (replace(trials, traces=blind), "needs recorded y: record: {runs: 1, signals: [y]}"),
    ):
        with pytest.raises(DesignError) as error:
            plane(table)
        assert str(error.value) == message


def test_a_reference_that_rests(trials):
    """All marks are in one place; it is drawn all the same."""
    still = {name: each._replace(r=np.zeros((N + 1, 3))) for name, each in trials.traces.items()}
    assert len(marks(plane(replace(trials, traces=still), marks=2.0))) == 5


def test_same_bytes(trials, tmp_path):
    """Drawn twice, saved twice."""
    for stem in ("one", "other"):
        save_as(plane(trials, magnify=5.0), tmp_path / f"{stem}.svg")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "other.svg").read_bytes()


def test_keys():
    """As a configuration writes them."""
    problems = []
    text = "{components: [0, 2], run: 1, marks: 0.5, magnify: 20, from: 1}"
    keys = validate(model_of("figures", "plane"), parse(text, "f.yaml"), [], problems)
    assert not problems and (keys.components, keys.marks, keys.magnify) == ((0, 2), 0.5, 20)
    validate(model_of("figures", "plane"), parse("{components: [0], marks: -1, magnify: 0}", "f.yaml"), [], problems)
    assert sorted(str(problem).split(": ", 1)[1] for problem in problems) == [
        "components: has too few entries",
        "magnify: must be > 0 (got 0)",
        "marks: must be >= 0 (got -1)",
    ]
