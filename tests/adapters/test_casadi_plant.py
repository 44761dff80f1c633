"""CasADi functions as plants: the numbers of our own integration, blocks, derivatives, and messages."""

import pickle
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("casadi")

import casadi
from adapters.casadi_systems import NAMES, RANGE, STEPS, TS, dae, function, level, symbols, two_tanks
from conftest import EXACT, ROUND
from plants import tanks

from rmpc_bench import load_config, run
from rmpc_bench.adapters.casadi import output_function, step_function
from rmpc_bench.adapters.casadi_plant import plant
from rmpc_bench.models.dynamics import dynamics_of
from rmpc_bench.models.linearised import design as linearise
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.operating_point import At
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError, Status

NOISE = DesignNoise(process=1e-6, measurement=4e-6)
EXAMPLE = Path(__file__).parents[2] / "configs" / "examples" / "casadi.yaml"


def drawn(made, n_runs=9, seed=0):
    """Return random parameters, states and inputs of a block, and its record."""
    rng = np.random.default_rng(seed)
    parameters = {name: value * rng.uniform(0.9, 1.1, n_runs) for name, value in tanks.PARAMETERS.items()}
    x, u = rng.uniform(0.05, 0.5, (n_runs, 2)), rng.uniform(0.0, 20.0, (n_runs, 1))
    return made.draw(parameters, [None] * n_runs, STEPS), x, u


def moved(made, rows=slice(None), n_runs=9):
    """Return x(k+1) of some rows of a block, without noise."""
    delta, x, u = drawn(made, n_runs)
    part = made.draw(dict(zip(tanks.PARAMETERS, delta.numbers[rows].T, strict=True)), [None] * len(x[rows]), STEPS)
    motion = made.step(0, part, x[rows], u[rows], np.zeros_like(x[rows]))
    assert not motion.status.any()
    return motion.x


@pytest.mark.parametrize("method", ["rk4", "LSODA"])
def test_it_has_the_bits_of_the_same_equation_in_numpy(method):
    """Oracle: the plant of the function of NumPy, for parameters that differ from run to run."""
    ours = ode_plant(TS, STEPS, ode=tanks.rhs, output=tanks.output, solver=Solver(method), **NAMES, **RANGE)
    theirs = two_tanks(solver=Solver(method))
    np.testing.assert_allclose(moved(theirs), moved(ours), **EXACT)
    assert theirs.ode.rhs_takes_blocks
    delta, x, _ = drawn(ours)
    np.testing.assert_allclose(theirs.output(0, delta, x, np.zeros((9, 1))), x[:, 1:])


@pytest.mark.parametrize("kind", ["SX", "MX"])
def test_a_run_alone_has_the_bits_of_the_block(kind):
    """Oracle: the block, in which the runs have other neighbours and another number of them."""
    made = two_tanks(function(getattr(casadi, kind)), output=level(getattr(casadi, kind)))
    together = moved(made)
    for i in range(9):
        np.testing.assert_array_equal(moved(made, slice(i, i + 1)), together[i : i + 1])
    np.testing.assert_array_equal(moved(made, np.arange(9)[::-1]), together[::-1])


def test_the_linear_model_has_exact_derivatives():
    """Oracle: the derivatives of the root; those by differences are off by more."""
    made = two_tanks()
    slopes = linearise(TS, made, at=At(x=[0.2, 0.1], u=8.0), noise=NOISE)
    p, x = tanks.PARAMETERS, np.array([0.2, 0.1])
    a = np.array([p["a1"], p["a2"]]) * np.sqrt(tanks.G / (2 * x))
    tangent = dynamics_of(made).slopes(x, np.array([8.0]))
    np.testing.assert_allclose(tangent.A, [[-a[0] / tanks.S1, 0.0], [a[0] / tanks.S2, -a[1] / tanks.S2]], **ROUND)
    np.testing.assert_allclose(tangent.B, [[1e-6 / tanks.S1], [0.0]], **ROUND)
    np.testing.assert_array_equal(slopes.C, [[0.0, 1.0]])
    same = linearise(TS, ode_plant(TS, STEPS, ode=tanks.rhs, output=tanks.output, **NAMES, **RANGE),
                     at=At(x=[0.2, 0.1], u=8.0), noise=NOISE)  # fmt: skip
    np.testing.assert_allclose(slopes.A, same.A, rtol=1e-9, atol=1e-12)


def test_a_kink_at_the_operating_point_is_still_found():
    """CasADi has a derivative of |x| at 0, which is that of neither side."""
    x, u = casadi.SX.sym("x"), casadi.SX.sym("u")
    made = plant(TS, STEPS, casadi=casadi.Function("f", [x, u], [-casadi.fabs(x) + u]), solver=Solver(substeps=1))
    with pytest.raises(DesignError, match="kink"):
        linearise(TS, made, at=At(x=0.0, u=0.0), noise=NOISE)


@pytest.mark.parametrize("given", ["function", "dae"])
def test_the_nonlinear_model_is_a_function_of_casadi_again(given):
    """Oracle: f and h of the model, bit for bit."""
    model = nonlinear(TS, two_tanks({"function": function, "dae": dae}[given]()), noise=NOISE)
    f, h, x, u = step_function(model), output_function(model), np.array([0.2, 0.1]), np.array([8.0])
    np.testing.assert_array_equal(np.ravel(f(x, u).full()), model.f(x, u))
    np.testing.assert_array_equal(np.ravel(h(x).full()), model.h(x))


def test_a_discrete_function_is_called_once_per_sample():
    """Oracle: the matrices of the function, and the time k Ts."""
    t, x, u = casadi.SX.sym("t"), casadi.SX.sym("x", 2), casadi.SX.sym("u")
    step = casadi.Function("step", [t, x, u, casadi.SX.sym("p", 0)], [casadi.vertcat(0.5 * x[1], x[0] + t * u)])
    made = plant(TS, STEPS, casadi=step, discrete=True)
    delta, one = made.draw({}, [None] * 3, STEPS), np.ones((3, 2))
    np.testing.assert_array_equal(made.step(7, delta, one, one[:, :1], 0 * one).x, np.tile([0.5, 1 + 7 * TS], (3, 1)))
    assert dict(made.facts())["equation"] == "x(k+1) = step(t, x, u, p)"


def test_structural_zeros_are_numbers():
    """The result and an input of a function may be sparse; the memory of a call has room for all entries."""
    x, u = casadi.SX.sym("x", 3), casadi.SX.sym("u")
    change = casadi.vertcat(x[0], casadi.SX(1, 1), u)
    made = plant(TS, STEPS, casadi=casadi.Function("f", [x, u], [change]), discrete=True)
    zero = np.zeros((1, 3))
    moved_to = made.step(0, made.draw({}, [None], STEPS), np.array([[1.0, 2.0, 3.0]]), np.array([[4.0]]), zero).x
    assert moved_to.tolist() == [[1.0, 0.0, 4.0]]


def test_a_function_of_python_may_return_the_function():
    """So that a file imports without work, and a configuration names what it wants of it."""
    np.testing.assert_array_equal(moved(two_tanks(function)), moved(two_tanks(function())))


def test_a_solver_that_fails_in_one_run_ends_this_run_only():
    """Naive form: one call of the block, in which the rows after the failed one are not computed.

    The function solves z |z| + z = x, which has a root for every x; at x = 2 it is switched to z^2 + 1 = 0.
    """
    x, z = casadi.SX.sym("x"), casadi.SX.sym("z")
    equation = casadi.if_else(x == 2.0, z * z + 1.0, z * casadi.fabs(z) + z - x)
    root = casadi.rootfinder("root", "newton", {"x": z, "p": x, "g": equation}, {"max_iter": 40})
    X = casadi.MX.sym("x")
    step = casadi.Function("step", [X], [root(0.5, X)])
    starts = np.array([[1.0], [2.0], [3.0], [4.0]])
    buffer, evaluate = step.map(4).buffer()
    naive = np.full(4, 7.0)
    buffer.set_arg(0, starts.data)
    buffer.set_res(0, naive.data)
    with pytest.raises(RuntimeError, match="rootfinder"):
        evaluate()
    assert naive[2:].tolist() == [7.0, 7.0]

    made = plant(TS, STEPS, casadi=step, discrete=True, x0=[1.0])
    delta = made.draw({}, [None] * 4, STEPS)
    motion = made.step(0, delta, starts, np.zeros((4, 0)), np.zeros((4, 1)))
    assert motion.status.tolist() == [Status.OK, Status.NOT_CONVERGED, Status.OK, Status.OK]
    found = np.delete(motion.x[:, 0], 1)
    np.testing.assert_allclose(found * np.abs(found) + found, [1.0, 3.0, 4.0], rtol=1e-9)


def test_a_plant_that_was_used_can_be_sent_to_another_process():
    """Naive form: the memory of a call cannot be pickled."""
    with pytest.raises(TypeError, match="pickle"):
        pickle.dumps(function().buffer()[0])
    made = two_tanks()
    before = moved(made)
    np.testing.assert_array_equal(moved(pickle.loads(pickle.dumps(made))), before)


@pytest.mark.parametrize(
    ("keys", "key", "message"),
    [
        ({"casadi": 3.0}, "casadi", r"must be a casadi\.Function, a dict .* \(got float\)"),
        ({"casadi": {"x": 1.0, "dae": 2.0}}, "casadi", r"has x and ode.* \(got x, dae\)"),
        ({"casadi": casadi.Function("f", [], [1.0])}, "casadi", r"must have the inputs \(x, u, p\)"),
        ({"states": ["h1", "h2", "h3"]}, "states", "x of tanks has 2 entries; states: 3"),
        ({"inputs": ["a", "b"]}, "inputs", "u of tanks has 1 entries; inputs: 2"),
        ({"parameters": {"a1": 1.0}}, "parameters", "p of tanks has 3 entries; parameters: 1"),
        ({"output": function()}, "output", r"must have the inputs \(x\) or \(x, p\), or inputs with names from x, p"),
        ({"integrator": "collocation"}, "integrator", "no effect on an equation without z"),
        ({"algebraic": {"v": 1.0}}, "algebraic", "no effect on an equation without z"),
        ({"x0": [-5.0, 0.1], "bounds": {}}, "casadi", "which are not all finite"),
    ],
)  # fmt: skip
def test_mistakes_are_reported_at_their_key(keys, key, message):
    """Each message names the entry that does not fit."""
    with pytest.raises(DesignError, match=message) as caught:
        two_tanks(**keys)
    assert caught.value.parameter == key


def swapped(*order, kind=casadi.SX, names=True):
    """Return the tanks as a function whose inputs have another order, or fewer of them, with their names."""
    x, _, u, p = symbols(kind)
    given = {"x": x, "u": u, "p": p}
    numbers = {"u": 8.0, "p": [*tanks.PARAMETERS.values()]}
    values = {name: each if name in order else numbers[name] for name, each in given.items()}
    right = function(kind)(values["x"], values["u"], values["p"])
    own = [[*order], ["dx"]] if names else []
    return casadi.Function("tanks", [given[name] for name in order], [right], *own)


@pytest.mark.parametrize("kind", ["SX", "MX"])
@pytest.mark.parametrize("names", [True, False])
def test_inputs_are_matched_by_name(kind, names):
    """Oracle: the function with the inputs in the order x, u, p.  Without names of its own the symbols have them."""
    kind = getattr(casadi, kind)
    np.testing.assert_array_equal(moved(two_tanks(swapped("x", "p", "u", kind=kind, names=names))), moved(two_tanks()))
    at = At(x=[0.2, 0.1], u=8.0)
    ours, theirs = (linearise(TS, two_tanks(each), at=at, noise=NOISE) for each in (None, swapped("p", "x", "u")))
    np.testing.assert_array_equal([*theirs.A, theirs.B.T[0]], [*ours.A, ours.B.T[0]])


def test_a_function_without_an_input_has_its_parameters():
    """Naive form: of two inputs the second one is u, so that `perturb` has no effect."""
    made = two_tanks(swapped("x", "p"), inputs=0, bounds={})
    delta, x, _ = drawn(made)
    none = np.zeros((9, 0))
    found = made.step(0, delta, x, none, np.zeros_like(x)).x
    ours = two_tanks()
    expected = ours.step(0, drawn(ours)[0], x, np.full((9, 1), 8.0), np.zeros_like(x)).x
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def columns(first, second):
    """Return x and p whose entries are symbols with names."""
    return casadi.vertcat(*map(casadi.SX.sym, first)), casadi.vertcat(*map(casadi.SX.sym, second))


@pytest.mark.parametrize(
    ("given", "key", "message"),
    [
        ({"casadi": swapped("x", "u")}, "parameters", "tanks has no input p: its inputs are x, u"),
        ({"casadi": swapped("x", "p")}, "inputs", "tanks has no input u: its inputs are x, p"),
        (
            {"casadi": casadi.Function("f", symbols()[::2], [1.0], ["level", "pump"], ["dx"])},
            "casadi",
            r"\(x, u, p\) or \(t, x, u, p\), or inputs with names from t, x, u, p: .*got f:\(level",
        ),
        (
            {"output": casadi.Function("h", [symbols()[0], symbols()[2]], [1.0], ["x", "u"], ["y"])},
            "output",
            r"\(x\) or \(x, p\), or inputs with names from x, p",
        ),
        (
            {"output": casadi.Function("h", [symbols()[0], casadi.SX.sym("u", 3)], [1.0])},
            "output",
            r"names from x, p",
        ),
        (
            {"casadi": casadi.Function("f", [columns(["h2", "h1"], "abc")[0], symbols()[2], symbols()[3]], [[0, 0]])},
            "states",
            r"x of f has the entries h2, h1; give their names in this order \(got h1, h2\)",
        ),
    ],
)  # fmt: skip
def test_inputs_that_do_not_fit_are_named(given, key, message):
    """Parameters or inputs that would have no effect, names that mean nothing, and entries in another order."""
    with pytest.raises(DesignError, match=message) as caught:
        two_tanks(**given)
    assert caught.value.parameter == key


def test_entries_of_an_equation_are_in_the_order_of_their_names():
    """Oracle: the order of the symbols.  A parameter in the place of another one is silent otherwise."""
    x, p = columns(["a", "b"], ["k", "m"])
    given = {"states": ["a", "b"], "x0": [1.0, 1.0]}
    equation = {"x": x, "p": p, "ode": casadi.vertcat(-p[0] * x[0], -p[1] * x[1])}
    made = plant(TS, STEPS, casadi=equation, parameters={"k": 1.0, "m": 2.0}, solver=Solver(substeps=99), **given)
    delta, none = made.draw({"k": np.ones(1), "m": np.full(1, 2.0)}, [None], STEPS), np.zeros((1, 0))
    motion = made.step(0, delta, np.ones((1, 2)), none, np.zeros((1, 2)))
    np.testing.assert_allclose(motion.x[0], np.exp([-TS, -2 * TS]), rtol=1e-4)
    with pytest.raises(DesignError, match="p of ode has the entries k, m; give their names in this order"):
        plant(TS, STEPS, casadi=equation, parameters={"m": 2.0, "k": 1.0}, **given)
    z = columns(["q", "v"], "")[0]
    algebraic = {**equation, "z": z, "alg": z - x, "ode": -z}
    with pytest.raises(DesignError, match="z has the entries q, v") as caught:
        plant(TS, STEPS, casadi=algebraic, parameters={"k": 1.0, "m": 2.0}, algebraic={"v": 1.0, "q": 1.0}, **given)
    assert caught.value.parameter == "algebraic"


def test_matrices_are_refused():
    """States are columns."""
    x = casadi.SX.sym("x", 2, 2)
    with pytest.raises(DesignError, match="must take and return columns"):
        plant(TS, STEPS, casadi=casadi.Function("f", [x], [x]))


def test_an_equation_without_algebraic_variables_is_integrated_as_a_function_is():
    """Oracle: the function; with the time, the integral of cos."""
    x, _, u, p = symbols()
    made = two_tanks({"x": x, "u": u, "p": p, "ode": function()(x, u, p)})
    np.testing.assert_array_equal(moved(made), moved(two_tanks()))
    t, s = casadi.SX.sym("t"), casadi.SX.sym("s")
    timed = plant(0.1, STEPS, casadi={"t": t, "x": s, "ode": casadi.cos(t)})
    zero = np.zeros((1, 1))
    end = timed.step(7, timed.draw({}, [None], STEPS), zero, np.zeros((1, 0)), zero).x
    np.testing.assert_allclose(end, np.sin(0.8) - np.sin(0.7), rtol=1e-8)


def test_the_example_is_the_same_for_any_block_and_number_of_processes(tmp_path):
    """Oracle: the numbers of all trials; workers load the equation by its path."""
    tables = []
    for jobs, block in ((1, 4), (2, 1)):
        config = load_config(EXAMPLE, overrides=["runs=4", "time={step: 3, steps: 6}", f"execution.block={block}"])
        tables.append(run(config, directory=tmp_path / f"{jobs}", jobs=jobs, engine="joblib").trials.frame)
    assert len(tables[0]) == 8
    assert tables[0].equals(tables[1])
