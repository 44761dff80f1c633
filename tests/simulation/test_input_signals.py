"""Input signals against closed forms, and their properties."""

import numpy as np
import pytest
from conftest import EXACT, ROUND

from rmpc_bench.simulation.input_signals import prbs, sine, steps
from rmpc_bench.types import DesignError


def values(signal, n_samples):
    """Values of run 0, after a check that all runs have the same."""
    sampled = signal.sample([0, 7, 3], n_samples)
    assert sampled.shape[:2] == (3, n_samples)
    np.testing.assert_allclose(sampled, np.broadcast_to(sampled[0], sampled.shape), **EXACT)
    return sampled[0]


def test_a_step_holds_from_its_time_on():
    signal = steps(2, 0.5, times=[0.0, 1.0, 2.5], values=[1.0, [2.0, -2.0], 0.0])
    first, second = values(signal, 7).T
    np.testing.assert_allclose(first, [1, 1, 2, 2, 2, 0, 0], **EXACT)
    np.testing.assert_allclose(second, [1, 1, -2, -2, -2, 0, 0], **EXACT)


def test_times_are_samples_although_quotients_are_rounded():
    """0.3 / 0.1 is below 3 in floating point."""
    np.testing.assert_allclose(
        values(steps(1, 0.1, times=[0.0, 0.3], values=[0.0, 1.0]), 5)[:, 0], [0, 0, 0, 1, 1], **EXACT
    )


def test_a_sine_is_that_of_its_formula():
    k = np.arange(50)
    signal = sine(1, 0.2, amplitude=3.0, period=4.0, mean=1.0, phase=0.3)
    np.testing.assert_allclose(values(signal, 50)[:, 0], 1.0 + 3.0 * np.sin(2 * np.pi * k * 0.2 / 4.0 + 0.3), **ROUND)


@pytest.mark.parametrize("order", [2, 3, 5, 10])
def test_a_binary_signal_has_the_autocorrelation_of_maximum_length(order):
    """1 at lag 0 and -1/(2^n - 1) at every other lag, the property that defines such a sequence."""
    length = 2**order - 1
    bits = values(prbs(1, 1.0, low=-1.0, high=1.0, order=order), length)[:, 0]
    spectrum = np.abs(np.fft.fft(bits)) ** 2 / length
    correlation = np.fft.ifft(spectrum).real
    np.testing.assert_allclose(correlation, np.where(np.arange(length) == 0, 1.0, -1.0 / length), atol=1e-12)


def test_bits_are_held_and_the_sequence_repeats():
    signal = prbs(1, 0.5, low=2.0, high=5.0, hold=1.5, order=3)
    u = values(signal, 2 * 7 * 3)[:, 0].reshape(-1, 3)
    np.testing.assert_allclose(u, np.broadcast_to(u[:, :1], u.shape), **EXACT)
    np.testing.assert_allclose(u[:7], u[7:], **EXACT)
    assert set(u.ravel()) == {2.0, 5.0}


def test_two_inputs_have_shifted_sequences():
    u = values(prbs(2, 1.0, low=0.0, high=1.0, order=4), 15)
    np.testing.assert_allclose(u[:, 1], np.roll(u[:, 0], -7), **EXACT)


def test_every_input_has_its_own_values():
    u = values(prbs(2, 1.0, low=[0.0, 10.0], high=[1.0, 20.0]), 100)
    assert set(u[:, 0]) == {0.0, 1.0}
    assert set(u[:, 1]) == {10.0, 20.0}


@pytest.mark.parametrize(
    ("design", "keys", "parameter"),
    [
        (steps, {"times": [0.0, 0.25], "values": [1.0, 2.0]}, "times"),
        (steps, {"times": [0.5], "values": [1.0]}, "times"),
        (steps, {"times": [0.0, 1.0, 1.0], "values": [1.0, 2.0, 3.0]}, "times"),
        (steps, {"times": [0.0], "values": [1.0, 2.0]}, "values"),
        (steps, {"times": [0.0], "values": [[1.0, 2.0]]}, "values"),
        (sine, {"amplitude": 1.0, "period": 1.0}, "period"),
        (sine, {"amplitude": [1.0, 2.0], "period": 3.0}, "amplitude"),
        (prbs, {"low": 0.0, "high": 1.0, "hold": 0.75}, "hold"),
        (prbs, {"low": [0.0, 0.0], "high": 1.0}, "low"),
    ],
)
def test_a_wrong_key_is_refused_at_its_place(design, keys, parameter):
    with pytest.raises(DesignError) as caught:
        design(1, 0.5, **keys)
    assert caught.value.parameter == parameter
