"""Metrics inside and outside bursts against plain loops, closed forms and hand calculation."""

import math

import numpy as np
import pytest
from conftest import ROUND
from metrics.burst_records import INPUTS, LAYOUT, PARTS, Mixed, N, Ts, counts, trajectories
from metrics.issue_checks import no_issue, only_issue

from rmpc_bench.metrics.burst_samples import burst_samples, prolonged
from rmpc_bench.metrics.departures import Departures
from rmpc_bench.metrics.input import InputRms, InputVariation
from rmpc_bench.metrics.norms import moving_mean
from rmpc_bench.metrics.tracking import Rmse, Tracking
from rmpc_bench.numerics.sample_times import at_least, at_most
from rmpc_bench.types import MetricLayout, Record, SampleWindow

NORMS = {
    "rms": lambda rows: math.sqrt(sum(e * e for row in rows for e in row) / (len(rows) * len(rows[0]))),
    "peak": lambda rows: max(abs(e) for row in rows for e in row),
    "length": lambda rows: max(math.hypot(*row) for row in rows),
    "bias": lambda rows: max(abs(sum(column)) / len(rows) for column in zip(*rows, strict=True)),
}
MIXED = LAYOUT._replace(y_unit="", plant=Mixed())


# -- tracking ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize(
    ("bounds", "samples"), [({}, range(N)), ({"from_": 4.0, "to": "N"}, range(8, N + 1)), ({"to": 16.0}, range(33))]
)
def test_tracking_against_plain_loops(norm, part, bounds, samples, rng):
    """Oracle: loops over runs, samples and components; a run in which no sample counts has no value."""
    block = trajectories(rng)
    for components in (None, [2, 0]):
        values = Tracking(norm=norm, only=components, **part, **bounds).evaluate(block)
        for i, value in enumerate(values):
            rows = [
                [float(block.r[k, j] - block.y[i, k, j]) for j in components or range(3)]
                for k in samples
                if counts(i, k, **part)
            ]
            np.testing.assert_allclose(value, NORMS[norm](rows) if rows else np.nan, **ROUND)


def test_over_all_samples_it_is_the_rmse(rng):
    """Oracle: the metric without bursts; over all samples no bursts are needed."""
    block = trajectories(rng)
    expected = Rmse(from_=2.0).evaluate(block)
    np.testing.assert_allclose(Tracking(from_=2.0).evaluate(block._replace(bursts=None)), expected, **ROUND)
    no_issue(Tracking(from_=2.0), LAYOUT._replace(bursts=False))


def test_a_sine_in_closed_form():
    """Oracle: over whole periods rms a / sqrt(2), peak a at a quarter, bias the offset; its moving mean is a sine."""
    n, a, offset = 400, 3.0, 0.5
    k = np.arange(n + 1)
    y = -(a * np.sin(2 * np.pi * k / 40) + offset)[None, :, None]
    block = Record(0.01, y, y, y, y[:, :-1], np.zeros((n + 1, 1)), experiment=MetricLayout(n, 0.01, "m", "V"))
    values = {norm: Tracking(norm=norm).evaluate(block)[0] for norm in NORMS}
    expected = {"rms": math.hypot(a / math.sqrt(2), offset), "peak": a + offset, "length": a + offset, "bias": offset}
    np.testing.assert_allclose([values[norm] for norm in NORMS], [expected[norm] for norm in NORMS], **ROUND)
    # The mean over 9 samples about each has the gain sin(9 pi / 40) / (9 sin(pi / 40)) and no delay.
    gain = math.sin(9 * math.pi / 40) / (9 * math.sin(math.pi / 40))
    smooth = {"smooth": 0.09, "from_": 0.4, "to": 3.59}
    expected = math.hypot(gain * a / math.sqrt(2), offset)
    np.testing.assert_allclose(Tracking(**smooth).evaluate(block), expected, **ROUND)
    np.testing.assert_allclose(Tracking(norm="peak", **smooth).evaluate(block), gain * a + offset, **ROUND)


@pytest.mark.parametrize("length", [1, 2, 3, 20, 21, 200])
def test_the_moving_mean(length, rng):
    """Oracle: NumPy's convolution of the same size over the number of samples there are; a loop over slices."""
    values = rng.standard_normal((3, N + 1, 2))
    smooth = moving_mean(values, length)
    before, after = length // 2, (length - 1) // 2
    for i in range(3):
        for k in range(N + 1):
            mean = values[i, max(0, k - before) : k + after + 1].mean(axis=0)
            np.testing.assert_allclose(smooth[i, k], mean, rtol=1e-12, atol=1e-14)  # sums about 0
        if length <= N:
            for j in range(2):
                total, n = (np.convolve(z, np.ones(length), "same") for z in (values[i, :, j], np.ones(N + 1)))
                np.testing.assert_allclose(smooth[i, :, j], total / n, rtol=1e-12, atol=1e-14)  # sums about 0


def test_smoothing_comes_before_the_window(rng):
    """Oracle: the moving mean of the whole error, cut afterwards; shorter than a sample it changes nothing."""
    block = trajectories(rng)
    error = block.r - block.y
    for smooth, length in ((0.2, 1), (1.0, 2), (2.6, 5)):
        value = Tracking(smooth=smooth, norm="peak", during="bursts", from_=5.0).evaluate(block)
        rows = zip(moving_mean(error, length)[:, 10:N], block.bursts[:, 10:N], strict=True)
        expected = [np.abs(row[inside]).max() if inside.any() else np.nan for row, inside in rows]
        np.testing.assert_array_equal(value, expected)


def test_times_as_samples():
    """Oracle: by hand, but for rounding; in doubles 0.3 / 0.1 < 3 and 0.07 / 0.01 > 7."""
    assert [at_most(*each) for each in ((0.3, 0.1), (0.14, 0.01), (0.19, 0.1), (0.0, 0.1))] == [3, 14, 1, 0]
    assert [at_least(*each) for each in ((0.3, 0.1), (0.07, 0.01), (0.11, 0.1), (0.0, 0.1))] == [3, 7, 2, 0]


def test_how_long_a_burst_counts():
    """Oracle: by hand."""
    inside = np.array([[0, 1, 0, 0, 0, 1, 1, 0, 0, 0], [0] * 10, [1] + [0] * 9]).astype(bool)
    expected = np.array([[0, 1, 1, 1, 0, 1, 1, 1, 1, 0], [0] * 10, [1, 1, 1] + [0] * 7]).astype(bool)
    np.testing.assert_array_equal(prolonged(inside, 2), expected)
    np.testing.assert_array_equal(prolonged(inside, 0), inside)
    np.testing.assert_array_equal(prolonged(inside, 10**300), np.maximum.accumulate(inside, axis=1))


def test_bursts_and_quiet_are_together_all(rng):
    """Oracle: every sample once; all samples of a record without bursts are quiet."""
    block, window = trajectories(rng), SampleWindow(3, 50)
    bursts, quiet = (burst_samples(block, window, during, 1.0) for during in ("bursts", "quiet"))
    np.testing.assert_array_equal(bursts, ~quiet)
    calm = block._replace(bursts=None)
    assert burst_samples(calm, window, "quiet", 1.0).all() and not burst_samples(calm, window, "bursts", 1.0).any()


@pytest.mark.parametrize(
    ("layout", "keys", "unit", "scale"),
    [
        (LAYOUT, {}, "m", 1.0),
        (LAYOUT, {"unit_": "m"}, "m", 1.0),
        (LAYOUT, {"unit_": "mm"}, "mm", 1e3),
        (MIXED, {}, "", 1.0),
        (MIXED, {"only": [0, 1]}, "m", 1.0),
        (MIXED, {"only": [1], "unit_": "mm"}, "mm", 1e3),
        (MIXED, {"only": [2], "unit_": "mrad"}, "mrad", 1e3),
    ],
)
def test_units_of_the_error(layout, keys, unit, scale, rng):
    """Oracle: those of the components where they have one in common, or a thousandth."""
    block, metric = trajectories(rng)._replace(experiment=layout), Tracking(**keys)
    assert metric.info(layout) == ("tracking", unit, "lower", False, "")
    own = {key: value for key, value in keys.items() if key != "unit_"}
    np.testing.assert_allclose(metric.evaluate(block), scale * Tracking(**own).evaluate(block), **ROUND)


@pytest.mark.parametrize(
    ("kind", "keys", "key", "message"),
    [
        (Tracking, {"unit_": "mrad", "only": [0]}, "unit", r"must be m or mm, .* \(got 'mrad'\)"),
        (Tracking, {"unit_": "m"}, "unit", "no unit in common"),
        (Tracking, {"only": [0, 3]}, "only", "no y.3: the plant has 3 outputs"),
        (Tracking, {"only": []}, "only", "each one once"),
        (Departures, {"only": [1, 1]}, "only", "each one once"),
        (Tracking, {"memory": 0.1}, "memory", "can only be given with during"),
        (InputRms, {"memory": 0.1}, "memory", "can only be given with during"),
        *((kind, {"during": "bursts"}, "during", "'bursts' needs bursts") for kind in (Tracking, Departures, *INPUTS)),
        *((kind, {"during": "quiet"}, "during", "'quiet' needs bursts") for kind in (Tracking, *INPUTS)),
    ],
)
def test_issues(kind, keys, key, message):
    """Oracle: a plant with outputs in m, m and rad, under noise without bursts; the issue names the key to blame."""
    only_issue(kind(**keys), MIXED._replace(bursts=False), key, message)
    if key == "during":  # where it is not known whether there are bursts, nothing is wrong
        no_issue(kind(**keys), MIXED._replace(bursts=None))


# -- inputs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize(
    ("bounds", "samples"), [({}, range(N)), ({"from_": 4.0, "to": 20.0}, range(8, 41)), ({"to": 0.0}, range(1))]
)
def test_inputs_against_plain_loops(part, bounds, samples, rng):
    """Oracle: loops; an increment from k - 1 to k counts where k does, and there is none to k = 0."""
    block = trajectories(rng)
    for kind in INPUTS:
        for i, value in enumerate(kind(**part, **bounds).evaluate(block)):
            ks = [k for k in samples if counts(i, k, **part) and (k or kind is not InputVariation)]
            np.testing.assert_allclose(value, INPUTS[kind](block.u[i], ks) if ks else np.nan, **ROUND)


def test_columns_of_inputs():
    """Oracle: the unit of the input, less is better; there is no input at k = N."""
    for kind in INPUTS:
        assert kind().info(LAYOUT) == (kind.name, "V", "lower", False, "")
        assert kind().window(LAYOUT) == kind(to="N").window(LAYOUT) == (0, N - 1)
        only_issue(kind(to=N * Ts), LAYOUT, "", "must lie in 0..59")
