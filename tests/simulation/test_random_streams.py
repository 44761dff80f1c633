"""Random streams of many runs at once; oracle: the generators of NumPy, run by run."""

import hashlib
import math

import numpy as np
import pytest

from rmpc_bench.config.plant import UncertainParameter
from rmpc_bench.expressions.quantity import parse
from rmpc_bench.plants import servo
from rmpc_bench.simulation.random_streams import Streams, first_uniforms, stream
from rmpc_bench.simulation.scenario import one_by_one

LARGE = 2**32


@pytest.mark.parametrize("seed", [0, 1, 20180418, LARGE - 1, LARGE, 2**70 + 5, 2**200 + 3])
@pytest.mark.parametrize("runs", [range(40), range(123456, 123459), range(LARGE - 3, LARGE + 2), range(0)], ids=str)
def test_first_numbers(seed, runs):
    """Bit for bit, for seeds of one to seven words and runs of one and two words."""
    for name in ("uncertainty/eps_min", "delta"):
        expected = [stream(seed, run, name).random() for run in runs]
        assert first_uniforms(seed, runs, name).tolist() == expected


def test_the_stream_has_the_key_of_its_run_and_name():
    """Oracle: a seed sequence written out; the words are the first eight bytes of the hash of the name."""
    digest = hashlib.sha256(b"v/0").digest()
    key = (3, int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little"))
    expected = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=key)))
    assert stream(7, 3, "v/0").random(5).tolist() == expected.random(5).tolist()


def test_generators_are_made_when_they_are_asked_for():
    """The same object every time, equal to that of the run; slices and loops work as those of a list."""
    made = Streams(5, range(10, 14), "delta")
    assert len(made) == 4 and made[1] is made[1] and made[-1] is made[3]
    assert [each.random() for each in made] == [stream(5, run, "delta").random() for run in range(10, 14)]
    assert made[1:3] == [made[1], made[2]]
    with pytest.raises(IndexError):
        made[4]


@pytest.mark.parametrize("text", ["1 + a", "2*a - b/3", "-(a - 20%)*b", "a/(b - 0.5)", "sqrt(a + 2)", "pi*a", "7"])
def test_parameters_of_many_runs(text):
    """Oracle: the expression run by run; functions and runs without a finite value included."""
    rng = np.random.default_rng(3)
    columns = {"a": rng.standard_normal(50), "b": rng.standard_normal(50)}
    columns["b"][7] = 0.5
    parameter = UncertainParameter(parse(text, ("a", "b")), 1.7)
    found = parameter.of_runs(columns, 50)
    np.testing.assert_array_equal(found, one_by_one(parameter, columns, 50))
    assert np.isnan(found[7]) == (text == "a/(b - 0.5)")


def test_coefficients_of_the_servomechanism_in_batch():
    """Oracle: the coefficients of every run alone; a run that is not admissible has the nominal ones."""
    rng, plant = np.random.default_rng(8), servo.design(0.1)
    parameters = {name: value * rng.uniform(0.2, 3.0, 30) for name, value in plant.nominal.items()}
    parameters["J_m"][4], parameters["L"][5], parameters["R"][6] = -1.0, 1e-9, math.nan
    delta = plant.draw(parameters, [], 1)
    assert np.flatnonzero(delta.status).tolist() == [4, 5, 6]
    for row in range(30):
        p = plant.nominal if delta.status[row] else {name: float(values[row]) for name, values in parameters.items()}
        linear, friction = servo.coefficients(p)
        np.testing.assert_array_equal(delta.linear[row], linear)
        np.testing.assert_array_equal(delta.friction[row], friction)
