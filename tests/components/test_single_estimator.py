"""Estimators written for one run: equal to those of the bench, block after block, and their own failures."""

import signal

import numpy as np
import pytest
from components.one_run import MODEL, Fixed, N, Textbook, designed, experiment, kalman, simulated
from conftest import EXACT, ROUND

from rmpc_bench import SolverError
from rmpc_bench.components.single_run import single_run
from rmpc_bench.config_file import factories
from rmpc_bench.metrics.consistency import Nees
from rmpc_bench.metrics.estimation import EstimationMse
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.types import Status, TimeLimit

METRICS = (Nees(), EstimationMse())
LQR = {"Q_x": 1.0, "R_u": 1.0, "horizon": 5}


def lqr():
    """Return a controller of the bench, so that u is not 0."""
    return factories.controller("lqr", MODEL, n_steps=N, estimator=kalman(), **LQR)


def test_a_textbook_filter_is_the_kalman_filter():
    """Oracle: `kalman` to 1e-12, in closed loop, with P."""
    mine = simulated(experiment(designed("estimators", Textbook), lqr(), metrics=METRICS))
    theirs = simulated(experiment(kalman(), lqr(), metrics=METRICS))
    assert not mine[0].any()
    np.testing.assert_allclose(mine[2]["x_hat"], theirs[2]["x_hat"], **ROUND)
    np.testing.assert_allclose(mine[1], theirs[1], **ROUND)


@single_run
class TwoCalls(Textbook):
    """The same with `predict` and `correct`."""

    seen = []

    def predict(self, u, k):
        """Use u(k)."""
        type(self).seen.append(k)
        self.x = self.m.A @ self.x + self.m.B @ u
        self.P = self.m.A @ self.P @ self.m.A.T + self.m.Q_w

    def correct(self, y, k):
        """Use y(k)."""
        type(self).seen.append(k)
        return Textbook.update(self, y, None)

    update = None


def test_predict_and_correct_do_as_well():
    """Oracle: the class with `update`, bit for bit; predict gets the index of its input."""
    TwoCalls.seen.clear()
    mine = simulated(experiment(designed("estimators", TwoCalls), lqr(), metrics=METRICS, n_runs=1))
    same = simulated(experiment(designed("estimators", Textbook), lqr(), metrics=METRICS, n_runs=1))
    np.testing.assert_allclose(mine[2]["x_hat"], same[2]["x_hat"], **EXACT)
    np.testing.assert_allclose(mine[1], same[1], **EXACT)
    assert TwoCalls.seen[:5] == [0, 0, 1, 1, 2]


@single_run
class InPlace(Textbook):
    """The same filter with one buffer for x and one for P, filled again at every sample."""

    def start(self, x0, P0):
        """Make the buffers."""
        super().start(x0, P0)
        self.buffers = np.empty(2), np.empty((2, 2))

    def update(self, y, u_previous):
        """Return the buffers."""
        x, P = super().update(y, u_previous)
        self.buffers[0][:], self.buffers[1][:] = x, P
        return self.buffers


def test_answers_are_copied_at_once():
    """Oracle: the filter without buffers, bit for bit; an adapter that keeps the array repeats the last sample."""
    mine = simulated(experiment(designed("estimators", InPlace), metrics=METRICS))
    same = simulated(experiment(designed("estimators", Textbook), metrics=METRICS))
    np.testing.assert_allclose(mine[1], same[1], **EXACT)


@single_run
class Spoiling(Textbook):
    """The same filter, which writes into all that it gets."""

    def start(self, x0, P0):
        """Spoil the start of the next run."""
        super().start(x0.copy(), P0.copy())
        x0[:], P0[:] = np.nan, np.nan

    def update(self, y, u_previous):
        """Spoil the measurement and the input."""
        answer = super().update(y.copy(), None if u_previous is None else u_previous.copy())
        y[:] = np.nan
        if u_previous is not None:
            u_previous[:] = np.nan
        return answer


def test_arguments_are_the_users_own():
    """Oracle: the filter that writes into nothing, bit for bit, in closed loop."""
    mine = simulated(experiment(designed("estimators", Spoiling), lqr(), metrics=METRICS))
    same = simulated(experiment(designed("estimators", Textbook), lqr(), metrics=METRICS))
    np.testing.assert_allclose(mine[1], same[1], **EXACT)
    np.testing.assert_allclose(mine[2]["u"], same[2]["u"], **EXACT)


@single_run
class ChangesModel(Textbook):
    """A filter that changes a matrix of the model in place."""

    def __init__(self, model):
        super().__init__(model)
        self.m.A[0, 0] *= 2.0


def test_the_model_of_all_runs_cannot_be_changed():
    """Oracle: the run crashes in its own line, and the model of the bench has its matrix."""
    before = MODEL.A.copy()
    status, _, _, (journal,) = simulated(experiment(designed("estimators", ChangesModel), n_runs=2))
    assert (status == Status.CRASHED).all() and "read-only" in journal.failures[0].message
    np.testing.assert_array_equal(MODEL.A, before)
    assert MODEL.A.flags.writeable


@single_run
class Particles:
    """A particle filter of 40 particles with its own random numbers."""

    def __init__(self, model, rng):
        self.m, self.rng = model.at(0), rng

    def start(self, x0, P0):
        """Draw the particles."""
        self.x = x0 + self.rng.standard_normal((40, 2)) @ np.linalg.cholesky(P0).T

    def update(self, y, u_previous):
        """Move, weigh, draw again."""
        if u_previous is not None:
            self.x = self.x @ self.m.A.T + self.m.B @ u_previous + 0.2 * self.rng.standard_normal((40, 2))
        weight = np.exp(-0.5 * (y[0] - self.x[:, 0]) ** 2 / self.m.R_v[0, 0]) + 1e-12
        x_hat = weight @ self.x / weight.sum()
        self.x = self.x[self.rng.choice(40, 40, p=weight / weight.sum())]
        return x_hat


def test_own_random_numbers_belong_to_the_run():
    """Oracle: any block gives the same bits; runs differ.  One generator for the block would fail both."""
    made = experiment(designed("estimators", Particles), n_runs=7)
    whole = simulated(made)
    for block in (1, 3):
        np.testing.assert_array_equal(simulated(made, block)[2]["x_hat"], whole[2]["x_hat"])
    assert len(np.unique(whole[2]["x_hat"][:, 0, 0])) == 7


@single_run
class Recorded(Fixed):
    """An estimator that replays what was recorded of its run."""

    data = np.arange(20.0).reshape(10, 2)

    def update(self, run):
        """Return the row of the run."""
        return self.data[run]


def test_recorded_numbers_go_to_their_run():
    """Oracle: row i for run i, also where the block does not begin at run 0."""
    made = experiment(designed("estimators", Recorded), n_runs=7)
    for block in (7, 3):
        np.testing.assert_array_equal(simulated(made, block)[2]["x_hat"][:, -1], Recorded.data[:7])


@single_run
class Counting(Fixed):
    """An estimator that raises in run 2 at k = 3 and counts its calls."""

    calls = {}

    def update(self, y, k, run):
        """Count."""
        self.calls[run] = self.calls.get(run, 0) + 1
        if (run, k) == (2, 3):
            raise ValueError("negative level")
        return self.x


@single_run
class CountingLaw:
    """A controller that counts its calls."""

    calls = {}

    def control(self, run):
        """Count."""
        self.calls[run] = self.calls.get(run, 0) + 1
        return [0.0]


def test_a_failed_run_is_not_called_any_more_by_either_component():
    """Oracle: calls by hand: k = 0..3 of the estimator, k = 0..2 of the controller; all samples of the other runs."""
    Counting.calls.clear(), CountingLaw.calls.clear()
    made = experiment(designed("estimators", Counting), designed("controllers", CountingLaw), n_runs=4)
    status, _, _, (journal,) = simulated(made)
    assert status.tolist() == [0, 0, Status.CRASHED, 0]
    assert Counting.calls == {0: N + 1, 1: N + 1, 2: 4, 3: N + 1} and CountingLaw.calls == {0: N, 1: N, 2: 3, 3: N}
    failure = journal.failures[2]
    assert (failure.k, failure.component, failure.message) == (3, "estimator", "ValueError: negative level")
    assert "test_single_estimator.py" in failure.trace and "user_runs.py" not in failure.trace
    assert set(failure.values) == {"y", "u_previous", "x_hat"} and len(failure.values["x_hat"]) == 2


def answers(value, at=7, **attributes):
    """Make a class whose answer at one sample is a value, or raises it."""

    def update(self, y, k):
        if k != at:
            return self.x
        if isinstance(value, BaseException):
            raise value
        return value

    return single_run(type("Mine", (Fixed,), {"update": update, **attributes}))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.zeros(3), "update returned 3 numbers; the model has 2 states (k = 7)"),
        (np.zeros((2, 1)), "update returned an array of shape (2, 1); the model has 2 states (k = 7)"),
        (1.0, "update returned a number; the model has 2 states (k = 7)"),
        (None, "update returned nothing; the model has 2 states (k = 7)"),
        (np.array([1.0, np.nan]), "update returned x_hat with NaN or inf (k = 7)"),
        ([1.0, np.inf], "update returned x_hat with NaN or inf (k = 7)"),
        (np.array([1.0 + 1j, 0.0]), "update returned entries of type complex128; real numbers are expected (k = 7)"),
        (["a", "b"], "update returned entries of type <U1; real numbers are expected (k = 7)"),
        ([1.0, None], "update returned entries of type NoneType; real numbers are expected (k = 7)"),
        ([[1.0], [1.0, 2.0]], "update returned lists of different lengths; the model has 2 states (k = 7)"),
        ((np.zeros(2), np.eye(3)), "update returned an array of shape (3, 3); the model has 2 states, so that it is "),
        ((np.zeros(2), np.array([[1.0, 0.5], [0.0, 1.0]])), "update returned P that is not symmetric (k = 7)"),
        ((np.zeros(2), np.full((2, 2), np.nan)), "update returned P with NaN or inf (k = 7)"),
        ((np.zeros(2), np.eye(2), {}, 1), "update returned 4 entries; x_hat, or (x_hat, P, info), is expected"),
        ((np.zeros(2), {"cots": 1.0}), "update reports 'cots', which `reports` of the class does not name (cost)"),
        ((np.zeros(2), {"cost": [1.0]}), "update reports 'cost' with shape (1,); `reports` names ()"),
    ],
)
def test_a_wrong_answer_is_a_crash_of_its_run_with_a_sentence(value, message):
    """Oracle: the sentences; the estimate stays finite, since the run is frozen."""
    made = experiment(designed("estimators", answers(value, reports={"cost": ()})), n_runs=1)
    status, _, traces, (journal,) = simulated(made)
    assert status.tolist() == [Status.CRASHED]
    assert journal.failures[0].message.startswith(message) and journal.failures[0].k == 7
    assert np.isfinite(traces["x_hat"]).all()


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (SolverError("too many iterations"), Status.NOT_CONVERGED),
        (SolverError("no solution", infeasible=True), Status.INFEASIBLE),
        (OSError("no disk"), Status.CRASHED),
        (SystemExit(3), Status.CRASHED),
        (RecursionError(), Status.CRASHED),
        (StopIteration(), Status.CRASHED),
        (GeneratorExit(), Status.CRASHED),
    ],
)
def test_an_exception_gives_the_status_of_the_run(error, status):
    """Oracle: the table; nothing is raised out of the simulation."""
    found, _, _, (journal,) = simulated(experiment(designed("estimators", answers(error)), n_runs=2))
    assert found.tolist() == [status, status] and journal.failures[0].status == status


def test_a_keyboard_interrupt_of_the_user_is_a_crash_where_there_is_no_ctrl_c():
    """Oracle: a worker process ignores SIGINT, so that the exception is the user's; elsewhere it ends the program."""
    made = experiment(designed("estimators", answers(KeyboardInterrupt())), n_runs=1)
    with pytest.raises(KeyboardInterrupt):
        simulated(made)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        status, _, _, (journal,) = simulated(made)
    finally:
        signal.signal(signal.SIGINT, before)
    assert status.tolist() == [Status.CRASHED] and journal.failures[0].message == "KeyboardInterrupt"


@pytest.mark.parametrize("value", [ValueError("no"), SolverError("no"), np.full(2, np.nan), np.zeros(3)])
def test_a_held_step_is_the_last_estimate_moved_by_the_model(value):
    """Oracle: A x_hat + B u by hand; P is A P A' + Q_w; the step is counted."""
    held = designed("estimators", answers(value, at=4), on_failure="hold")
    status, _, traces, (journal,) = simulated(experiment(held, lqr(), n_runs=2))
    assert not status.any() and journal.held == {0: 1, 1: 1} and not journal.failures
    x_hat, u = traces["x_hat"][:, 3], traces["u"][:, 3]
    np.testing.assert_allclose(traces["x_hat"][:, 4], x_hat @ MODEL.A.T + u @ MODEL.B.T, **ROUND)
    (reason,) = journal.warnings
    assert reason.startswith("estimator: a step was held: ") and "k = " not in reason


def test_a_step_that_takes_too_long_is_not_held():
    """Oracle: the status of the run; otherwise its numbers would depend on the speed of the machine."""
    held = designed("estimators", answers(TimeLimit("too long")), on_failure="hold")
    status, _, _, (journal,) = simulated(experiment(held, n_runs=1))
    assert status.tolist() == [Status.TIMEOUT] and not journal.held


@single_run
class Always(Fixed):
    """An estimator that fails from k = 2 on."""

    def update(self, k):
        """Fail."""
        if k >= 2:
            raise SolverError("no")
        return self.x


@pytest.mark.parametrize(("max_held", "last"), [(0.0, 2), (0.1, 3), (0.25, 5), (1.0, None)])
def test_too_many_held_steps_end_the_run(max_held, last):
    """Oracle: floor(12 max_held) steps are held: 10 % of 12 is 1, 25 % is 3; the next one ends the run."""
    made = experiment(designed("estimators", Always, on_failure="hold", max_held=max_held), n_runs=1)
    status, _, _, (journal,) = simulated(made)
    if last is None:
        assert status.tolist() == [0] and journal.held == {0: N - 1}
        return
    assert status.tolist() == [Status.NOT_CONVERGED] and journal.failures[0].k == last
    assert journal.held[0] == last - 2


@single_run
class Reporting(Textbook):
    """A filter that reports a number and its innovation."""

    reports = {"cost": (), "pair": (2,)}

    def update(self, y, u_previous, k):
        """Report nothing at k = 1."""
        x, P = super().update(y, u_previous)
        return (x, P) if k == 1 else (x, P, {"cost": k + 0.5, "pair": np.array([k, 2 * k])})


def test_reported_numbers_can_be_recorded():
    """Oracle: the numbers by hand; NaN where a sample has none."""
    made = experiment(designed("estimators", Reporting), record=("cost", "pair"))
    traces = simulated(made)[2]
    np.testing.assert_array_equal(traces["cost"][3, :, 0], [0.5, np.nan, *np.arange(2, N + 1) + 0.5])
    np.testing.assert_array_equal(traces["pair"][0, 5], [5.0, 10.0])
    assert made.methods[0].reports == {"cost": (), "pair": (2,)}


@single_run
class WithBias(Fixed):
    """An estimator of the two states and of a bias between them."""

    states = slice(0, 3, 2)
    reports = {"augmented": (1,)}

    def update(self, k):
        """Return three numbers."""
        return np.array([1.0, 10.0 + k, 2.0]), np.diag([1.0, 9.0, 2.0])


def test_an_estimate_may_have_more_states_than_the_model():
    """Oracle: entries 0 and 2 are the state, entry 1 is recorded as `augmented`; P by the same entries."""
    made = experiment(designed("estimators", WithBias), record=("x_hat", "augmented"), metrics=(Nees(),))
    status, _, traces, _ = simulated(made)
    assert not status.any()
    np.testing.assert_array_equal(traces["x_hat"][0, 4], [1.0, 2.0])
    np.testing.assert_array_equal(traces["augmented"][0, 4], [14.0])
    design = made.methods[0].estimator
    np.testing.assert_array_equal(design.correct(0, design.init(1), np.zeros((1, 1)))[1].P[0], np.diag([1.0, 2.0]))


def test_more_states_need_the_declaration():
    """Oracle: the sentence of a wrong length without `states`, and with one that fits the model less."""
    for attributes, text in ({}, "3 numbers; the model has 2"), ({"states": slice(0, 1)}, "`states` takes 1;"):
        made = experiment(designed("estimators", answers(np.zeros(3), 0, **attributes)), n_runs=1)
        assert text in simulated(made)[3][0].failures[0].message


@single_run
class Sometimes(Fixed):
    """An estimator that reports P in even runs only."""

    def update(self, run):
        """Return a tuple or an array."""
        return (self.x, np.eye(2)) if run % 2 == 0 else self.x


def test_a_run_without_P_does_not_depend_on_its_block():
    """Oracle: the metric of P has no value in the runs without P, in a block with other runs and alone."""
    made = experiment(designed("estimators", Sometimes), metrics=(Nees(),))
    whole = simulated(made)[1][0]
    assert np.isnan(whole).tolist() == [False, True] * 3
    np.testing.assert_array_equal(simulated(made, 1)[1][0], whole)


@single_run
class Oracle(Fixed):
    """An estimator that asks for the plant."""

    def __init__(self, plant):
        self.nx = plant.nx

    def update(self):
        """Return x0."""
        return self.x


def test_an_estimator_that_asks_for_the_plant_is_an_oracle():
    """Oracle: the mark of the experiment."""
    made = experiment(designed("estimators", Oracle))
    assert made.oracles == {"mine"} and not simulated(made)[0].any()
    assert experiment(designed("estimators", Textbook)).oracles == frozenset()


@single_run
class Noisy(Fixed):
    """An estimator with two kinds of warnings and an overflow."""

    def update(self, k):
        """Warn."""
        np.sqrt(np.array([-1.0]))
        np.exp(np.array([1000.0 + k]))
        return self.x


def test_warnings_are_counted_and_the_settings_of_the_loop_do_not_reach_the_user():
    """Oracle: one entry per text with calls x runs; with the loop's `ignore` there would be none."""
    made = experiment(designed("estimators", Noisy), n_runs=3)
    journal = simulate_block(made, made.methods[0], range(3)).journal
    assert sorted(journal.warnings.values()) == [3 * (N + 1)] * 2
    assert all("RuntimeWarning" in text and "test_single_estimator.py:" in text for text in journal.warnings)


def test_durations_are_kept_apart_for_the_first_step():
    """Oracle: one duration per call."""
    journal = simulated(experiment(designed("estimators", Textbook), n_runs=3))[3][0]
    counts = {name: len(values) for name, values in journal.seconds.items()}
    # The controller is built in and computes the block at once.
    assert counts == {"estimator, start": 6, "estimator, first step": 3, "estimator": 3 * N, "controller, block": 3}
    assert all(value >= 0.0 for values in journal.seconds.values() for value in values)
