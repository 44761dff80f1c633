"""`estimator`, `controller`, `plant` and `model`: what a configuration refuses they refuse, in the same words."""

import numpy as np
import pytest
from conftest import ALL, EXACT
from small_experiment import write

import rmpc_bench
from rmpc_bench.types import ConfigError, DesignError, Estimator

A, B, C = [[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]]
MODEL = rmpc_bench.LinearModel(A, B, C, 0.1, 0.2)
START = {"n_steps": 5, "x0": np.zeros(2), "P0": np.eye(2)}
MPC = {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.5}


def estimator(kind="kalman", **keys):
    """Design an estimator of the model."""
    return rmpc_bench.estimator(kind, MODEL, **{**START, **keys})


WRONG = {
    "below its range": ("robust-kalman", {"c": -1}),
    "no number": ("robust-kalman", {"c": "a"}),
    "not finite": ("robust-kalman", {"c": float("inf")}),
    "a list": ("robust-kalman", {"c": [0.1, 0.2]}),
    "a word": ("robust-kalman", {"c": 0.1, "form": "filtr"}),
    "true or false": ("kalman", {"use_y0": 2}),
    "a whole number": ("moving-horizon", {"window": 2.5}),
    "missing": ("robust-kalman", {}),
    "of the design itself": ("gated-kalman", {"gate": 1.0, "probability": 0.5}),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_key_has_the_words_of_a_configuration(name, tmp_path):
    """Oracle: the message of `load_config` about the same key."""
    kind, keys = WRONG[name]
    written = "".join(f", {key}: {str(value).replace('inf', '.inf')}" for key, value in keys.items())
    with pytest.raises(ConfigError) as expected:
        rmpc_bench.load_config(write(tmp_path, methods=f"{{KF: {{estimator: {{kind: {kind}{written}}}}}}}"))
    [problem] = expected.value.problems
    key = problem.path.removeprefix("methods.KF.estimator").removeprefix(".")
    with pytest.raises(DesignError) as found:
        estimator(kind, **keys)
    assert str(found.value) == f"estimator {kind!r}: {key and f'{key}: '}{problem.message}"
    assert isinstance(found.value, ValueError) and isinstance(expected.value, ValueError)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"P0": -np.eye(2)}, "P0: must be positive semidefinite (smallest eigenvalue -1)"),
        ({"P0": np.full((2, 2), np.nan)}, "P0: must be finite"),
        ({"P0": [[1.0, 2.0], [0.0, 1.0]]}, "P0: must be symmetric"),
        ({"P0": np.eye(3)}, "P0: shape (3, 3) does not fit: a number, 2 numbers or 2 x 2 numbers are required"),
        ({"P0": None}, "P0: expected a number or a list or a matrix (got nothing)"),
        ({"M0": -1.0}, "M0: must be positive semidefinite (smallest eigenvalue -1)"),
        ({"x0": np.array([0.0, np.nan])}, "x0: must be finite (got 0, nan)"),
        ({"x0": [0.0, np.nan]}, "x0.1: nan is not a quantity; numbers here are finite"),
        ({"x0": np.zeros(3)}, "x0: shape (3,) does not fit: a number or 2 numbers are required"),
        ({"x0": np.zeros((2, 1))}, "x0: shape (2, 1) does not fit: a number or 2 numbers are required"),
        ({"x0": "zero"}, "x0: column 1 of 'zero': unknown name 'zero'"),
        ({"n_steps": 0}, "n_steps: must be >= 1 (got 0)"),
        ({"n_steps": 10**12}, "n_steps: must be <= 1000000 (got 1000000000000)"),
        ({"n_steps": 2.5}, "n_steps: must be a whole number (got 2.5)"),
        ({"model": MODEL}, "model: is given twice, with and without its name"),
        ({"frm": "filter"}, "'frm' is not a known argument; did you mean 'form'?"),
        ({"P_0": 1.0}, "'P_0' is not a known argument; did you mean 'P0'?"),
    ],
)
def test_a_wrong_start_is_refused(keys, words):
    """With the name of the argument."""
    with pytest.raises(DesignError) as found:
        estimator(**keys)
    assert str(found.value).startswith(f"estimator 'kalman': {words}")


def test_what_is_missing_is_named_with_its_meaning():
    """All of it at once."""
    with pytest.raises(
        DesignError, match=r"plant 'linear': 'n_steps' is missing \(number of control periods N\); 'C' is"
    ):
        rmpc_bench.plant("linear", 0.1, A=A)
    with pytest.raises(
        DesignError, match=r"estimator 'kalman': 'x0' is missing \(initial state: .*\); 'P0' is missing \("
    ):
        rmpc_bench.estimator("kalman", MODEL, 5)
    with pytest.raises(DesignError, match="takes at most 2 arguments without a name: model, n_steps .got 3."):
        rmpc_bench.estimator("kalman", MODEL, 5, np.zeros(2), P0=np.eye(2))


@pytest.mark.parametrize("factory", ["plant", "model", "estimator", "controller"])
@pytest.mark.parametrize("kind", ["kalmn", 3, None])
def test_an_unknown_kind(factory, kind):
    """The same exception as for any other mistake, with the nearest name or all of them."""
    with pytest.raises(DesignError, match=rf"kind: '{kind}' is not a known {factory}; (did you mean|known: )"):
        getattr(rmpc_bench, factory)(kind)


def test_values_are_read_as_in_a_configuration():
    """Arrays, numbers of NumPy and texts of quantities give the design of plain numbers, bit for bit."""
    plain = estimator("robust-kalman", c=0.1)
    for keys in ({"c": "0.1"}, {"c": np.float64(0.1)}, {"c": np.array(0.1)}, {"c": "10%", "n_steps": np.int64(5)}):
        np.testing.assert_allclose(estimator("robust-kalman", **keys).L, plain.L, **EXACT)
    short = estimator("robust-kalman", c=0.1, x0=0, P0=[1, 1])
    np.testing.assert_allclose(short.L, plain.L, **EXACT)
    given = {"window": 3, "w": np.array([[-1.0, 1.0], [-2.0, 2.0]])}
    assert estimator("moving-horizon", **given).window == 3


@pytest.mark.parametrize("name", ["A", "C"])
@pytest.mark.parametrize("value", [[[np.nan]], np.array([[np.inf]])])
def test_a_plant_of_wrong_numbers(name, value):
    """As lists and as arrays."""
    keys = {"A": [[0.5]], "C": [[1.0]], name: value}
    with pytest.raises(DesignError, match=rf"plant 'linear': {name}.* finite"):
        rmpc_bench.plant("linear", 0.1, 5, **keys)


@pytest.mark.skipif(ALL, reason="the checks of annotations refuse such a call first")
@pytest.mark.parametrize("name", ["A", "B", "C", "Q_w", "R_v", "S_wv", "f0", "d0"])
@pytest.mark.parametrize(
    ("value", "words"),
    [(np.nan, "finite numbers"), ("a", "numbers, row"), (1j, "numbers, row"), (None, "finite numbers")],
)
def test_a_linear_model_of_wrong_numbers(name, value, words):
    """Named."""
    given = {"A": A, "B": B, "C": C, "Q_w": 0.1, "R_v": 0.2}
    if name in ("S_wv", "f0", "d0") and value is None:
        assert rmpc_bench.LinearModel(**given, **{name: value}).nx == 2
        return
    shape = {"A": (2, 2), "B": (2, 1), "C": (1, 2), "Q_w": (2, 2), "R_v": (1, 1), "S_wv": (2, 1), "f0": 2, "d0": 1}
    array = np.full(shape[name], value, dtype=object).tolist() if value is not None else value
    with pytest.raises(DesignError, match=f"{name} must be {words}"):
        rmpc_bench.LinearModel(**{**given, name: array})


def test_a_cross_covariance_that_no_noises_have():
    with pytest.raises(DesignError, match="S_wv: .* is not positive semidefinite"):
        rmpc_bench.LinearModel(A, B, C, 1e-4, 1e-2, S_wv=[[1.0], [1.0]])


@pytest.mark.parametrize("wrong", [(A, B, C), {"A": A}, "linear", None, np.eye(2)])
def test_what_is_no_model(wrong):
    """A tuple of matrices, a text and so on."""
    for made in (
        lambda: rmpc_bench.estimator("kalman", wrong, **START),
        lambda: rmpc_bench.controller("mpc", wrong, **MPC),
    ):
        with pytest.raises(
            DesignError, match=r"model: must be a design model, such as LinearModel\(A, B, C, Q_w, R_v\)"
        ):
            made()


@pytest.mark.parametrize("name", ["estimator", "plant_info"])
def test_what_is_no_estimator_or_plant(name):
    """Of a controller."""
    with pytest.raises(DesignError, match=f"controller 'mpc': {name}: must be an? "):
        rmpc_bench.controller("mpc", MODEL, **MPC, **{name: "kalman"})


def test_a_plant_gives_its_limits_to_a_controller():
    """`plant_info` may be the plant itself; a law without limits of its own takes those of the plant."""
    plant = rmpc_bench.plant("linear", 0.1, 5, A=A, B=B, C=C)
    info = rmpc_bench.types.PlantInfo.of(plant)
    made = [rmpc_bench.controller("mpc", MODEL, plant_info=each, **MPC) for each in (plant, info)]
    assert made[0].input_limits == made[1].input_limits


def test_a_system_of_python_control():
    """A controller takes it as its model, an estimator says what is missing, plant and model convert it."""
    control = pytest.importorskip("control")
    system = control.ss(A, B, C, 0, 0.1)
    laws = [rmpc_bench.controller("mpc", each, **MPC).linear_law() for each in (system, MODEL)]
    np.testing.assert_allclose(laws[0].K_x, laws[1].K_x, **EXACT)
    with pytest.raises(
        DesignError, match="model: a StateSpace has no covariances of the noises; write model.'control'"
    ):
        rmpc_bench.estimator("kalman", system, **START)
    with pytest.raises(DesignError, match=r"model: must have a sampling time \(got dt = 0\)"):
        rmpc_bench.controller("mpc", control.ss(A, B, C, 0), **MPC)
    noise = {"process": 0.1, "measurement": 0.2}
    model = rmpc_bench.model("control", Ts=0.1, control=system, noise=noise)
    made = rmpc_bench.estimator("kalman", model, **START)
    np.testing.assert_allclose(made.L, estimator().L, **EXACT)
    assert rmpc_bench.plant("control", Ts=0.1, n_steps=5, control=system).nx == 2


def test_keys_of_an_own_component_stay_as_they_are(monkeypatch):
    """An array for a key without an annotation is no list, an exception is the user's own."""
    monkeypatch.setattr(rmpc_bench.registry, "_REGISTERED", {group: {} for group in rmpc_bench.registry.BUILT_IN})

    def fixed(model, n_steps, *, x0, P0, gain, factor: rmpc_bench.types.Positive = 1.0, weights=None) -> Estimator:
        """Kalman filter that looks at its keys."""
        assert gain.shape == (2, 1) and weights is None, "no array"
        return rmpc_bench.estimator("kalman", model, n_steps, x0=x0, P0=factor * P0)

    rmpc_bench.register("estimator", "fixed", fixed)
    made = estimator("fixed", gain=np.ones((2, 1)), factor="2*2")
    np.testing.assert_allclose(made.L, estimator(P0=4 * np.eye(2)).L, **EXACT)
    with pytest.raises(AssertionError, match="no array"):
        estimator("fixed", gain=np.ones((2, 2)))
    with pytest.raises(DesignError, match=r"estimator 'fixed': factor: must be > 0 \(got 0\)"):
        estimator("fixed", gain=np.ones((2, 1)), factor=0)


def test_functions_and_files_of_a_program(tmp_path, monkeypatch):
    """A function is given itself, or by its file from the current directory, as data files are."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tank.py").write_text("def rhs(x, u, p): return [u[0] - x[0]]\n", encoding="utf-8")
    (tmp_path / "run.csv").write_text("t,y,u\n" + "".join(f"{k},{k},{k}\n" for k in range(6)), encoding="utf-8")
    names = {"states": ["h"], "inputs": ["q"]}

    def rhs(x, u, p):
        return [u[0] - x[0]]

    plants = [rmpc_bench.plant("ode", 0.1, 5, ode=each, **names) for each in (rhs, "tank.py:rhs")]
    assert [plant.nx for plant in plants] == [1, 1]
    for data in ("run.csv", [tmp_path / "run.csv"]):
        made = rmpc_bench.plant("data", 1.0, 5, data=data, columns={"y": ["y"], "u": ["u"]})
        assert made.recorded.n_runs == 1
    with pytest.raises(DesignError, match="plant 'data': data: there is no file rn.csv; did you mean 'run.csv'"):
        rmpc_bench.plant("data", 1.0, 5, data="rn.csv")
