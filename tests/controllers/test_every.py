"""controller.every, a law that is called at every m-th sample, and controller.preview, a law that knows r ahead."""

import io

import numpy as np
import pandas as pd
import pytest
from conftest import ROUND, SOLVER
from small_experiment import ran
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.models.linear import HeldModel, LinearModel
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.types import ConfigError, Estimate

A, B = np.array([[1.0, 0.1], [0.0, 0.98]]), np.array([[0.005], [0.1]])
LAWS = {
    "control-lqr": "Q_x: [1, 0.1], R_u: 0.1",
    "lqr": "Q_x: [1, 0.1], R_u: 0.1, horizon: 5",
    "mpc": "Hp: 5, Hu: 2, Q: 1, R: 0.01, limits: {u: [-3, 3], du: [-1, 1]}",
    "gpc": "Np: 5, Q_yw: 1, Q_u: 0.1",
    "lqg": "Q_x: [1, 0.1], R_u: 0.1, Q_i: 0.1, outputs: [0]",
    "pid": "Kp: 1, Ki: 0.5, Kd: 0.2, outputs: [0]",
}
QP = "Hp: 5, Hu: 2, Q: 1, R: 0.01, limits: {u: [-0.5, 0.5], enforce: qp}"


def written(tmp_path, kind, keys, A=A, B=B, *, step=0.1, steps=24, reference=0.0, **more):
    """A file with a noise-free linear plant and a predictor that knows the state."""
    matrices = f"A: {A.tolist()}, B: {B.tolist()}, C: [[1, 0], [0, 1]]"
    given = {
        "plant": f"{{kind: linear, {matrices}}}",
        "model": f"{{kind: linear, {matrices}, P_w: 1, P_v: 1e-6}}",
        "noise": "none",
        "initial": "{x: [1, -0.5], x_hat: [1, -0.5], P: 0}",
        "time": f"{{step: {step}, steps: {steps}}}",
        "reference": f"{{kind: constant, value: [{reference}, 0]}}",
        "methods": f"{{M: {{estimator: {{kind: kalman}}, controller: {{kind: {kind}, {keys}}}}}}}",
        "metrics": "[input_power]",
        "runs": 1,
    }
    return write_estimation(tmp_path, **(given | more))


def recorded(path):
    """Signals of the first run."""
    experiment = load_config(path).experiment
    draws = experiment.scenario.draw(experiment.plant, range(1), experiment.n_steps)
    record, *_ = simulate(
        experiment.plant, experiment.methods[0], draws, experiment.scenario.reference.sample(experiment.n_steps + 20),
        experiment.n_steps,
    )  # fmt: skip
    return record


@pytest.mark.parametrize(
    ("m", "held", "K"),
    [(2, (0.02, 0.198), (2.455362622, 2.174196670)), (4, None, (1.916349847, 1.886778233))],
)
def test_the_gain_of_the_model_over_m_samples(tmp_path, m, held, K):
    """Oracle: the values of the closed form, and A^m; sum of A^i B by hand."""
    law = load_config(written(tmp_path, "control-lqr", f"{LAWS['control-lqr']}, every: {m}")).experiment.methods[0]
    np.testing.assert_allclose(law.controller.law.K[0], [K], **SOLVER)
    over = HeldModel(LinearModel(A, B, np.eye(2), np.diag([1e-5, 1e-3]), np.eye(2), f0=[0.1, 0.2]), m)
    np.testing.assert_allclose(over.A, np.linalg.matrix_power(A, m), **ROUND)
    powers = [np.linalg.matrix_power(A, i) for i in range(m)]
    np.testing.assert_allclose(over.B, sum(P @ B for P in powers), **ROUND)
    if held is not None:
        np.testing.assert_allclose(over.B[:, 0], held, **ROUND)
    np.testing.assert_allclose(over.f0, sum(P @ [0.1, 0.2] for P in powers), **ROUND)
    np.testing.assert_allclose(over.Q_w, sum(P @ np.diag([1e-5, 1e-3]) @ P.T for P in powers), **ROUND)


@pytest.mark.parametrize("m", [2, 3])
@pytest.mark.parametrize("kind", [*LAWS, "qp"])
def test_it_is_the_law_of_a_loop_with_longer_samples(tmp_path, kind, m):
    """Oracle: the loop of A^m and sum of A^i B at every m-th sample; between them the input is held."""
    keys = QP if kind == "qp" else LAWS[kind]
    law, reference = ("mpc" if kind == "qp" else kind), 0.0 if "lqr" in kind else 1.0
    fast = recorded(written(tmp_path, law, f"{keys}, every: {m}", reference=reference))
    over = HeldModel(LinearModel(A, B, np.eye(2), np.eye(2), np.eye(2)), m)
    slow = recorded(written(tmp_path, law, keys, over.A, over.B, step=0.1 * m, steps=24 // m, reference=reference))
    assert np.abs(slow.u).max() > 0.1
    np.testing.assert_allclose(fast.u[:, ::m], slow.u, rtol=1e-7, atol=1e-9)  # of powers of A that are rounded
    np.testing.assert_allclose(fast.x[:, ::m], slow.x, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(fast.u, np.repeat(fast.u[:, ::m], m, axis=1))


def test_every_sample_is_the_usual_law(tmp_path):
    """Oracle: same design, same hash; another one is another experiment, and the resolved file loads as the same."""
    usual, one, two = (load_config(written(tmp_path, "mpc", LAWS["mpc"] + more))
                       for more in ("", ", every: 1", ", every: 2"))  # fmt: skip
    assert usual.points[0].method_keys == one.points[0].method_keys != two.points[0].method_keys
    assert usual.resolved == one.resolved
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(two.resolved)), encoding="utf-8")
    assert load_config(copy).points[0].method_keys == two.points[0].method_keys


VARYING = '{kind: linear, A: [["1 + 0.1*k", 0], [0, 1]], B: [[0], [1]], C: [[1, 0], [0, 1]], P_w: 1, P_v: 1}'
CURVED = {
    "plant": "{ode: own.py:rhs, states: [a, b], inputs: [f]}",
    "model": "{nonlinear: plant, noise: {process: 1, measurement: 1}}",
    "uncertainty": None,
}


@pytest.mark.parametrize(
    ("law", "changes", "words"),
    [
        ("{kind: tube-mpc, horizon: 3, Q_x: 1, R_u: 1, limits: {u: [-9, 9]}, W: 0.1, every: 2}", {}, "is a key of"),
        ("{kind: mpc, Hp: 3, Hu: 1, Q: 1, R: 1, every: 0}", {}, "must be >= 1"),
        ("{kind: mpc, Hp: 3, Hu: 1, Q: 1, R: 1, every: 100000000}", {}, "at most the number of samples, 24"),
        ("{kind: mpc, Hp: 3, Hu: 1, Q: 1, R: 1, every: 1.5}", {}, "must be a whole number"),
        ("{kind: mpc, Hp: 3, Hu: 1, Q: 1, R: 1, every: none}", {}, "unknown name 'none'"),
        ("{kind: mpc, Hp: 3, Hu: 1, Q: 1, R: 1, every: 2}", CURVED, "every needs a linear model"),
        (
            "{kind: mpc, Hp: 3, Hu: 1, Q: 1, R: 1, every: 2}",
            {"model": VARYING},
            "every needs a linear model: this model varies with k",
        ),
    ],
)
def test_what_is_refused(tmp_path, law, changes, words):
    """With the place of the key."""
    (tmp_path / "own.py").write_text("def rhs(x, u, p): return [x[1], -x[0] ** 3 + u[0]]\n", encoding="utf-8")
    filter_ = "extended-kalman" if changes is CURVED else "kalman"
    methods = f"{{M: {{estimator: {{kind: {filter_}}}, controller: {law}}}}}"
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, "", "", **(changes | {"methods": methods})))
    [problem] = caught.value.problems
    assert problem.path == "methods.M.controller.every" and words in problem.message


def test_pid_needs_no_linear_model(tmp_path):
    """Oracle: the input is held over two samples."""
    (tmp_path / "own.py").write_text("def rhs(x, u, p): return [x[1], -x[0] ** 3 + u[0]]\n", encoding="utf-8")
    law = "{estimator: {kind: extended-kalman}, controller: {kind: pid, Kp: 1, outputs: [0], every: 2}}"
    methods = f"{{M: {law}}}"
    found = recorded(written(tmp_path, "", "", **(CURVED | {"methods": methods})))
    np.testing.assert_array_equal(found.u[:, ::2], found.u[:, 1::2])


def test_a_disturbance_and_an_estimated_mean(tmp_path):
    """Oracle: without an error of the estimate the loop ends at the reference although a constant force acts."""
    model = f"{{kind: linear, A: {A.tolist()}, B: {B.tolist()}, C: [[1, 0], [0, 1]], P_w: 1e-6, P_v: 1e-6, %s}}"
    force = "{process: {gaussian: {mean: [0.0025, 0.05], std: 0}}}"
    mpc = f"controller: {{kind: mpc, {LAWS['mpc']}, every: 2}}"
    for keys, filter_ in (("disturbance: {at: input, drift: 1e-3}", "kalman"), ("w_mean: 0", "kalman-disturbance")):
        methods = f"{{M: {{estimator: {{kind: {filter_}}}, {mpc}}}}}"
        path = written(tmp_path, "", "", noise=force, model=model % keys, methods=methods, steps=400, reference=1.0)
        found = recorded(path)
        np.testing.assert_allclose(found.x[0, -1, 0], 1.0, atol=1e-3)  # of the filter, which still settles


SCALAR = {
    "plant": "{kind: linear, A: 0.8, B: 0.5, C: 1}",
    "model": "{kind: linear, A: 0.8, B: 0.5, C: 1, P_w: 1, P_v: 1e-6}",
    "initial": "{x: 0, x_hat: 0, P: 0}",
    "time": "{steps: 40}",
    "reference": "{kind: square, values: [0, 1], period: 20}",
    "metrics": "[mse]",
    "noise": "none",
    "runs": 2,
}


def scalar(tmp_path, keys, kind="mpc", **changes):
    """A file with a scalar plant."""
    methods = f"{{M: {{estimator: {{kind: kalman}}, controller: {{kind: {kind}, {keys}}}}}}}"
    return write_estimation(tmp_path, **(SCALAR | changes | {"methods": methods}))


@pytest.mark.parametrize("more", ["", ", limits: {u: [-9, 9], enforce: qp}"])
@pytest.mark.parametrize(("preview", "mse"), [("true", 0.0), ("false", 0.075)])
def test_a_reference_without_preview(tmp_path, preview, mse, more):
    """Oracle: the values of the closed form: with preview y = r, without it one sample late at every jump."""
    path = scalar(tmp_path, f"Hp: 1, Hu: 1, Q: 1, R: 0, preview: {preview}{more}")
    table = pd.read_csv(io.BytesIO(ran(path, tmp_path / preview)))
    np.testing.assert_allclose(table["mse"], mse, atol=1e-12)


@pytest.mark.parametrize("kind", ["mpc", "gpc"])
def test_without_preview_the_reference_is_held(tmp_path, kind):
    """Oracle: u(k) is that of the usual law with the constant reference r(k)."""
    keys = "Hp: 4, Hu: 2, Q: 1, R: 0.1" if kind == "mpc" else "Np: 4, Q_yw: 1, Q_u: 0.1"
    laws = [load_config(scalar(tmp_path, keys + more, kind)).experiment.methods[0].controller
            for more in (", preview: false", "")]  # fmt: skip
    held, usual = laws
    assert (held.preview, usual.preview) == (1, 5)
    estimate = Estimate(np.array([[0.3]]), None, None, np.zeros(1, np.int8), {})
    found = held.control(0, held.init(1), np.zeros((1, 1)), estimate, np.array([[0.7]]))[1].u
    expected = usual.control(0, usual.init(1), np.zeros((1, 1)), estimate, np.full((5, 1), 0.7))[1].u
    np.testing.assert_array_equal(found, expected)


def test_it_prepares_its_law(tmp_path, monkeypatch):
    """A law whose input is held is compiled before the runs, as the same law alone is."""
    path = scalar(tmp_path, "Np: 4, Q_yw: 1, Q_u: 0.1, preview: false", "gpc")
    held = load_config(path).experiment.methods[0].controller
    called = []
    monkeypatch.setattr(type(held.law), "warm_up", lambda law: called.append(law))
    held.warm_up()
    assert called == [held.law]


def test_preview_of_other_laws_is_refused(tmp_path):
    """With the place of the key; `preview: true` changes nothing."""
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, "control-lqr", LAWS["control-lqr"] + ", preview: false"))
    [problem] = caught.value.problems
    assert problem.path == "methods.M.controller.preview" and "is a key of gpc and mpc" in problem.message
    one, usual = (load_config(scalar(tmp_path, f"Hp: 1, Hu: 1, Q: 1, R: 0{more}")) for more in (", preview: true", ""))
    assert one.points[0].method_keys == usual.points[0].method_keys and one.resolved == usual.resolved
