"""Durations and sizes with units, and the section that uses them."""

import pytest
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.engines.choice import limits_of
from rmpc_bench.expressions.units import n_bytes, seconds
from rmpc_bench.types import ConfigError


@pytest.mark.parametrize(
    ("text", "value"), [("1 s", 1.0), ("200ms", 0.2), ("1.5 min", 90.0), ("1 h", 3600.0), (3, 3.0)]
)
def test_durations(text, value):
    """In seconds."""
    assert seconds(text) == pytest.approx(value, rel=1e-15)  # one product


@pytest.mark.parametrize(("text", "value"), [("2 GB", 2 * 10**9), ("2 GiB", 2**31), ("500 MB", 5 * 10**8)])
def test_sizes(text, value):
    """In bytes."""
    assert n_bytes(text) == value


@pytest.mark.parametrize("text", ["1 parsec", "s", "-1 s", "0 s", "1", ""])
def test_wrong_durations(text):
    """The message has the units or the reason."""
    with pytest.raises(ValueError, match=r"the units are ms, s, min, h|longer than 0"):
        seconds(text)


def test_limits_of_a_configuration(tmp_path):
    """With units, in the resolved configuration too; without the section there are none."""
    keys = "{timeout: {step: 200 ms, run: 60}, memory: 2 GB}"
    config = load_config(write(tmp_path, execution=keys))
    assert limits_of(config.execution) == (0.2, 60.0, 2 * 10**9, "2 GB")
    assert limits_of(load_config(write(tmp_path)).execution) == (None, None, None, "")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("{memory: 2 cups}", "must be a size such as '2 GB' or '500 MB'"),
        ("{timeout: {step: 1 day}}", "must be a duration such as '1 s' or '200 ms'"),
    ],
)
def test_a_wrong_unit_is_a_problem_of_the_file(tmp_path, keys, message):
    """With its place."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, execution=keys))
    assert "tiny.yaml:" in str(caught.value) and message in str(caught.value)
