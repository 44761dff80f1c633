"""Every registered plant: the rules of the protocol, bit for bit."""

import pickle

import numpy as np
import pytest

from rmpc_bench import registry
from rmpc_bench.types import Plant, Status

KINDS = registry.names("plants")
PARAMETERS = {
    "servo": [{}, {"alpha_l0": 0.0, "alpha_l1": 0.0}],
    "servo-linear": [{}],
}
"""Parameters that make a design of each kind; a new kind gets a line here."""
CASES = [(kind, number) for kind in KINDS for number in range(len(PARAMETERS.get(kind, [])))]
RUNS, STEPS = 9, 10


def test_every_registered_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def case(request):
    """Return a plant with parameters within 10 % of the nominal ones, start, inputs and noises of a block."""
    kind, number = request.param
    plant, rng = registry.get("plants", kind)(0.1, **PARAMETERS[kind][number]), np.random.default_rng(13)
    parameters = {name: value * rng.uniform(0.9, 1.1, RUNS) for name, value in plant.nominal.items()}
    shapes = ((RUNS, plant.nx), (RUNS, STEPS, plant.nu), (RUNS, STEPS, plant.nw), (RUNS, STEPS, plant.nv))
    x, u, w, v = (rng.standard_normal(shape) for shape in shapes)
    return plant, parameters, x, 20.0 * u, 0.1 * w, v


def generators(rows):
    """One generator per run, the same for a run in whatever block."""
    return [np.random.default_rng((99, int(row))) for row in rows]


def run(plant, parameters, x, u, w, v, rows=range(RUNS)):
    """States, outputs and statuses of some rows over time: (rows, samples, nx), (rows, samples, ny), (rows,)."""
    rows = list(rows)
    delta = plant.draw({name: values[rows] for name, values in parameters.items()}, generators(rows), STEPS)
    x, xs, ys = x[rows], [], []
    for k in range(STEPS):
        ys.append(plant.output(k, delta, x, v[rows, k]))
        x, status = plant.step(k, delta, x, u[rows, k], w[rows, k])
        xs.append(x)
    return np.stack(xs, axis=1), np.stack(ys, axis=1), status


def same(left, right):
    """Assert that two tuples of arrays agree bit for bit."""
    for a, b in zip(left, right, strict=True):
        np.testing.assert_array_equal(a, b)


def test_it_is_a_plant(case):
    """Oracle: the protocol of types.py; a design is frozen."""
    plant = case[0]
    assert isinstance(plant, Plant)
    assert plant.Ts == 0.1
    with pytest.raises(AttributeError):
        plant.something_new = 1


def test_shapes_and_statuses(case):
    """Oracle: axis 0 is the run; status is int8."""
    plant = case[0]
    x, y, status = run(*case)
    assert x.shape == (RUNS, STEPS, plant.nx) and y.shape == (RUNS, STEPS, plant.ny)
    assert x.dtype == y.dtype == np.float64
    np.testing.assert_array_equal(status, np.full(RUNS, Status.OK, dtype=np.int8))
    assert status.dtype == np.int8


def test_arguments_are_left_alone(case):
    """Oracle: copies of all arrays, those of delta included, taken before the calls."""
    plant, parameters, x, u, w, v = case
    before = [values.copy() for values in (*parameters.values(), x, u, w, v)]
    delta = plant.draw(parameters, generators(range(RUNS)), STEPS)
    drawn = [values.copy() for values in delta]
    plant.step(0, delta, x, u[:, 0], w[:, 0])
    plant.output(0, delta, x, v[:, 0])
    same((*parameters.values(), x, u, w, v), before)
    same(delta, drawn)


def test_the_same_call_twice_gives_the_same_bits(case):
    """Oracle: the plant has no memory."""
    plant, parameters, x, u, w, _ = case
    delta = plant.draw(parameters, generators(range(RUNS)), STEPS)
    same(plant.step(0, delta, x, u[:, 0], w[:, 0]), plant.step(0, delta, x, u[:, 0], w[:, 0]))
    same(run(*case), run(*case))


def test_a_row_equals_a_batch_of_one(case):
    """Oracle: each run alone, drawn and simulated, bit for bit."""
    together = run(*case)
    for i in range(RUNS):
        same(run(*case, rows=[i]), [part[i : i + 1] for part in together])


def test_permuting_runs_permutes_results(case):
    """Oracle: the runs in another order, bit for bit."""
    order = np.random.default_rng(5).permutation(RUNS)
    same(run(*case, rows=order), [part[order] for part in run(*case)])


def test_a_pickle_gives_the_same_bits(case):
    """Oracle: the plant before its trip to a worker."""
    same(run(pickle.loads(pickle.dumps(case[0])), *case[1:]), run(*case))


@pytest.mark.parametrize("broken", ["u", "x"])
def test_a_missing_number_leaves_the_other_runs_alone(case, broken):
    """Oracle: the block without it, bit for bit."""
    plant, parameters, x, u, w, v = case
    expected = run(*case)
    x, u = x.copy(), u.copy()
    if broken == "u":
        u[4, 3] = np.nan
    else:
        x[4, 0] = np.nan
    ours = run(plant, parameters, x, u, w, v)
    same([np.delete(part, 4, axis=0) for part in ours], [np.delete(part, 4, axis=0) for part in expected])
    assert np.isnan(ours[0][4]).any()


def test_the_nominal_parameters_are_admissible(case):
    """Oracle: every name that `perturb` may use has a finite value and no status."""
    plant = case[0]
    assert all(np.isfinite(value) for value in plant.nominal.values())
    parameters = {name: np.array([value]) for name, value in plant.nominal.items()}
    delta = plant.draw(parameters, generators([0]), 1)
    motion = plant.step(0, delta, np.zeros((1, plant.nx)), np.zeros((1, plant.nu)), np.zeros((1, plant.nw)))
    np.testing.assert_array_equal(motion.status, [Status.OK])
