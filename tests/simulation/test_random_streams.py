"""Random streams of many runs at once; oracle: the generators of NumPy, run by run."""

import copy
import hashlib
import math
import pickle

import numpy as np
import pytest

from rmpc_bench.config.plant import UncertainParameter
from rmpc_bench.expressions.quantity import parse
from rmpc_bench.noise.bursts import child_of
from rmpc_bench.plants import servo
from rmpc_bench.simulation.random_streams import FEW, Streams, first_uniforms, generators, stream
from rmpc_bench.simulation.scenario import one_by_one

LARGE = 2**32
SEEDS = [0, 1, 20180418, LARGE - 1, LARGE, 2**70 + 5, 2**200 + 3]
RUNS = [
    range(40),
    range(123456, 123456 + FEW),
    range(123456, 123455 + FEW),
    range(LARGE - FEW, LARGE),
    range(LARGE - 20, LARGE + 20),
    range(2**40, 2**40 + FEW),
    range(0),
]
"""All at once, and one by one: too few, or an index of two words."""


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("runs", RUNS, ids=str)
def test_first_numbers(seed, runs):
    """Bit for bit, for seeds of one to seven words and runs of one and two words."""
    for name in ("uncertainty/eps_min", "delta"):
        expected = [stream(seed, run, name).random() for run in runs]
        assert first_uniforms(seed, runs, name).tolist() == expected


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("runs", RUNS, ids=str)
def test_generators_of_many_runs(seed, runs):
    """The state is that of the stream."""
    for name in ("v/0", "delta"):
        expected = [stream(seed, run, name).bit_generator.state for run in runs]
        assert [rng.bit_generator.state for rng in generators(seed, runs, name)] == expected


@pytest.mark.parametrize("altered", [lambda rng: rng, copy.deepcopy, lambda rng: pickle.loads(pickle.dumps(rng))])
def test_seeds_of_generators_of_many_runs(altered):
    """Children, words of other lengths and types, and copies are those of NumPy's seed sequence."""
    for run, rng in zip(range(5, 45), generators(7, range(5, 45), "w/0"), strict=True):
        expected, found = stream(7, run, "w/0"), altered(rng)
        for _ in range(2):
            children, theirs = found.spawn(2), expected.spawn(2)
            assert [child.random() for child in children] == [child.random() for child in theirs]
        assert child_of(found, 3).random() == child_of(expected, 3).random()
        seed, its = found.bit_generator.seed_seq, expected.bit_generator.seed_seq
        for n_words, dtype in ((4, np.uint64), (4, np.uint32), (5, np.uint64)):
            np.testing.assert_array_equal(seed.generate_state(n_words, dtype), its.generate_state(n_words, dtype))
            seed.generate_state(n_words, dtype)[:] = 0
        assert seed.n_children_spawned == its.n_children_spawned == 4 and seed.state == its.state
        assert found.standard_normal(3).tolist() == expected.standard_normal(3).tolist()


def test_the_stream_has_the_key_of_its_run_and_name():
    """Oracle: a seed sequence written out; the words are the first eight bytes of the hash of the name."""
    digest = hashlib.sha256(b"v/0").digest()
    key = (3, int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little"))
    expected = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=key)))
    assert stream(7, 3, "v/0").random(5).tolist() == expected.random(5).tolist()


@pytest.mark.parametrize("n", [4, 40])
def test_generators_are_made_when_they_are_asked_for(n):
    """The same object every time, equal to that of the run; slices and loops work as those of a list."""
    made = Streams(5, range(10, 10 + n), "delta")
    assert len(made) == n and made[1] is made[1] and made[-1] is made[n - 1]
    assert [each.random() for each in made] == [stream(5, run, "delta").random() for run in range(10, 10 + n)]
    assert made[1:3] == [made[1], made[2]]
    with pytest.raises(IndexError):
        made[n]


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
        np.testing.assert_array_equal(delta.coefficients[row], servo.coefficients(p))
