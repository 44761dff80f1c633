"""Tests of the metrics of a signal against a limit, on small records whose values are known by hand."""

import numpy as np
import pytest
from metrics.issue_checks import no_issue, only_issue

from rmpc_bench.metrics.limits import Largest, Violation
from rmpc_bench.plants.linear import design as linear
from rmpc_bench.plants.servo import design_linear
from rmpc_bench.types import Method, MetricLayout, Plant, Record
from rmpc_bench.types.run_info import Journal, RunInfo

METRICS = [Violation(of="shaft_torque", limit=1.0), Largest(of="shaft_torque")]


def servo_layout():
    return MetricLayout(4, 0.1, "rad", "V", plant=design_linear(0.1))


def servo_record(twists, k_theta, rho):
    """Record of runs in which th_m / rho - th_l is the given twist, (runs, samples)."""
    layout, twists = servo_layout(), np.array(twists)
    nominal = {name: np.full(len(twists), value) for name, value in layout.plant.nominal.items()}
    delta = layout.plant.draw(nominal | {"k_theta": np.array(k_theta), "rho": np.array(rho)}, [], 4)
    x = np.zeros((*twists.shape, 4))
    x[:, :, 2] = twists * np.array(rho)[:, None]
    u = np.zeros((len(x), x.shape[1] - 1, 1))
    return Record(0.1, x, x[:, :, :1], x, u, np.zeros((x.shape[1], 1)), experiment=layout, delta=delta)


@pytest.mark.parametrize(
    ("limit", "share", "largest", "integral"),
    [
        (2.0, 0.5, 3.0, 0.4),  # excess 1 of -3 and 3 of 5
        ((-2.0, 6.0), 0.25, 1.0, 0.1),
        ((None, 4.0), 0.25, 1.0, 0.1),
        ((1.5, None), 0.5, 4.5, 0.45 + 0.05),  # 1.5 - 1 and 1.5 - (-3)
        ((0.0, None), 0.25, 3.0, 0.3),
        (6.0, 0.0, 0.0, 0.0),
    ],
)
def test_excess_of_a_record_by_hand(limit, share, largest, integral):
    """Oracle: the sums by hand, of the samples k = 0..N-1."""
    record = Record.of_run(y=[1.0, -3.0, 2.0, 5.0, 99.0], Ts=0.1)
    values = [Violation(of="y", limit=limit, what=what).evaluate(record).item() for what in _WHATS]
    assert values == pytest.approx([share, largest, integral], rel=1e-14, abs=1e-14)


_WHATS = ("share", "largest", "integral")


def test_rounding_at_a_limit_that_acts_does_not_count():
    """Trap: where a limit acts, the signal equals it up to its last bits, and the naive share is a coin toss."""
    limit = 25.0 * np.pi
    signal = limit * (1.0 + np.array([2e-16, -2e-16, 3e-16, 1e-12, 9e-7, 1.1e-6]))
    record = Record.of_run(x=[*signal, 0.0])
    assert np.mean(signal > limit) == pytest.approx(5 / 6)  # the naive share
    assert Violation(of="x", limit=limit).evaluate(record).item() == pytest.approx(1 / 6)
    assert Violation(of="x", limit=limit, what="largest").evaluate(record).item() == pytest.approx(1.1e-6 * limit)


def test_a_limit_of_zero_has_a_tolerance_in_the_unit_of_the_signal():
    """Oracle: the definition."""
    record = Record.of_run(y=[-1e-17, -0.9e-6, -1.1e-6, 0.0, -1.0])
    assert Violation(of="y", limit=(0.0, None)).evaluate(record).item() == 0.25


def test_the_component_with_the_largest_excess_counts():
    """Oracle: by hand; the second component exceeds the limit at another sample than the first."""
    record = Record.of_run(y=[[0.0, 3.0], [2.0, 4.0], [1.5, 0.0], [9.0, 9.0]])
    every = [Violation(of="y", limit=1.0, what=what).evaluate(record).item() for what in _WHATS]
    first = [Violation(of="y.0", limit=1.0, what=what).evaluate(record).item() for what in _WHATS]
    assert every == [1.0, 3.0, 2.0 + 3.0 + 0.5]
    assert first == pytest.approx([2 / 3, 1.0, 1.5])
    assert Largest(of="y").evaluate(record).item() == 4.0
    assert Largest(of="y.0", to=3.0).evaluate(record).item() == 9.0


def test_torque_of_a_run_has_the_parameters_of_the_run():
    """Trap: the nominal rigidity, that of the design model, gives another torque and another share."""
    record = servo_record([[0.0, 0.01, 0.02, 0.03, 1.0]] * 2, k_theta=[100.0, 200.0], rho=[20.0, 25.0])
    largest = Largest(of="shaft_torque").evaluate(record)
    assert largest == pytest.approx([3.0, 6.0], rel=1e-14)
    assert Largest(of="motor_torque").evaluate(record) == pytest.approx([3.0 / 20.0, 6.0 / 25.0], rel=1e-14)
    naive = record.layout.plant.nominal["k_theta"] * 0.03
    assert naive == pytest.approx(38.406)
    assert Violation(of="shaft_torque", limit=2.5).evaluate(record).tolist() == [0.25, 0.5]
    # On the side of the motor the same limit is never met, and every test of it passes.
    assert Violation(of="motor_torque", limit=2.5).evaluate(record).tolist() == [0.0, 0.0]


def test_a_diverged_run_leaves_the_others_alone():
    """Oracle: the values of the other run without it."""
    record = servo_record([[0.0, 0.01, 0.02, 0.03, 0.0]] * 2, k_theta=[100.0, 200.0], rho=[20.0, 25.0])
    broken = record.x.copy()
    broken[0, 2:] = np.nan
    runs = RunInfo((0, 1), (), np.array([False, True]), Journal())
    for metric in (Largest(of="shaft_torque", between=2), Violation(of="shaft_torque", limit=1.0, between=2)):
        assert metric.evaluate(record._replace(x=broken, runs=runs))[1] == metric.evaluate(record)[1]


def test_units_and_labels():
    """Oracle: the definitions."""
    layout = servo_layout()
    infos = {what: Violation(of="shaft_torque", limit=2.0, what=what).info(layout) for what in _WHATS}
    assert {what: info.unit for what, info in infos.items()} == {"share": "", "largest": "N m", "integral": "N m s"}
    assert infos["share"].words == "share of samples with shaft torque beyond its limit"
    assert Violation(name="torque", of="shaft_torque", limit=2.0).info(layout).words == "torque"
    assert Largest(of="motor_torque").info(layout) == ("largest", "N m", "lower", False, "largest motor torque")
    assert Largest(of="motor_torque", label="peak").info(layout).words == "peak"
    assert [Largest(of=of).unit(layout) for of in ("y", "y.0", "u", "x.1")] == ["rad", "rad", "V", ""]
    assert Violation(of="x.0", limit=1.0, what="integral").unit(layout) == "s"


def test_bounds_of_the_values():
    """Oracle: the definitions."""
    bounds = [Violation(of="u", limit=1.0, what=what).bounds for what in _WHATS]
    assert bounds == [(0.0, 1.0), (0.0, np.inf), (0.0, np.inf)]


class Named(Plant):
    """Two levels, one of them measured under the name of a state, and a pump."""

    nx, nu, ny, Ts = 2, 1, 1, 1.0
    names = {"w.0": "rain", "x.0": "upper", "x.1": "lower", "u.0": "pump", "y.0": "upper"}
    units = {"x.0": "m", "x.1": "m", "u.0": "l/s", "y.0": "V"}


def test_names_of_components():
    """Oracle: the names; a state goes before an output of the same name, and what is no signal has no name."""
    layout = MetricLayout(2, plant=Named())
    record = Record.of_run(x=[[1.0, 2.0], [3.0, 8.0], [0.0, 0.0]], y=[5.0, 6.0, 0.0], u=[-7.0, 4.0])
    record = record._replace(experiment=layout)
    found = {of: Largest(of=of).evaluate(record).item() for of in ("upper", "lower", "pump", "x", "y.0", "u")}
    assert found == {"upper": 3.0, "lower": 8.0, "pump": 7.0, "x": 8.0, "y.0": 6.0, "u": 7.0}
    assert [Largest(of=of).unit(layout) for of in ("upper", "x", "y", "pump")] == ["m", "m", "V", "l/s"]
    only_issue(Largest(of="uper"), layout, "of", r"'uper' is not a known signal; did you mean 'upper'\?")
    only_issue(Largest(of="rain"), layout, "of", "'rain' is not a known signal")


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
def test_check_accepts_what_the_plant_has(metric):
    """Oracle: no issue."""
    no_issue(metric, servo_layout())


@pytest.mark.parametrize(
    ("metric", "key", "message"),
    [
        (Largest(of="shaft_torqe"), "of", "did you mean 'shaft_torque'"),
        (Largest(of="y.1"), "of", "did you mean 'y.0'"),
        (Largest(of="e.0"), "of", "not a known signal"),
        (Largest(of="y", from_=9.0), "", "must lie in 0..4"),
        (Violation(of="y", limit=0.0), "limit", r"must be > 0, or two numbers \[lowest, highest\] \(got 0\)"),
        (Violation(of="y", limit=(2.0, 1.0)), "limit", r"got \[2, 1\]"),
        (Violation(of="y", limit=(None, None)), "limit", "nothing exceeds it"),
        (Largest(of="u", between=3), "between", "an input is constant between two samples"),
    ],
)
def test_check_refuses(metric, key, message):
    """Oracle: the rules of the keys."""
    only_issue(metric, servo_layout(), key, message)


def test_between_is_refused_by_a_plant_of_samples_only():
    """Oracle: the plant `linear` has no continuous time."""
    plant = linear(0.1, 4, A=[[0.9]], B=[[1.0]], C=[[1.0]])
    layout = MetricLayout(4, plant=plant)
    no_issue(Largest(of="x.0"), layout)
    only_issue(Largest(of="x.0", between=1), layout, "between", r"\(UncertainLinear\) gives no states between")


def test_methods_do_not_matter():
    """Oracle: the signal is one of the plant, which every method has."""
    layout = servo_layout()._replace(methods=(Method("M", None, None),))
    no_issue(Largest(of="shaft_torque"), layout)
