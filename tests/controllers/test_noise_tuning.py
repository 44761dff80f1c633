"""LP2 against the full program by HiGHS, covariances against Monte Carlo, and the penalties in the loop."""

import inspect
import re

import numpy as np
import pytest
from conftest import ROUND, STAT, random_model, within_stat
from controllers.gpc_twin import Swing, Varying, commands, full_lp2
from scipy.optimize import linprog

from rmpc_bench.controllers.gpc import design
from rmpc_bench.controllers.noise_tuning import LpNoise, NoiseTuning, Triangle, covariance, fitted, precision
from rmpc_bench.types import Estimator

FIT = {"rtol": 1e-9, "atol": 1e-15}  # of bounds of 5e-4, between two simplex codes


def windows(rng, runs=6, samples=15, ny=3, nx=6, r=5e-4):
    """Windows such as the robot makes: outputs on a path of about 0.1, noise of 5e-4, estimates that are off."""
    t = 0.01 * np.arange(samples)[:, None] + rng.uniform(0.0, 8.0, (runs, 1, 1))
    path = 0.1 * np.sin(t * rng.uniform(0.5, 2.0, ny) + np.arange(ny))
    y = path + rng.uniform(-r, r, (runs, samples, ny))
    y_hat = path + 0.3 * rng.uniform(-r, r, (runs, samples, ny))
    speed = rng.standard_normal((runs, samples, nx - ny)) * 0.02 + 0.1
    x_hat = np.concatenate([y_hat, speed], axis=2)
    return y, y_hat, x_hat, x_hat + r * rng.standard_normal(x_hat.shape)


def tuning(ny=3, nx=6, start=0, **keys):
    """LP2 of the robot's size."""
    return NoiseTuning(LpNoise(**keys), start, nx, ny)


def test_rows_are_the_full_program(rng):
    """Oracle: (22)-(27) with 27 unknowns and 270 rows at once, by HiGHS, for windows of 15 samples."""
    y, y_hat, x_hat, x_tilde = windows(rng)
    window = np.concatenate([y, y_hat, x_hat, x_tilde], axis=2)
    info = tuning().penalties(0, window, np.tile(np.eye(3), (6, 1, 1)))[1]
    for i in range(6):
        Pi, r, Lambda, rho = full_lp2(y[i], y_hat[i], x_hat[i], x_tilde[i])
        np.testing.assert_allclose(info["r_breve"][i], r, **FIT)
        np.testing.assert_allclose(info["rho_breve"][i], rho, **FIT)
        np.testing.assert_allclose(info["Pi"][i], Pi, rtol=1e-9, atol=1e-12)  # conditions of the last basis
        np.testing.assert_allclose(info["Lambda"][i], Lambda, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("weight", ["root", "square"])
def test_no_run_depends_on_another_one(weight, rng):
    """Oracle: each run alone, bit for bit, in all that is reported, at the robot's size."""
    window, before = np.concatenate(windows(rng), axis=2), np.tile(np.eye(3), (6, 1, 1))
    window[3, 2, 1] = np.nan
    found = tuning(weight=weight)
    Q_yw, info = found.penalties(0, window, before)
    for i in range(6):
        alone = found.penalties(0, window[i : i + 1], before[:1])
        np.testing.assert_array_equal(alone[0][0], Q_yw[i])
        for name, values in alone[1].items():
            np.testing.assert_array_equal(values[0], info[name][i])
    np.testing.assert_array_equal(Q_yw[3], np.eye(3))


def test_27_as_printed_has_the_other_sign(rng):
    """Oracle: the full program with the printed b_k: the same bounds, the opposite correlation."""
    y, y_hat, x_hat, x_tilde = (each[0] for each in windows(rng, runs=1))
    Pi, r, _, _ = full_lp2(y, y_hat, x_hat, x_tilde)
    printed = full_lp2(y, y_hat, x_hat, x_tilde, sign=-1.0)
    np.testing.assert_allclose(printed[0], -Pi, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(printed[1], r, **FIT)


def random_triangle(rng, n):
    """A correlation and half-widths."""
    T = np.eye(n) + np.triu(rng.uniform(-0.9, 0.9, (n, n)), 1)
    return Triangle(T[None], rng.uniform(0.5, 2.0, (1, n)))


def test_the_covariance_is_that_of_uniform_noise(rng):
    """Oracle: moments of P^-1 n for n uniform on its box; 1/3 is right, the printed 1/2 is not."""
    box = random_triangle(rng, 3)
    noise = rng.uniform(-1.0, 1.0, (20000, 3)) * box.width[0]
    y = np.linalg.solve(box.T[0], noise.T).T
    squares = np.einsum("ri,rj->rij", y, y)
    assert within_stat(squares, covariance(box, 1.0 / 3.0)[0])
    assert not within_stat(squares, covariance(box, 1.0 / 2.0)[0])


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_the_precision_is_the_inverse(n, rng):
    """Oracle: numpy.linalg.inv, and (28) with inverses."""
    box = random_triangle(rng, n)
    P_inverse, D = np.linalg.inv(box.T[0]), np.diag(box.width[0])
    np.testing.assert_allclose(covariance(box, 0.5)[0], 0.5 * P_inverse @ D @ D.T @ P_inverse.T, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(precision(box, 0.5)[0], np.linalg.inv(covariance(box, 0.5)[0]), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(("form", "c"), [("corrected", 1.0 / 3.0), ("printed", 1.0 / 2.0)])
def test_the_penalty_is_the_clipped_inverse(form, c, rng):
    """Oracle: kp C_y^-1 by numpy.linalg.inv of what is reported, clipped entry by entry; 1/3 in C_x for both forms."""
    window = np.concatenate(windows(rng, runs=40), axis=2)
    Q_yw, info = tuning(form=form, bounds=(1.5, 2.0)).penalties(0, window, np.tile(np.eye(3), (40, 1, 1)))
    C_y = [covariance(Triangle(np.eye(3) + Pi[None], r[None]), c)[0] for Pi, r in zip(info["Pi"], info["r_breve"],
                                                                                   strict=True)]  # fmt: skip
    np.testing.assert_allclose(info["C_y"], C_y, **ROUND)
    expected = np.clip(1e-7 * np.linalg.inv(C_y), -2.0, 2.0)
    expected[:, range(3), range(3)] = np.maximum(expected[:, range(3), range(3)], 1.5)
    np.testing.assert_allclose(Q_yw, expected, rtol=1e-9, atol=1e-9)  # of the inverse
    diagonal = Q_yw[:, range(3), range(3)]
    assert (diagonal == 1.5).any() and (diagonal == 2.0).any() and ((1.5 < diagonal) & (diagonal < 2.0)).any()
    C_x = covariance(Triangle(np.eye(6) + info["Lambda"], np.maximum(info["rho_breve"], 1e-6)), 1.0 / 3.0)
    np.testing.assert_allclose(info["C_x"], C_x, **ROUND)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_off_the_diagonal_is_clipped_on_both_sides(sign, rng):
    """Oracle: the scaled inverse of what is reported lies beyond the bound in every run, as the noises nearly agree."""
    e = rng.uniform(-5e-4, 5e-4, (30, 15, 2))
    e[:, :, 1] = sign * (0.8 * e[:, :, 0] + 0.2 * e[:, :, 1])
    window = np.concatenate([e, np.zeros_like(e)], axis=2)
    found = tuning(ny=2, on="residual", state_rows=False, bounds=(0.5, 3.0))
    Q_yw, info = found.penalties(0, window, np.tile(np.eye(2), (30, 1, 1)))
    beyond = sign * 1e-7 * np.linalg.inv(info["C_y"])[:, 0, 1]
    assert (beyond < -3.0).all()
    np.testing.assert_array_equal(Q_yw[:, [0, 1], [1, 0]], np.full((30, 2), -3.0 * sign))


def test_without_noise_the_penalty_is_at_its_upper_bound(rng):
    """Oracle: the stated limit; r = 0 counts as the floor, kp 3 / 1e-12 is beyond 4."""
    y, _, x_hat, _ = windows(rng)
    window = np.concatenate([y, y, x_hat, x_hat], axis=2)
    Q_yw, info = tuning().penalties(0, window, np.tile(np.eye(3), (6, 1, 1)))
    np.testing.assert_array_equal(info["r_breve"], 0.0)
    np.testing.assert_allclose(Q_yw, np.tile(4.0 * np.eye(3), (6, 1, 1)), rtol=0, atol=1e-6)  # 3e5 times rounding of Pi
    np.testing.assert_allclose(info["C_y"], np.tile(np.eye(3) * 1e-12 / 3.0, (6, 1, 1)), rtol=1e-9, atol=1e-24)


def test_the_square_form_is_the_root(rng):
    """Oracle: Q_yw Q_yw is the clipped penalty; where that has a negative eigenvalue, the nearest one without."""
    window, before = np.concatenate(windows(rng), axis=2), np.tile(np.eye(3), (6, 1, 1))
    Q = tuning().penalties(0, window, before)[0]
    root = tuning(weight="square").penalties(0, window, before)[0]
    np.testing.assert_allclose(root @ root, Q, rtol=1e-12, atol=1e-14)
    assert np.linalg.eigvalsh(root).min() > 0.0
    made = tuning(weight="square")._root(np.array([[[0.5, 4.0], [4.0, 0.5]]]), np.array([True]))
    np.testing.assert_allclose(made[0] @ made[0], np.full((2, 2), 2.25), **ROUND)  # eigenvalues 4.5 and -3.5


def test_correlation_shows_in_residuals_and_not_in_outputs(rng):
    """Oracle: component 2 is 0.8 e1 + 0.2 e2, correlation 0.97; the outputs are 200 times their noise."""
    runs, r = 100, 5e-4
    e = rng.uniform(-r, r, (runs, 15, 2))
    e[:, :, 1] = 0.8 * e[:, :, 0] + 0.2 * e[:, :, 1]
    y_hat = 0.1 + 0.01 * np.arange(15)[:, None] * np.array([1.0, 0.7])
    window = np.concatenate([y_hat + e, np.tile(y_hat, (runs, 1, 1))], axis=2)

    def correlations(on):
        keys = {"on": on, "state_rows": False, "bounds": (1e-9, 1e9)}
        Q = tuning(ny=2, **keys).penalties(0, window, np.tile(np.eye(2), (runs, 1, 1)))[0]
        return Q[:, 0, 1] / np.sqrt(Q[:, 0, 0] * Q[:, 1, 1])

    residual, output = correlations("residual"), correlations("output")
    assert (residual < -0.9).all()
    assert np.abs(output).max() < 0.1 and abs(output.mean()) < STAT * output.std() / np.sqrt(runs)


def test_without_correlation_the_program_has_bounds_only(rng):
    """Oracle: (22)-(27) by HiGHS with only r and rho as unknowns, and a diagonal inverse of C_y by hand."""
    y, y_hat, x_hat, x_tilde = windows(rng)
    window, before = np.concatenate([y, y_hat, x_hat, x_tilde], axis=2), np.tile(np.eye(3), (6, 1, 1))
    Q_yw, info = tuning(on="none", bounds=(1e-3, 1e3)).penalties(0, window, before)
    assert not info["Pi"].any() and not info["Lambda"].any()
    for name, e in (("r_breve", y - y_hat), ("rho_breve", x_hat - x_tilde)):
        for i, residuals in enumerate(e):
            samples, n = residuals.shape
            rows = np.vstack([np.tile(-np.eye(n), (samples, 1))] * 2)
            right = np.concatenate([-residuals.ravel(), residuals.ravel()])
            np.testing.assert_allclose(info[name][i], linprog(np.ones(n), rows, right).x, **FIT)
    expected = np.stack([np.diag(np.clip(3e-7 / r**2, 1e-3, 1e3)) for r in info["r_breve"]])
    np.testing.assert_allclose(Q_yw, expected, **ROUND)
    free = tuning(on="output").penalties(0, window, before)[1]
    assert (free["r_breve"] <= info["r_breve"] * (1 + 1e-12)).all()


@pytest.mark.parametrize("on", ["output", "residual", "none"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_keeps_the_weight(on, value, rng):
    """Oracle: by construction; the other runs have weights of their own."""
    window, before = np.concatenate(windows(rng), axis=2), np.tile(7.0 * np.eye(3), (6, 1, 1))
    window[2, 4, 0] = value
    with np.errstate(invalid="ignore"):
        Q_yw = tuning(on=on).penalties(0, window, before)[0]
    np.testing.assert_array_equal(Q_yw[2], before[2])
    assert (np.delete(Q_yw, 2, axis=0)[:, 0, 0] <= 4.0).all()


def test_rows_that_fit_nothing_have_no_coefficients(rng):
    """Oracle: the last row, max |e|; and one column of z that is 0, as an output at rest on 0 without noise."""
    e = rng.standard_normal((4, 9, 3))
    box = fitted(e, e)
    np.testing.assert_array_equal(box.width[:, 2], np.abs(e[:, :, 2]).max(axis=1))
    z = e.copy()
    z[:, :, 2] = 0.0
    still = fitted(e, z)
    assert np.isfinite(still.T).all()
    np.testing.assert_allclose(still.width[:, 1], np.abs(e[:, :, 1]).max(axis=1), **ROUND)


class Windowed(Estimator):
    """An estimator that fits the last samples."""

    Ne = 3


def loop(rng, model, keys=None, estimator=None, missing=None):
    """Commands of a tuned law, estimates and measurements, one of which may be missing; penalties between bounds."""
    runs, steps = 5, 14
    controller = design(
        model, steps, estimator, Np=4, Q_yw=1.3, Q_u=0.5, tuning=LpNoise(**{"Ne2": 5, "kp": 0.1, **(keys or {})})
    )
    x_hat = rng.standard_normal((runs, steps, 2))
    y = x_hat[:, :, :1] + 0.3 * rng.standard_normal((runs, steps, 1))
    if missing is not None:
        y[missing] = np.nan
    return commands(controller, x_hat, y, rng.standard_normal((steps + 5, 1))), x_hat, y


@pytest.mark.parametrize(("estimator", "start"), [(None, 5), (Windowed(), 8)])
def test_penalties_begin_when_the_windows_are_full(estimator, start, rng):
    """Oracle: k = Ne2 + Ne, 17 for the paper; until then the penalty of the design, and no bounds."""
    found, x_hat, y = loop(rng, Swing(), estimator=estimator)
    for k, command in enumerate(found):
        if k < start:
            np.testing.assert_array_equal(command.info["Q_yw"], np.full((5, 1, 1), 1.3))
            assert all(np.isnan(command.info[name]).all() for name in ("Pi", "r_breve", "C_y", "rho_breve"))
        else:
            r = np.abs(y[:, k - 5 : k + 1, 0] - x_hat[:, k - 5 : k + 1, 0]).max(axis=1)
            np.testing.assert_array_equal(command.info["r_breve"][:, 0], r)
            np.testing.assert_allclose(command.info["Q_yw"][:, 0, 0], np.clip(0.3 / r**2, 0.5, 4.0), **ROUND)


def varying(rng, steps=14):
    """A model with another pair at every k."""
    return Varying([random_model(rng, 2, 1, 1) for _ in range(steps)])


@pytest.mark.parametrize("dependent", [True, False], ids=["state", "time"])
def test_state_rows_use_the_model_s_prediction(dependent, rng):
    """Oracle: x_hat - A x_hat(k-1) - B u(k-1) of the last six samples; their second entry has no coefficient."""
    model = Swing() if dependent else varying(rng)
    found, x_hat, _ = loop(rng, model)
    errors = []
    for k in range(1, 14):
        if dependent:
            A, B = Swing().at_state(x_hat[:, k - 1])
        else:
            A, B = (np.tile(each, (5, 1, 1)) for each in (model.at(k - 1).A, model.at(k - 1).B))
        x_tilde = np.einsum("rij,rj->ri", A, x_hat[:, k - 1]) + np.einsum("rij,rj->ri", B, found[k - 1].u)
        errors.append(x_hat[:, k, 1] - x_tilde[:, 1])
        if k >= 6:
            rho = np.abs(np.array(errors[-6:])).max(axis=0)
            np.testing.assert_allclose(found[k].info["rho_breve"][:, 1], rho, **ROUND)
    assert np.isnan(found[5].info["rho_breve"]).all()  # nothing has been predicted at k = 0


@pytest.mark.parametrize("keys", [{}, {"on": "residual"}, {"on": "none"}, {"weight": "square", "form": "printed"}])
def test_state_rows_reach_no_control(keys, rng):
    """Oracle: the same law without them, bit for bit."""
    seed = int(rng.integers(2**31))
    with_rows, without = (
        loop(np.random.default_rng(seed), Swing(), {**keys, "state_rows": rows})[0] for rows in (True, False)
    )
    assert "rho_breve" in with_rows[0].info and "rho_breve" not in without[0].info
    for left, right in zip(with_rows, without, strict=True):
        np.testing.assert_array_equal(left.u, right.u)
        np.testing.assert_array_equal(left.info["Q_yw"], right.info["Q_yw"])


@pytest.mark.parametrize("weight", ["root", "square"])
def test_a_missing_measurement_keeps_the_last_penalty(weight, rng):
    """Oracle: by construction; as long as it is in the window, of its own run only, and there is an input."""
    seed = int(rng.integers(2**31))
    clean, found = (
        loop(np.random.default_rng(seed), Swing(), {"weight": weight}, missing=missing)[0] for missing in (None, (2, 7))
    )
    for k in range(14):
        Q_yw, expected = found[k].info["Q_yw"], clean[k].info["Q_yw"].copy()
        if 7 <= k <= 12:
            expected[2] = clean[6].info["Q_yw"][2]
            assert np.isnan(found[k].info["r_breve"][2]).all()
        np.testing.assert_array_equal(Q_yw, expected)
        np.testing.assert_array_equal(np.delete(found[k].u, 2, axis=0), np.delete(clean[k].u, 2, axis=0))
        assert np.isfinite(found[k].u).all()


def test_the_manual_states_the_defaults():
    """Oracle: the fields of the dataclass."""
    text = " ".join(inspect.getdoc(LpNoise).split())
    for name, value in (("Ne2", "14"), ("kp", "1e-7"), ("bounds", "[0.5, 4.0]"), ("floor", "1e-6")):
        assert re.search(rf"{name} : [^:]*\(default {re.escape(value)}\)", text)
        default = getattr(LpNoise(), name)
        assert (list(default) if isinstance(default, tuple) else default) == eval(value)
