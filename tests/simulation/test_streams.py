"""Random streams: run i depends on (seed, i, name of the stream) and on nothing else."""

import numpy as np
import pytest
from simulation.toy import Walk

from rmpc_bench.noise.bounded import uniform
from rmpc_bench.noise.bursts import RandomBursts
from rmpc_bench.noise.distributions import Uniform
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.plants import servo
from rmpc_bench.simulation.random_streams import stream
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Scenario

SEED = 20180418
# The first 8 bytes of `printf NAME | sha256sum`, read as two little-endian words.
WORDS = {
    "uncertainty/eps_min": (0xFF6E54D0, 0x818C8BDE),  # d0546eff de8b8c81
    "delta": (0x10944A4F, 0x95F8CDFF),  # 4f4a9410 ffcdf895
    "w/0": (0x0CF89BA9, 0xAA5DD7CF),  # a99bf80c cfd75daa
    "v/0": (0x5B2D6D71, 0xF621A304),  # 716d2d5b 04a321f6
    "x0": (0xEE140AB7, 0xAAD7151E),  # b70a14ee 1e15d7aa
    "x0/1": (0x084357B5, 0xFF2E4DE9),  # b5574308 e94d2eff
}


def golden(run, name):
    """Generator of a stream, rebuilt from house.md section 5 and the words above."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(SEED, spawn_key=(run, *WORDS[name]))))


def scenario(**changes):
    """Two uncertain quantities, of which the plant uses one; all kinds of noise."""
    parts = {
        "seed": SEED,
        "uncertainty": {"eps_max": Uniform(-0.2, 0.2), "eps_min": Uniform(-0.1, 0.1)},
        "parameters": {"a": lambda values: 0.9 * (1.0 + values["eps_min"])},
        "x0": np.zeros(1),
        "x0_noise": (gaussian(1, std=0.5),),
        "process": (gaussian(1, std=0.1),),
        "measurement": (gaussian(1, std=0.2),),
        "reference": constant(1, value=1.0),
    }
    return Scenario(**{**parts, **changes})


@pytest.mark.parametrize("name", WORDS)
@pytest.mark.parametrize("run", [0, 1, 4711, 2**31])
def test_a_stream_has_the_documented_seed(name, run):
    """Oracle: NumPy's SeedSequence with the spawn key written out; PCG64 of it."""
    np.testing.assert_array_equal(stream(SEED, run, name).random(20), golden(run, name).random(20))


@pytest.mark.parametrize("run", [0, 3, 199])
def test_a_named_value_is_one_uniform_number_through_the_quantile(run):
    """Oracle: the golden stream; low + (high - low) p."""
    p = golden(run, "uncertainty/eps_min").random()
    assert scenario().named_values(run)["eps_min"] == -0.1 + 0.2 * p


def test_noise_is_drawn_from_the_streams_of_its_terms():
    """Oracle: the golden streams; the standard deviations times standard normals."""
    draws = scenario().draw(Walk(), range(5, 8), 10)
    for row, run in enumerate(range(5, 8)):
        np.testing.assert_array_equal(draws.w[row], 0.1 * golden(run, "w/0").standard_normal((11, 1)))
        np.testing.assert_array_equal(draws.v[row], 0.2 * golden(run, "v/0").standard_normal((11, 1)))


def test_the_plant_gets_the_stream_delta_of_every_run():
    """Oracle: the golden streams."""
    seen = []

    class Curious(Walk):
        def draw(self, parameters, rngs, n_steps):
            seen.extend(rng.random() for rng in rngs)
            return super().draw(parameters, rngs, n_steps)

    scenario().draw(Curious(), range(2, 5), 10)
    assert seen == [golden(run, "delta").random() for run in range(2, 5)]


def everything(draws):
    """All arrays of a draw."""
    return [*draws.delta, draws.x0, draws.w, draws.v]


def test_the_first_50_runs_of_200_are_the_50_runs():
    """Oracle: promise 1 of product.md section 6, bit for bit."""
    for plant, changes in ((Walk(), {}), (servo.design(0.1), {"x0": np.zeros(5), "x0_noise": (), "parameters": {}})):
        some = scenario(**changes)
        if plant.nx == 5:
            some = scenario(**changes, process=(gaussian(4, std=0.1),))
        few, many = some.draw(plant, range(50), 10), some.draw(plant, range(200), 10)
        for a, b in zip(everything(few), everything(many), strict=True):
            np.testing.assert_array_equal(a, b[:50])


def test_a_longer_experiment_begins_with_the_shorter_one():
    """Oracle: samples are drawn in the order of time."""
    short, long = scenario().draw(Walk(), range(3), 10), scenario().draw(Walk(), range(3), 30)
    np.testing.assert_array_equal(long.w[:, :11], short.w)
    np.testing.assert_array_equal(long.v[:, :11], short.v)


def test_another_quantity_does_not_disturb_the_others():
    """Oracle: adding a stream leaves all the others."""
    more = {"new": Uniform(0.0, 1.0), **scenario().uncertainty}
    for run in range(5):
        before, after = scenario().named_values(run), scenario(uncertainty=more).named_values(run)
        assert before == {name: after[name] for name in before}


def test_a_second_term_of_noise_adds_to_the_first():
    """Oracle: independent streams per term, summed."""
    one = scenario().draw(Walk(), range(3), 10).w
    two = scenario(process=(gaussian(1, std=0.1), gaussian(1, std=1.0))).draw(Walk(), range(3), 10).w
    second = [stream(SEED, run, "w/1").standard_normal((11, 1)) for run in range(3)]
    np.testing.assert_array_equal(two, one + second)


def test_the_terms_of_the_initial_state_have_streams_too():
    """Oracle: the golden streams `x0` and `x0/1`; the first is the only one where there is one term."""
    laws = gaussian(1, std=0.5), gaussian(1, std=3.0, mean=1.0)
    one, two = (scenario(x0_noise=laws[:n], x0=np.array([4.0])).draw(Walk(), range(5), 2).x0 for n in (1, 2))
    for run in range(5):
        first, second = (golden(run, name).standard_normal() for name in ("x0", "x0/1"))
        assert one[run] == 4.0 + 0.5 * first
        assert two[run] == one[run] + (1.0 + 3.0 * second)
    mean, cov = scenario(x0_noise=laws, x0=np.array([4.0])).initial_law()
    assert (mean.tolist(), cov.tolist()) == ([5.0], [[9.25]])


FIXED = uniform(1, 0.5, radius=1.0, bursts=[Burst(1.0, 2.0, 2.0)])  # samples 2 to 4 of 0.5 s
DRAWN = uniform(1, 0.5, radius=1.0, bursts=RandomBursts([(0.0, 4.0), (4.0, 9.0)], (0.5, 2.0), (2.0, 4.0)))


def test_bursts_of_the_measurement_noise():
    """Oracle: the law itself, asked with the golden stream of its term; terms of w do not count, two of v both do."""
    plain = gaussian(1, std=0.2)
    for terms, names in (((plain, FIXED), ()), ((DRAWN,), ("v/0",)), ((DRAWN, FIXED), ("v/0",))):
        draws = scenario(measurement=terms, process=(FIXED,)).draw(Walk(), range(5, 9), 20)
        expected = np.zeros((4, 21), dtype=bool)
        expected[:, 2:5] = FIXED in terms
        for row, run in enumerate(range(5, 9)):
            for name in names:
                expected[row] |= DRAWN.in_burst(golden(run, name), 21)
        np.testing.assert_array_equal(draws.bursts, expected)
    assert scenario(process=(FIXED,)).draw(Walk(), range(2), 20).bursts is None
    assert len({tuple(row) for row in scenario(measurement=(DRAWN,)).draw(Walk(), range(9), 20).bursts}) > 4


def test_random_bursts_depend_on_nothing_else():
    """Oracle: promise 1 of product.md section 6, bit for bit: runs, length, and the noise beside the bursts."""
    some = scenario(measurement=(DRAWN,))
    few, many = some.draw(Walk(), range(5), 10), some.draw(Walk(), range(2, 50), 30)
    for one, two in ((few.v, many.v), (few.bursts, many.bursts)):
        np.testing.assert_array_equal(one[2:], two[:3, :11])
    steady = scenario(measurement=(uniform(1, radius=1.0),)).draw(Walk(), range(5), 10)
    np.testing.assert_array_equal(few.v[~few.bursts], steady.v[~few.bursts])
    assert steady.bursts is None and (few.v[few.bursts] != steady.v[few.bursts]).all()
    for run in range(5):
        assert some.named_values(run) == scenario().named_values(run)


def test_what_random_bursts_have_drawn():
    """Oracle: the golden streams; names begin with the term where there are several laws that draw."""
    one = scenario(measurement=(gaussian(1, std=0.1), DRAWN), process=(FIXED,))
    assert one.burst_names == DRAWN.burst_names and len(one.burst_names) == 5
    assert one.burst_values(3) == DRAWN.burst_values(stream(SEED, 3, "v/1"))
    two = scenario(measurement=(DRAWN,), process=(DRAWN,))
    assert two.burst_names == tuple(f"{term}_{name}" for term in ("w0", "v0") for name in DRAWN.burst_names)
    expected = {"w0": DRAWN.burst_values(golden(3, "w/0")), "v0": DRAWN.burst_values(golden(3, "v/0"))}
    assert two.burst_values(3) == {f"{a}_{name}": x for a, drawn in expected.items() for name, x in drawn.items()}
    assert scenario(measurement=(FIXED,)).burst_values(3) == {} and scenario().burst_names == ()


@pytest.mark.parametrize("bound", [0.4, 0.05])
def test_a_doubled_bound_doubles_the_same_draws(bound):
    """Oracle: inverse transform; +-80 % is +-40 % times two, exactly."""
    narrow = scenario(uncertainty={"eps": Uniform(-bound, bound)})
    wide = scenario(uncertainty={"eps": Uniform(-2 * bound, 2 * bound)})
    for run in range(100):
        assert wide.named_values(run)["eps"] == 2.0 * narrow.named_values(run)["eps"]


def test_parameters_follow_the_named_values_and_the_others_stay_nominal():
    """Oracle: by hand."""
    draws = scenario().draw(Walk(), range(4), 3)
    expected = [0.9 * (1.0 + scenario().named_values(run)["eps_min"]) for run in range(4)]
    np.testing.assert_array_equal(draws.delta.a, expected)
    np.testing.assert_array_equal(scenario(parameters={}).draw(Walk(0.7), range(4), 3).delta.a, np.full(4, 0.7))


def test_without_noise_nothing_is_random():
    """Oracle: zeros."""
    draws = scenario(x0_noise=(), process=(), measurement=(), x0=np.array([2.0])).draw(Walk(), range(3), 4)
    np.testing.assert_array_equal(draws.x0, np.full((3, 1), 2.0))
    np.testing.assert_array_equal(draws.w, np.zeros((3, 5, 1)))
    np.testing.assert_array_equal(draws.v, np.zeros((3, 5, 1)))


def test_streams_of_runs_and_names_are_uncorrelated():
    """Oracle: correlation of 4000 numbers within 5 standard errors (STAT) of 0."""
    n = 4000
    streams = [stream(SEED, run, name).standard_normal(n) for run in (0, 1, 2) for name in ("v/0", "v/1", "w/0")]
    correlation = np.corrcoef(streams) - np.eye(len(streams))
    assert np.abs(correlation).max() < 5.0 / np.sqrt(n)
