"""Draws of a block; oracle: the laws run by run, each with the stream of its run."""

from dataclasses import dataclass

import numpy as np
import pytest
from conftest import random_psd
from noise.test_bursts import LAWS, PAPER, RANDOM
from simulation.toy import Walk

from rmpc_bench import registry
from rmpc_bench.models.uncertain_system import uncertain_system
from rmpc_bench.noise.gaussian import Gaussian, gaussian
from rmpc_bench.noise.measurement import missing
from rmpc_bench.plants.uncertain_linear import UncertainLinear, Uncertainty
from rmpc_bench.simulation.random_streams import FEW, Streams, stream
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import Noise

RUNS = [range(1), range(3, 2 + FEW), range(3, 3 + FEW), range(100, 133), range(2**32 - 9, 2**32 + 9)]


class Wide(Walk):
    """A plant with n states and as many noises."""

    def __init__(self, n):
        super().__init__()
        self.nx = self.nw = self.nv = n


def drawn(n, runs, n_steps, w=(), v=(), x0=()):
    """Draw a block with these laws."""
    scenario = Scenario(5, {}, {}, np.linspace(1.0, 2.0, n), tuple(x0), tuple(w), tuple(v), constant(n, value=0.0))
    return scenario.draw(Wide(n), runs, n_steps)


def assert_summed(found, laws, names, runs, n_samples, start):
    """Compare with the sum of the laws, in their order."""
    for row, run in zip(found, runs, strict=True):
        expected = start
        for law, name in zip(laws, names, strict=True):
            expected = expected + law.draw(stream(5, run, name), n_samples)
        np.testing.assert_array_equal(np.broadcast_to(expected, row.shape), row)


@pytest.mark.parametrize("runs", RUNS, ids=str)
@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 8, 9, 16, 17])
def test_gaussian_noise_of_a_block(n, runs, rng):
    """Bit for bit, with roots of all numbers and in both orders of memory; sums change at 8 numbers."""
    root = np.linalg.cholesky(random_psd(rng, n, 10.0, n))
    full = Gaussian(rng.standard_normal(n), np.asfortranarray(root))
    laws = (full, gaussian(n, std=0.3), Gaussian(np.full(n, -0.0), root))
    for n_steps in (0, 20):
        draws = drawn(n, runs, n_steps, laws, laws[:1], laws)
        assert_summed(draws.w, laws, ("w/0", "w/1", "w/2"), runs, n_steps + 1, np.zeros((n_steps + 1, n)))
        assert_summed(draws.v, laws[:1], ("v/0",), runs, n_steps + 1, np.zeros((n_steps + 1, n)))
        assert_summed(draws.x0[:, None], laws, ("x0", "x0/1", "x0/2"), runs, 1, np.linspace(1.0, 2.0, n))


@pytest.mark.parametrize("bursts", [None, PAPER, RANDOM], ids=["none", "fixed", "random"])
@pytest.mark.parametrize("kind", [*LAWS, "drift"])
def test_every_law_of_a_block(kind, bursts):
    """Bit for bit, laws with children of their generator and bursts included."""
    law = registry.get("noises", kind)(2, 0.05, **LAWS.get(kind, {"std": 1.0}), bursts=bursts)
    for runs in RUNS:
        draws = drawn(2, runs, 160, [law, gaussian(2, std=1.0), law], [law])
        assert_summed(draws.w, (law, gaussian(2, std=1.0), law), ("w/0", "w/1", "w/2"), runs, 161, np.zeros((161, 2)))
        if bursts is not None:
            expected = [law.in_burst(stream(5, run, "v/0"), 161) for run in runs]
            np.testing.assert_array_equal(draws.bursts, expected)


def test_missing_measurements_of_a_block():
    """The numbers of a law that alters measurements."""
    law, runs = missing(2, probability=0.3, gap=2.0), range(40)
    [alteration] = drawn(2, runs, 20, v=[gaussian(2, std=1.0), law]).alterations
    np.testing.assert_array_equal(alteration.drawn, [law.draw(stream(5, run, "v/1"), 21) for run in runs])


@dataclass(frozen=True, eq=False)
class Halved(Gaussian):
    """A law of a user with another way to draw."""

    def deviation(self, rng, n_samples):
        """Half the deviation."""
        return 0.5 * super().deviation(rng, n_samples)


def test_a_subclass_of_a_gaussian_law_draws_in_its_own_way():
    """Its own method is called."""
    law = Halved(np.ones(2), np.eye(2))
    assert_summed(drawn(2, range(40), 20, [law]).w, [law], ["w/0"], range(40), 21, np.zeros((21, 2)))


class Reused(Noise):
    """A law of a user that returns the same array in every call."""

    def __init__(self):
        self.numbers = np.zeros((21, 2))

    def draw(self, rng, n_samples):
        """Overwrite the numbers of the run before."""
        return rng.standard_normal(out=self.numbers)


def test_a_law_that_returns_the_same_array_for_every_run():
    """Every run has its own numbers."""
    assert_summed(drawn(2, range(40), 20, [Reused()]).w, [Reused()], ["w/0"], range(40), 21, np.zeros((21, 2)))


@pytest.mark.parametrize("per", ["run", "step"])
@pytest.mark.parametrize("law", ["uniform", "extremes"])
@pytest.mark.parametrize("runs", RUNS, ids=str)
def test_uncertain_matrices_of_a_block(runs, law, per):
    """Those of generators made run by run."""
    two = np.eye(2).tolist()
    system = uncertain_system(20, {"A": two, "C": two, "H_A": two, "G_x": two})
    plant = UncertainLinear(system, Uncertainty(law, per=per), 1.0)
    found = plant.draw({}, Streams(5, runs, "delta"), 20)
    for here, there in zip(found, plant.draw({}, [stream(5, run, "delta") for run in runs], 20), strict=True):
        np.testing.assert_array_equal(here, there)
