"""Late and rarely measured samples: the draws of the laws `delayed` and `missing`, by hand and by their shares."""

import numpy as np
import pytest
from conftest import within_stat

from rmpc_bench.noise.measurement import delayed, missing, quantised
from rmpc_bench.types import DesignError

NAMES = ("position", "speed")


def fresh(seed=1):
    """Generator of a run."""
    return np.random.default_rng(seed)


@pytest.mark.parametrize("only", [["speed"], [1]])
def test_a_constant_delay_of_one_output(only):
    """Oracle: the numbers of the file; nothing is drawn."""
    law, rng = delayed(2, signal_names=NAMES, samples=3, only=only), fresh()
    np.testing.assert_array_equal(law.draw(rng, 4), [[0.0, 3.0]] * 4)
    assert rng.random() == fresh().random()
    assert law.longest_delay == 3 and law.omits_measurements
    assert not delayed(2, samples=0).omits_measurements


def test_random_delays_per_step_and_per_run():
    """Oracle: whole numbers, all equally likely, one for all outputs; a longer draw begins with the shorter one."""
    law = delayed(2, samples=[1, 3])
    d = law.draw(fresh(), 30_000)
    assert (d[:, 0] == d[:, 1]).all() and set(d[:, 0]) == {1.0, 2.0, 3.0}
    for each in (1.0, 2.0, 3.0):
        assert within_stat((d[:, 0] == each).astype(float), 1.0 / 3.0)
    np.testing.assert_array_equal(law.draw(fresh(), 10), d[:10])
    per_run = delayed(2, samples=[0, 5], per="run")
    values = np.array([per_run.draw(fresh(run), 3) for run in range(3000)])
    assert (values == values[:, :1]).all()
    assert within_stat(values[:, 0, 0], 2.5)


def test_a_slow_sensor():
    """Oracle: k = first + i m by hand; other outputs are not concerned; losses at random come on top."""
    law = missing(2, signal_names=NAMES, every=4, first=1, only=["position"])
    lost = law.draw(fresh(), 10)
    np.testing.assert_array_equal(np.flatnonzero(lost[:, 0] == 0.0), [1, 5, 9])
    assert not lost[:, 1].any()
    both = missing(1, every=4, probability=0.3).draw(fresh(), 40_000)[:, 0]
    assert within_stat(both[::4], 0.3) and both.reshape(-1, 4)[:, 1:].all()


def test_outputs_of_a_law_are_those_that_it_concerns():
    """Oracle: `each` draws for the two outputs of `only`, from the stream of a law of two outputs."""
    law, of_two = missing(3, probability=0.5, outputs="each", only=[0, 2]), missing(2, probability=0.5, outputs="each")
    lost = law.draw(fresh(), 50)
    np.testing.assert_array_equal(lost[:, [0, 2]], of_two.draw(fresh(), 50))
    assert not lost[:, 1].any()


@pytest.mark.parametrize(
    ("design", "keys", "key", "message"),
    [
        (delayed, {"samples": 101}, "samples", "from 0 to 100"),
        (delayed, {"samples": [2, 1]}, "samples", "[low, high]"),
        (delayed, {"samples": 1, "only": ["postion"]}, "only.0", "did you mean 'position'?"),
        (delayed, {"samples": 1, "only": [2]}, "only.0", "the signal has 2"),
        (delayed, {"samples": 1, "only": ["position", 0]}, "only.1", "twice"),
        (delayed, {"samples": 1, "only": []}, "only", "at least one"),
        (missing, {}, "", "`probability`, `every` or both"),
        (delayed, {"samples": 2, "per": "run"}, "per", "no effect on a constant delay"),
        (delayed, {"samples": [2, 2], "per": "run"}, "per", "no effect on a constant delay"),
        (missing, {"every": 4, "outputs": "each"}, "outputs", "without `probability`"),
        (missing, {"every": 4, "first": 4}, "first", "less than `every` (got 4)"),
        (quantised, {"step": [0.1, 0.2], "only": ["position"]}, "step", "1 number"),
        (quantised, {"step": 0.1, "offset": [0.0, 1.0], "only": [0]}, "offset", "1 number"),
        (missing, {"every": 2, "gap": 2.0}, "gap", "without `probability`"),
        (missing, {"probability": 0.1, "first": 2}, "first", "without `every`"),
    ],
)
def test_design_errors(design, keys, key, message):
    """Oracle: the docstrings."""
    with pytest.raises(DesignError) as caught:
        design(2, signal_names=NAMES, **keys)
    assert message in str(caught.value) and caught.value.parameter == key
