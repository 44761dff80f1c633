"""Metrics of tracking in and beside bursts against plain loops, closed forms and hand calculation."""

import math

import numpy as np
import pytest
from conftest import ROUND
from metrics.burst_records import INPUTS, PARTS, UNITS, Mixed, N, Ts, counts, trajectories

from rmpc_bench.metrics.burst_samples import During, lasting, moving_mean, whole_samples
from rmpc_bench.metrics.bursts import input_rms, input_variation, tracking
from rmpc_bench.metrics.departures import departures
from rmpc_bench.metrics.tracking import Units, Window, rmse
from rmpc_bench.types import DesignError, Record

NORMS = {
    "rms": lambda rows: math.sqrt(sum(e * e for row in rows for e in row) / (len(rows) * len(rows[0]))),
    "peak": lambda rows: max(abs(e) for row in rows for e in row),
    "length": lambda rows: max(math.hypot(*row) for row in rows),
    "bias": lambda rows: max(abs(sum(column)) / len(rows) for column in zip(*rows, strict=True)),
}


# -- tracking ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize(
    ("bounds", "samples"), [({}, range(N)), ({"from_": 4.0, "to": "N"}, range(8, N + 1)), ({"to": 16.0}, range(33))]
)
def test_tracking_against_plain_loops(norm, part, bounds, samples, rng):
    """Oracle: loops over runs, samples and components; no sample that counts, no value."""
    block = trajectories(rng)
    for components in (None, [2, 0]):
        values = tracking(UNITS, norm=norm, components=components, **part, **bounds).evaluate(block)
        for i, value in enumerate(values):
            rows = [
                [float(block.r[k, j] - block.y[i, k, j]) for j in components or range(3)]
                for k in samples
                if counts(i, k, **part)
            ]
            np.testing.assert_allclose(value, NORMS[norm](rows) if rows else np.nan, **ROUND)


def test_over_all_samples_it_is_the_rmse(rng):
    """Oracle: the metric without bursts, which wants no bursts."""
    block = trajectories(rng)
    plain = UNITS._replace(bursts=False)
    expected = rmse(plain, from_=2.0).evaluate(block)
    np.testing.assert_allclose(tracking(plain, from_=2.0).evaluate(block._replace(bursts=None)), expected, **ROUND)


def test_a_sine_in_closed_form():
    """Oracle: over whole periods rms a / sqrt(2), peak a at a quarter, bias the offset; its moving mean is a sine."""
    n, a, offset = 400, 3.0, 0.5
    k = np.arange(n + 1)
    y = -(a * np.sin(2 * np.pi * k / 40) + offset)[None, :, None]
    block = Record(0.01, y, y, y, y[:, :-1], np.zeros((n + 1, 1)))
    units = Units(n, 0.01, "m", "V")
    values = {norm: tracking(units, norm=norm).evaluate(block)[0] for norm in NORMS}
    expected = {"rms": math.hypot(a / math.sqrt(2), offset), "peak": a + offset, "length": a + offset, "bias": offset}
    np.testing.assert_allclose([values[norm] for norm in NORMS], [expected[norm] for norm in NORMS], **ROUND)
    # The mean over 9 samples about each has the gain sin(9 pi / 40) / (9 sin(pi / 40)) and no delay.
    gain = math.sin(9 * math.pi / 40) / (9 * math.sin(math.pi / 40))
    smooth = {"smooth": 0.09, "from_": 0.4, "to": 3.59}
    expected = math.hypot(gain * a / math.sqrt(2), offset)
    np.testing.assert_allclose(tracking(units, **smooth).evaluate(block), expected, **ROUND)
    np.testing.assert_allclose(tracking(units, norm="peak", **smooth).evaluate(block), gain * a + offset, **ROUND)


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
        value = tracking(UNITS, smooth=smooth, norm="peak", during="bursts", from_=5.0).evaluate(block)
        rows = zip(moving_mean(error, length)[:, 10:N], block.bursts[:, 10:N], strict=True)
        expected = [np.abs(row[inside]).max() if inside.any() else np.nan for row, inside in rows]
        np.testing.assert_array_equal(value, expected)


def test_how_long_a_burst_lasts():
    """Oracle: samples k with k Ts <= end + memory, but for rounding; 0.3 / 0.1 is 2.9999999999999996 in doubles."""
    assert [whole_samples(seconds, step) for seconds, step in ((0.3, 0.1), (0.14, 0.01), (0.19, 0.1), (0.0, 0.1))] == [
        *(3, 14, 1, 0)
    ]
    inside = np.array([[0, 1, 0, 0, 0, 1, 1, 0, 0, 0], [0] * 10, [1] + [0] * 9]).astype(bool)
    expected = np.array([[0, 1, 1, 1, 0, 1, 1, 1, 1, 0], [0] * 10, [1, 1, 1] + [0] * 7]).astype(bool)
    np.testing.assert_array_equal(lasting(inside, 2), expected)
    np.testing.assert_array_equal(lasting(inside, 0), inside)
    np.testing.assert_array_equal(lasting(inside, 10**300), np.maximum.accumulate(inside, axis=1))


def test_bursts_and_quiet_are_together_all(rng):
    """Oracle: every sample once; a record that knows of no bursts is quiet."""
    block, window = trajectories(rng), Window(3, 50)
    some, rest = (During(when, 1.0).among(block, window) for when in ("bursts", "quiet"))
    np.testing.assert_array_equal(some, ~rest)
    calm = block._replace(bursts=None)
    assert During("quiet", 1.0).among(calm, window).all() and not During("bursts", 1.0).among(calm, window).any()


@pytest.mark.parametrize(
    ("units", "keys", "unit", "scale"),
    [
        (UNITS, {}, "m", 1.0),
        (UNITS, {"unit": "m"}, "m", 1.0),
        (UNITS, {"unit": "mm"}, "mm", 1e3),
        (UNITS._replace(y="", plant=Mixed()), {}, "", 1.0),
        (UNITS._replace(y="", plant=Mixed()), {"components": [0, 1]}, "m", 1.0),
        (UNITS._replace(y="", plant=Mixed()), {"components": [1], "unit": "mm"}, "mm", 1e3),
        (UNITS._replace(y="", plant=Mixed()), {"components": [2], "unit": "mrad"}, "mrad", 1e3),
    ],
)
def test_units_of_the_error(units, keys, unit, scale, rng):
    """Oracle: those of the components where they have one in common, or a thousandth."""
    block, metric = trajectories(rng), tracking(units, **keys)
    assert metric.info == ("tracking", unit, "lower", False)
    own = {key: value for key, value in keys.items() if key != "unit"}
    np.testing.assert_allclose(metric.evaluate(block), scale * tracking(units, **own).evaluate(block), **ROUND)


@pytest.mark.parametrize(
    ("make", "keys", "parameter", "message"),
    [
        (tracking, {"unit": "mrad", "components": [0]}, "unit", r"must be m or mm, .* \(got 'mrad'\)"),
        (tracking, {"unit": "m"}, "unit", "no unit in common"),
        (tracking, {"components": [0, 3]}, "components", "no y.3: the plant has 3 outputs"),
        (tracking, {"components": []}, "components", "at least one"),
        (departures, {"components": [1, 1]}, "components", "none twice"),
        (tracking, {"memory": 0.1}, "memory", "belongs to during"),
        (input_rms, {"memory": 0.1}, "memory", "belongs to during"),
        *((make, {"during": "bursts"}, "during", "'bursts' needs bursts") for make in (tracking, departures, *INPUTS)),
        *((make, {"during": "quiet"}, "during", "'quiet' needs bursts") for make in (tracking, *INPUTS)),
    ],
)
def test_what_is_refused(make, keys, parameter, message):
    """Oracle: a plant with outputs in m, m and rad, under noise without bursts; the key to blame is named."""
    units = Units(N, Ts, "", "N m", plant=Mixed(), bursts=False)
    with pytest.raises(DesignError, match=message) as caught:
        make(units, **keys)
    assert caught.value.parameter == parameter
    if parameter == "during":
        make(units._replace(bursts=None), **keys)  # where nobody knows, nobody refuses


# -- inputs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize(
    ("bounds", "samples"), [({}, range(N)), ({"from_": 4.0, "to": 20.0}, range(8, 41)), ({"to": 0.0}, range(1))]
)
def test_inputs_against_plain_loops(part, bounds, samples, rng):
    """Oracle: loops; a step from k - 1 to k counts where k does, and there is none to k = 0."""
    block = trajectories(rng)
    for make in INPUTS:
        values = make(UNITS, **part, **bounds).evaluate(block)
        for i, value in enumerate(values):
            ks = [k for k in samples if counts(i, k, **part) and (k or make is not input_variation)]
            np.testing.assert_allclose(value, INPUTS[make](block.u[i], ks) if ks else np.nan, **ROUND)


def test_inputs_say_what_they_are():
    """Oracle: the unit of the input, less is better; there is no input at k = N."""
    for make in INPUTS:
        assert make(UNITS).info == (make.__name__, "V", "lower", False)
        assert make(UNITS).window == make(UNITS, to="N").window == (0, N - 1)
        with pytest.raises(DesignError, match="must lie in 0..59"):
            make(UNITS, to=N * Ts)
