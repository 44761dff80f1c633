"""Metrics against trajectories whose values are computed by hand."""

import numpy as np
import pytest
from metrics.issue_checks import only_issue

from rmpc_bench.config_file.keys import model_of, validate
from rmpc_bench.config_file.tree import Problems
from rmpc_bench.config_file.yaml import parse
from rmpc_bench.metrics.input import InputPower, InputRoughness
from rmpc_bench.metrics.tracking import Mae, Mse, Rmse, SettlingTime, SteadyStateError
from rmpc_bench.types import MetricLayout, Record

SECONDS = MetricLayout(n_steps=4, tick=0.5, y_unit="rad", u_unit="V")


def record(y, r, u=(0.0,) * 4, Ts=0.5):
    """Trajectories of runs with one output; y is a list of runs with 5 samples, r one list."""
    y = np.array(y, dtype=float)[:, :, None]
    u = np.broadcast_to(np.array(u, dtype=float), (len(y), y.shape[1] - 1))[:, :, None]
    return Record(Ts, y, y, y, u, np.array(r, dtype=float)[:, None], experiment=SECONDS)


# errors -1, 1, -2, 0 over k = 0..3 and 3 at k = N
RECORD = record([[0.0, 2.0, -1.0, 1.0, 4.0]], [1.0] * 5, [1.0, -2.0, 3.0, 0.0])
IN_SAMPLES = RECORD._replace(experiment=SECONDS._replace(tick=1.0))


@pytest.mark.parametrize(
    ("make", "whole", "to_N", "window"),
    [
        (Mse, 6.0 / 4.0, 15.0 / 5.0, 5.0 / 2.0),
        (Rmse, np.sqrt(6.0 / 4.0), np.sqrt(3.0), np.sqrt(2.5)),
        (Mae, 4.0 / 4.0, 7.0 / 5.0, 3.0 / 2.0),
    ],
)
def test_error_metrics(make, whole, to_N, window):
    """Oracle: by hand; k = 0..N-1 unless given, both ends included, seconds or samples."""
    np.testing.assert_allclose(make().evaluate(RECORD), [whole])
    np.testing.assert_allclose(make(to="N").evaluate(RECORD), [to_N])
    np.testing.assert_allclose(make(from_=0.5, to=1.0).evaluate(RECORD), [window])
    np.testing.assert_allclose(make(from_=1.0, to=2.0).evaluate(IN_SAMPLES), [window])


def test_input_power():
    """Oracle: by hand; the mean of u^2 over k = 0..N-1, which is where inputs end."""
    np.testing.assert_allclose(InputPower().evaluate(RECORD), [14.0 / 4.0])
    np.testing.assert_allclose(InputPower(to="N").evaluate(RECORD), [14.0 / 4.0])
    np.testing.assert_allclose(InputPower(from_=0.5, to=1.0).evaluate(RECORD), [13.0 / 2.0])


def test_input_roughness():
    """Oracle: by hand; increments -3, 5, -3 of the inputs 1, -2, 3, 0, in the window -3, 5."""
    np.testing.assert_allclose(InputRoughness().evaluate(RECORD), [np.sqrt(128.0 / 9.0)])
    np.testing.assert_allclose(InputRoughness(from_=0.0, to=1.0).evaluate(RECORD), [4.0])
    np.testing.assert_allclose(InputRoughness(from_=0.0, to=2.0).evaluate(IN_SAMPLES), [4.0])


def test_a_ramp_is_not_rough():
    """Oracle: by hand; its increments are all the same, and so are those of a constant."""
    for u in ([0.0, 3.0, 6.0, 9.0], [5.0, 4.0, 3.0, 2.0], [7.0] * 4):
        ramp = record([[0.0] * 5], [0.0] * 5, u)
        np.testing.assert_array_equal(InputRoughness().evaluate(ramp), [0.0])
    kink = record([[0.0] * 5], [0.0] * 5, [0.0, 1.0, 2.0, 2.0])  # increments 1, 1, 0
    np.testing.assert_allclose(InputRoughness().evaluate(kink), [np.sqrt(2.0 / 9.0)])


def test_the_roughness_of_two_inputs():
    """Oracle: by hand; the spread of each about its own ramp, root mean square: variances 16 and 0, 0 and 4."""
    u = np.array([[[0.0, 0.0], [1.0, 9.0], [10.0, 18.0]], [[0.0, 1.0], [2.0, 2.0], [4.0, 7.0]]])
    y = np.zeros((2, 4, 1))
    both = Record(1.0, y, y, y, u, np.zeros((4, 1)))
    expected = [np.sqrt((16.0 + 0.0) / 2), np.sqrt((0.0 + 4.0) / 2)]
    np.testing.assert_allclose(InputRoughness().evaluate(both), expected)


def test_one_sample_has_no_increment():
    """A window of one sample, which may be what a smoke run leaves of a longer one, is not rough."""
    one = InputRoughness(from_=1.0, to=1.0)
    np.testing.assert_array_equal(one.evaluate(RECORD), [0.0])


def test_two_outputs_are_averaged():
    """Oracle: by hand; errors (1, 3) and (1, 1) over two samples."""
    y = np.array([[[1.0, 3.0], [1.0, 1.0], [9.0, 9.0]]])
    both = Record(1.0, y, y, y, np.zeros((1, 2, 1)), np.zeros((3, 2)))
    np.testing.assert_allclose(Mse().evaluate(both), [12.0 / 4.0])


@pytest.mark.parametrize(
    ("y", "seconds"),
    [
        ([0.0, 0.5, 0.96, 1.04, 1.0], 1.0),  # inside from k = 2 on
        ([0.0, 0.96, 0.5, 1.0, 1.0], 1.5),  # left the band once more
        ([0.0, 1.2, 0.9, 1.1, 1.0], 2.0),  # only the last sample is inside
        ([0.0, 1.0, 1.0, 1.0, 1.2], np.inf),  # outside at the end: did not settle
        ([0.0, 0.0, 0.0, 0.0, 0.0], np.inf),  # not even near
        ([2.0, 1.04, 1.0, 1.0, 1.0], 0.5),  # from above: the step is |r - y(0)|
        ([1.0, 1.0, 1.0, 1.0, 1.0], 0.0),  # there from the start
    ],
)
def test_settling_time(y, seconds):
    """Oracle: by hand; the first sample after which |y - r| <= 5 % of |r(N) - y(0)| up to N."""
    np.testing.assert_array_equal(SettlingTime().evaluate(record([y], [1.0] * 5)), [seconds])


def test_settling_time_is_per_run_and_counts_from_its_window():
    """Oracle: by hand; a step from 1 to 3 at k = 2, seen from there: run 0 needs 1 sample, run 1 does not settle."""
    y, r = [[1.0, 1.0, 1.0, 3.0, 3.0], [1.0, 1.0, 1.0, 2.0, 2.0]], [1.0, 1.0, 3.0, 3.0, 3.0]
    np.testing.assert_array_equal(SettlingTime(from_=1.0).evaluate(record(y, r)), [0.5, np.inf])
    early = SettlingTime(to=0.5).evaluate(record(y, [1.0] * 5))
    np.testing.assert_array_equal(early, [0.0, 0.0])


def test_the_band_of_the_settling_time_can_be_chosen():
    """Oracle: by hand; the edge of the band (half, exact in binary) is inside."""
    trajectory = record([[0.0, 0.25, 0.5, 0.75, 0.75]], [1.0] * 5)
    for band, seconds in ((0.5, 1.0), (0.25, 1.5), (0.2, np.inf)):
        np.testing.assert_array_equal(SettlingTime(band=band).evaluate(trajectory), [seconds])


def test_the_band_at_an_edge_of_the_reference_is_a_share_of_the_edge():
    """Oracle: by hand; a jump of 2 gives +-0.1, however far away the output still is from the step before."""
    r = [1.0, 1.0, 3.0, 3.0, 3.0]
    y = [[1.0, 1.0, 2.85, 2.92, 3.08], [0.0, 0.0, -7.0, 2.85, 2.91], [1.0, 1.0, 3.09, 2.91, 2.91], [1, 1, 1, 1, 1]]
    at_edge = SettlingTime(from_=1.0)
    np.testing.assert_array_equal(at_edge.evaluate(record(y, r)), [0.5, 1.0, 0.0, np.inf])
    # A sample later nothing jumps: the step is 3 - y there, hence bands of 0.004, 0.0075, 0.0045 and 0.1.
    later = SettlingTime(from_=1.5)
    np.testing.assert_array_equal(later.evaluate(record(y, r)), [np.inf, np.inf, np.inf, np.inf])
    np.testing.assert_array_equal(later.evaluate(record([[9.0, 9.0, 9.0, 1.0, 2.91]], r)), [0.5])


def test_an_edge_counts_in_either_direction():
    """Oracle: by hand; a jump from 3 to 1 gives the band 0.9..1.1, and one after the window gives nothing."""
    y, r = [[3.0, 3.0, 1.25, 1.09, 0.91]], [3.0, 3.0, 1.0, 1.0, 1.0]
    np.testing.assert_array_equal(SettlingTime(from_=1.0).evaluate(record(y, r)), [0.5])
    # up to k = 1 nothing jumps and nothing is left of the step: y(0) is r
    np.testing.assert_array_equal(SettlingTime(to=0.5).evaluate(record(y, r)), [0.0])


def test_both_outputs_settle_at_an_edge():
    """Oracle: by hand; bands of 0.05 and 0.5, the later one counts."""
    y = np.array([[[0.0, 0.0], [0.97, 9.0], [0.97, 9.6], [1.03, 10.4]]])
    r = np.array([[0.0, 0.0], [1.0, 10.0], [1.0, 10.0], [1.0, 10.0]])
    both = Record(1.0, y, y, y, np.zeros((1, 3, 1)), r)
    np.testing.assert_array_equal(SettlingTime(from_=1.0).evaluate(both), [1.0])


def test_an_output_that_does_not_jump_has_its_own_band():
    """Oracle: by hand; one jumps by 1, the other, whose reference stays at 2, is 4 away at the edge: 0.05 and 0.2."""
    y = np.array([[[0.0, 6.0], [1.0, 6.0], [1.0, 2.3], [1.0, 2.1]], [[0.0, 2.0], [0.9, 2.0], [1.0, 2.0], [1.0, 2.0]]])
    r = np.array([[0.0, 2.0], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0]])
    both = Record(1.0, y, y, y, np.zeros((2, 3, 1)), r)
    np.testing.assert_array_equal(SettlingTime(from_=1.0).evaluate(both), [2.0, 1.0])


def test_the_steady_state_error_is_signed():
    """Oracle: by hand; y below r gives a negative number, the share counts samples of the window k = 0..N."""
    trajectory = record([[0.0, 0.0, 0.5, 0.8, 0.9], [0.0, 0.0, 1.5, 1.2, 1.1]], [1.0] * 5)
    np.testing.assert_allclose(SteadyStateError().evaluate(trajectory), [-0.1, 0.1])
    np.testing.assert_allclose(SteadyStateError(share=0.4).evaluate(trajectory), [-0.15, 0.15])
    np.testing.assert_allclose(SteadyStateError(share=1.0).evaluate(trajectory), [-0.56, -0.24])
    np.testing.assert_allclose(SteadyStateError(to=1.5).evaluate(trajectory), [-0.2, 0.2])


def test_metrics_use_the_true_output_and_not_the_state():
    """Oracle: state and estimate are NaN here."""
    nan = np.full_like(RECORD.x, np.nan)
    only_y = RECORD._replace(x=nan, x_hat=nan)
    for make in (Mse, Rmse, Mae, SettlingTime, SteadyStateError):
        assert not np.isnan(make().evaluate(only_y)).any()


@pytest.mark.parametrize(
    ("make", "unit", "direction"),
    [
        (Mse, "rad^2", "lower"),
        (Rmse, "rad", "lower"),
        (Mae, "rad", "lower"),
        (InputPower, "V^2", "lower"),
        (InputRoughness, "V", "lower"),
        (SettlingTime, "s", "lower"),
        (SteadyStateError, "rad", "zero"),
    ],
)
def test_columns_of_metrics(make, unit, direction):
    """Oracle: product.md section 7."""
    settles = make is SettlingTime
    assert make().info(SECONDS) == (make.name, unit, direction, settles, "")
    assert make(name="mine").info(SECONDS).name == "mine"


@pytest.mark.parametrize("window", [{"from_": 1.5, "to": 0.5}, {"to": 2.5}, {"from_": 10.0}])
def test_windows_outside_the_experiment_are_issues(window):
    """Oracle: the experiment lasts 2 s."""
    only_issue(Mse(**window), SECONDS, "", "at least one sample")


def test_a_share_above_one_is_refused():
    """Oracle: a part is not larger than the whole."""
    problems = Problems()
    problems.tried(validate, model_of("metrics", "steady_state_error"), parse("{share: 150%}", "f.yaml"), [])
    assert [(problem.path, problem.message) for problem in problems] == [("share", "must be <= 1 (got '150%')")]


@pytest.mark.parametrize(
    "make",
    [
        *(Mse, Rmse, Mae, InputPower, InputRoughness),
        *(SettlingTime, SteadyStateError),
    ],
)
def test_a_row_has_the_bits_it_has_alone(make, rng):
    """Oracle: a batch of one; 301 samples make NumPy's sums pairwise."""
    runs = 23
    y, u = rng.standard_normal((runs, 301, 2)), rng.standard_normal((runs, 300, 2))
    block = Record(1.0, y, y, y, u, np.zeros((301, 2)))
    values = make().evaluate(block)
    for i in range(runs):
        one = Record(1.0, *(part[i : i + 1].copy() for part in block[1:5]), block.r)
        np.testing.assert_array_equal(make().evaluate(one), values[i : i + 1])
