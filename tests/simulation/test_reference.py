"""References: the square wave by hand, and what it refuses."""

import numpy as np
import pytest

from rmpc_bench.numerics.s_shape import s_curve
from rmpc_bench.simulation.reference import Reference, constant, s_shape, square
from rmpc_bench.types import DesignError


def test_a_constant_for_every_output():
    """A number or one per output, at every sample."""
    np.testing.assert_array_equal(constant(2, value=3.0).sample(2), [[3, 3], [3, 3]])
    np.testing.assert_array_equal(constant(2, value=[3.0, 4.0]).sample(2), [[3, 4], [3, 4]])
    assert isinstance(constant(1, value=0.0), Reference)
    with pytest.raises(DesignError, match="2 numbers are required") as caught:
        constant(2, value=[1.0, 2.0, 3.0])
    assert caught.value.parameter == "value"


@pytest.mark.parametrize(
    ("period", "duty", "expected"),
    [
        (2.0, 0.5, "0011001100110011"),
        (2.0, 0.25, "0111011101110111"),
        (2.0, 0.75, "0001000100010001"),
        (3.0, 0.5, "0001110001110001"),
        (1.0, 0.5, "0101010101010101"),
        (5.0, 0.3, "0001111111000111"),
        (100.0, 0.05, "0000000000111111"),  # one edge within what is shown: a step at 5 s
    ],
)
def test_the_edges_of_a_square_wave(period, duty, expected):
    """Oracle: by hand; samples every 0.5 s, the sample at an edge has the new value."""
    values = square(1, 0.5, values=(0.0, 1.0), period=period, duty=duty).sample(16)
    assert "".join(f"{value:.0f}" for value in values[:, 0]) == expected and values.shape == (16, 1)


def test_a_square_wave_of_the_paper():
    """Oracle: 0 until 25 s, pi until 50 s and so on, sampled every 0.1 s; the first N samples do not depend on N."""
    wave = square(1, 0.1, values=(0.0, np.pi), period=50.0)
    r = wave.sample(1001)[:, 0]
    assert (np.flatnonzero(np.diff(r)) + 1).tolist() == [250, 500, 750, 1000]
    assert r[0] == 0 and r[250] == np.pi and isinstance(wave, Reference)
    np.testing.assert_array_equal(wave.sample(300)[:, 0], r[:300])


@pytest.mark.parametrize(("Ts", "period", "duty"), [(0.1, 0.3, 1 / 3), (0.1, 1.0, 0.3), (0.01, 0.07, 3 / 7)])
def test_rounding_does_not_move_an_edge(Ts, period, duty):
    """0.3/0.1 is 2.9999999999999996 in doubles."""
    wave = square(1, Ts, values=(0.0, 1.0), period=period, duty=duty)
    assert (wave.period, wave.edge) == (round(period / Ts), round(duty * period / Ts))
    assert wave.sample(wave.period).sum() == wave.period - wave.edge


def test_a_vector_for_every_output():
    """One value per output, or a number for all of them."""
    r = square(2, 1.0, values=([1.0, 2.0], 5.0), period=2.0).sample(3)
    np.testing.assert_array_equal(r, [[1, 2], [5, 5], [1, 2]])


@pytest.mark.parametrize(
    ("keys", "parameter", "message"),
    [
        ({"period": 0.25}, "period", "must lie on samples, 0.1 apart"),
        ({"period": 0.04}, "period", "must lie on samples"),
        ({"period": 0.3}, "duty", "must lie on samples"),  # half of three samples
        ({"period": 0.1}, "duty", "must lie on samples"),
        ({"period": 1.0, "duty": 0.25}, "duty", "must lie on samples"),
        ({"period": 1.0, "duty": 1e-12}, "duty", "must lie on samples"),
        ({"period": 1.0, "duty": 1 - 1e-12}, "duty", "leaves no sample for the second value"),
        ({"period": 1.0, "values": (0.0, [1.0, 2.0])}, "values", "a number or 1 numbers are required"),
    ],
)
def test_what_a_square_wave_refuses(keys, parameter, message):
    """Edges between two samples, which no controller could see, and values of another size."""
    with pytest.raises(DesignError, match=message) as caught:
        square(1, 0.1, **({"values": (0.0, 1.0)} | keys))
    assert caught.value.parameter == parameter


def test_a_period_beyond_all_samples():
    """A step that never returns: as long as a number can be."""
    np.testing.assert_array_equal(square(1, 0.1, values=(1.0, 2.0), period=1e30).sample(3), np.ones((3, 1)))


def test_an_s_is_held_after_its_end():
    """Oracle: the curve at k Ts; the first samples do not depend on how many are asked for."""
    path = s_shape(3, 0.01)
    r = path.sample(1000)
    assert isinstance(path, Reference)
    np.testing.assert_array_equal(r[:801], s_curve(0.01 * np.arange(801)))
    np.testing.assert_array_equal(r[800:], np.tile(r[800], (200, 1)))
    np.testing.assert_array_equal(path.sample(37), r[:37])
    slow = s_shape(3, 0.01, duration=10.0, width=0.02, height=0.03, angle=-0.1).sample(1001)
    np.testing.assert_allclose(slow[500], [0.0, 0.0, -0.1], atol=1e-15)
    np.testing.assert_allclose(np.abs(slow).max(axis=0), [0.02, 0.03, 0.1], rtol=1e-4)  # between two samples


def test_an_s_is_for_three_outputs():
    """It is a path in the plane with an angle."""
    with pytest.raises(DesignError, match="the plant has 2 outputs") as caught:
        s_shape(2, 0.01)
    assert caught.value.parameter == "kind"
