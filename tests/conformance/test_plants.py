"""Every registered plant: the rules of the base class, bit for bit."""

import pickle

import numpy as np
import pytest

from rmpc_bench import registry
from rmpc_bench.plants.uncertainty import Uncertainty
from rmpc_bench.types import Plant, Status

KINDS = registry.names("plants")
RUNS, STEPS = 9, 10
UNCERTAIN = {
    "n_steps": STEPS, "A": [[0.5, 1.0, 0.1], [0.0, 0.3, -1.0], [0.2, 0.0, 0.9]],
    "B": [[1.0, 0.5], [0.0, 1.0], [-1.0, 2.0]], "C": [[1.0, 2.0, -1.0], [0.0, 1.0, 0.3]],
    "Bw": 1.5, "Bv": [[0.1, 0.2], [0.3, 0.0], [0.7, -0.1]],
    "Dw": [[0.3, 0.1, -0.9], [1.0, 0.0, 0.3]], "Dv": [2.0, lambda at: 1.0 + at["k"]],
    "H_A": [[0.1, 0.3], [0.7, -0.1], [0.2, 0.2]], "H_C": [[0.1, 0.9], [0.3, -0.4]],
    "G_x": [[1.0, 0.3, 0.1], [0.1, 0.7, 0.3], [0.9, -0.2, 0.4]],
    "H_Bw": [[0.1], [0.2], [0.3]], "H_Dw": [[0.7], [0.1]], "G_w": [[0.1, lambda at: 0.1 * at["k"], 0.3]],
    "H_Bv": 0.3, "H_Dv": [[0.1, 0.7, 0.2], [0.3, 0.1, 0.9]], "G_v": [[0.9, 0.1], [0.3, 0.7]],
}  # fmt: skip
PARAMETERS = {
    "linear": [
        {"n_steps": STEPS, "A": 0.9, "B": 1.0, "C": 1.0},
        {
            "n_steps": STEPS,
            "A": [[0.5, lambda at: 0.1 * at["k"]], [0.0, 0.9]],
            "B": [[1.0], [0.3]],
            "C": [[0.2, 1.0], [1.0, 0.0], [0.3, 0.1]],
        },  # fmt: skip
    ],
    "moving-slide": [{}, {"substeps": 1, "mass": 2.0}],
    "servo": [{}, {"alpha_l0": 0.0, "alpha_l1": 0.0}],
    "servo-linear": [{}],
    "uncertain-linear": [
        {"n_steps": STEPS, "A": 0.9, "B": 1.0, "C": 1.0, "Bw": 1.0, "H_A": 0.1, "H_C": 0.2, "G_x": 1.0},
        UNCERTAIN,
        UNCERTAIN | {"uncertainty": Uncertainty("extremes", -0.3, 0.7, per="run")},
        UNCERTAIN | {"uncertainty": Uncertainty("fixed", value={"x": -1.0})},
    ],
}
"""Parameters that make a design of each kind; a new kind gets a line here."""
SIZES = {"moving-slide": 0.005}
"""Of start, inputs and noises, where 1 would leave what a plant is made for."""
CASES = [(kind, number) for kind in KINDS for number in range(len(PARAMETERS.get(kind, [])))]


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
    x, u, w, v = (SIZES.get(kind, 1.0) * rng.standard_normal(shape) for shape in shapes)
    return plant, parameters, x, 20.0 * u, 0.1 * w, v


def generators(rows):
    """One generator per run, the same for a run in whatever block."""
    return [np.random.default_rng((99, int(row))) for row in rows]


def drawn(plant, parameters, w, v, rows=range(RUNS)):
    """What a plant draws for some rows, and the noises that its step and output get: samples k = 0..STEPS-1."""
    delta = plant.draw(parameters, generators(rows), w.shape[1] - 1)
    return delta, *plant.mix(delta, w, v)


def run(plant, parameters, x, u, w, v, rows=range(RUNS)):
    """States, outputs and statuses of some rows over time: (rows, samples, nx), (rows, samples, ny), (rows,)."""
    rows = list(rows)
    parameters = {name: values[rows] for name, values in parameters.items()}
    delta, w, v = drawn(plant, parameters, w[rows], v[rows], rows)
    x, xs, ys = x[rows], [], []
    for k in range(STEPS):
        ys.append(plant.output(k, delta, x, v[:, k]))
        x, status = plant.step(k, delta, x, u[rows, k], w[:, k])
        xs.append(x)
    return np.stack(xs, axis=1), np.stack(ys, axis=1), status


def same(left, right):
    """Assert that two tuples of arrays agree bit for bit."""
    for a, b in zip(left, right, strict=True):
        np.testing.assert_array_equal(a, b)


def test_it_is_a_plant(case):
    """Oracle: the base class; a design is frozen."""
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
    delta, mixed_w, mixed_v = drawn(plant, parameters, w, v)
    kept = [values.copy() for values in (*delta, mixed_w, mixed_v)]
    plant.step(0, delta, x, u[:, 0], mixed_w[:, 0])
    plant.output(0, delta, x, mixed_v[:, 0])
    same((*parameters.values(), x, u, w, v), before)
    same((*delta, mixed_w, mixed_v), kept)


def test_the_same_call_twice_gives_the_same_bits(case):
    """Oracle: the plant has no memory."""
    plant, parameters, x, u, w, v = case
    delta, w, _ = drawn(plant, parameters, w, v)
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


@pytest.mark.parametrize("broken", ["w", "v"])
def test_a_missing_noise_leaves_the_other_runs_alone(case, broken):
    """Oracle: the block without it, bit for bit."""
    plant, parameters, x, u, w, v = case
    expected, (w, v) = run(*case), (w.copy(), v.copy())
    (w if broken == "w" else v)[4, 3] = np.nan
    ours = run(plant, parameters, x, u, w, v)
    same([np.delete(part, 4, axis=0) for part in ours], [np.delete(part, 4, axis=0) for part in expected])


def test_the_nominal_parameters_are_admissible(case):
    """Oracle: every name that `perturb` may use has a finite value and no status."""
    plant = case[0]
    assert all(np.isfinite(value) for value in plant.nominal.values())
    parameters = {name: np.array([value]) for name, value in plant.nominal.items()}
    delta, w, _ = drawn(plant, parameters, np.zeros((1, 2, plant.nw)), np.zeros((1, 2, plant.nv)), [0])
    motion = plant.step(0, delta, np.zeros((1, plant.nx)), np.zeros((1, plant.nu)), w[:, 0])
    np.testing.assert_array_equal(motion.status, [Status.OK])
