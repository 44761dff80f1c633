"""Controllers written for one run."""

import numpy as np
import pytest
from components.one_run import MODEL, TS, N, designed, experiment, kalman, simulated
from conftest import EXACT

from rmpc_bench import SolverError
from rmpc_bench.components.single_run import single_run
from rmpc_bench.types import Positive, Status
from rmpc_bench.types.contract import checked


@single_run
class Feedback:
    """u = K (r - x_hat[0])."""

    def __init__(self, K: Positive = 0.4):
        self.K = K

    def control(self, x_hat, r):
        """Return one number."""
        return self.K * (r[0] - x_hat[0])


@single_run
def law(x_hat, r, K: Positive = 0.4):
    """Return the same by a function without memory."""
    return K * (r - x_hat[:1])


def test_a_law_of_one_run():
    """Oracle: the formula on the recorded estimates; a class and a function give the same bits."""
    traces = simulated(experiment(controller=designed("controllers", Feedback, K=0.7)))[2]
    np.testing.assert_allclose(traces["u"][..., 0], 0.7 * (1.0 - traces["x_hat"][:, :-1, 0]), **EXACT)
    same = simulated(experiment(controller=designed("controllers", law, K=0.7)))[2]
    np.testing.assert_array_equal(same["u"], traces["u"])


@single_run
class Everything:
    """A law that keeps all that it can ask for."""

    preview = 3
    seen = []

    def __init__(self, model, n_steps, Ts, limits, plant_info, estimator, run):
        self.first = (model, n_steps, Ts, limits, plant_info, estimator, run)

    def control(self, x_hat, r, y, u_previous, P, e, info, k, t, rng):
        """Keep it; return k + 1."""
        assert e == info["e"]
        self.seen.append((*self.first, x_hat, r, y, u_previous, P, info, k, t))
        return [k + 1.0]


def test_everything_a_law_may_ask_for():
    """Oracle: shapes and values by hand; u(k-1) is None at k = 0."""
    Everything.seen.clear()
    from rmpc_bench.components.single_run import design_function
    from rmpc_bench.types import PlantInfo

    from components.one_run import TwoStates  # isort: skip

    filter_ = kalman()
    info = PlantInfo.of(TwoStates())
    design = design_function("controllers", Everything)(MODEL, n_steps=N, Ts=TS, plant_info=info, estimator=filter_)
    assert not simulated(experiment(filter_, design, n_runs=1))[0].any()
    for k, seen in enumerate(Everything.seen):
        model, n_steps, Ts, limits, plant_info, estimator, run, x_hat, r, y, u_previous, P, entries, at, t = seen
        assert (n_steps, Ts, estimator, run, at, t) == (N, TS, filter_, 0, k, k * TS)
        np.testing.assert_array_equal(model.A, MODEL.A)
        assert (
            x_hat.shape == (2,)
            and r.shape == (3, 1)
            and y.shape == (1,)
            and P.shape == (2, 2)
            and set(entries) == set(filter_.reports)
        )
        assert (u_previous is None) if k == 0 else u_previous == [k]
        assert limits.u[0] == [-np.inf] and plant_info.states == ("x.0", "x.1")
    assert len(Everything.seen) == N


@single_run
class Warm:
    """A solver that begins at its last solution, as an optimiser with a warm start; `reset` does not undo that."""

    def __init__(self, prepared):
        self.solver = prepared if self.shared else Solver()

    shared = False

    @classmethod
    def prepare(cls, model):
        """Make the solver of the process."""
        return Solver()

    def control(self, x_hat):
        """Take one step of the solver from where it stands."""
        return self.solver.solve(x_hat[0])


class Solver:
    """Newton-like iteration that keeps its last solution."""

    def __init__(self):
        self.u = 0.0

    def solve(self, target):
        """Move half of the way."""
        self.u += 0.5 * (-target - self.u)
        return self.u

    def reset_history(self):
        """Reset the history; the solution stays, as in do-mpc."""


@single_run
class Shared(Warm):
    """The naive adapter: one solver for all runs, with `reset_history` at the start of each."""

    shared = True

    def start(self):
        """Reset."""
        self.solver.reset_history()


def test_no_run_begins_where_another_ended():
    """Oracle: the first input of every run is that of a new solver, in any block; a shared solver fails this."""
    for block in (1, 3, 6):
        traces = simulated(experiment(controller=designed("controllers", Warm)), block)[2]
        np.testing.assert_array_equal(traces["u"][:, 0, 0], -0.5 * traces["x_hat"][:, 0, 0])
    naive = simulated(experiment(controller=designed("controllers", Shared)))[2]
    assert not np.array_equal(naive["u"][1:, 0, 0], -0.5 * naive["x_hat"][1:, 0, 0])


@single_run
class Costly:
    """A law with something costly that is made once per process."""

    made = []

    @classmethod
    def prepare(cls, model, **keys):
        """Count."""
        cls.made.append((model, keys))
        return ("gain", keys["K"])

    def __init__(self, prepared, K: float = 1.0):
        self.prepared = prepared

    def control(self, x_hat, prepared):
        """Use it."""
        assert self.prepared is prepared
        return -prepared[1] * x_hat[0]


def test_prepare_is_called_once_per_process():
    """Oracle: one call for three blocks of two methods' worth of runs; the keys of the configuration come with it."""
    Costly.made.clear()
    made = experiment(controller=designed("controllers", Costly, K=0.25))
    assert not simulated(made, 2)[0].any() and not simulated(made, 3)[0].any()
    assert [keys for _, keys in Costly.made] == [{"K": 0.25}]


@single_run
class Broken(Costly):
    """A law whose preparation fails."""

    @classmethod
    def prepare(cls, model):
        """Fail."""
        raise ValueError("no compiler")


@single_run
class BrokenStart:
    """A law that fails in its start for one run."""

    def start(self, run):
        """Fail for run 1."""
        if run == 1:
            raise SolverError("no start")

    def control(self):
        """Return 0."""
        return 0.0


def test_a_failure_before_the_first_sample():
    """Oracle: all runs of a component that cannot be prepared; one run where only its start fails; no hold."""
    status, _, traces, (journal,) = simulated(experiment(controller=designed("controllers", Broken)))
    assert (status == Status.CRASHED).all() and journal.failures[5].message == "ValueError: no compiler"
    assert journal.failures[5].k is None and np.isfinite(traces["u"]).all()
    status, _, _, (journal,) = simulated(
        experiment(controller=designed("controllers", BrokenStart, on_failure="hold"), n_runs=3)
    )
    assert status.tolist() == [0, Status.NOT_CONVERGED, 0] and not journal.held


@single_run
class Failing:
    """A law that fails at k = 3 and 4 in odd runs."""

    def control(self, k, run):
        """Count samples."""
        if run % 2 and k in (3, 4):
            raise SolverError("infeasible", infeasible=True)
        return k + 1.0


def test_a_held_step_repeats_the_last_input():
    """Oracle: u by hand; 2 of 12 steps are more than 10 %, and less than 20 %."""
    held = experiment(controller=designed("controllers", Failing, on_failure="hold", max_held=0.2))
    status, _, traces, (journal,) = simulated(held)
    assert not status.any() and journal.held == {1: 2, 3: 2, 5: 2}
    assert traces["u"][1, :7, 0].tolist() == [1, 2, 3, 3, 3, 6, 7]
    status, _, _, (journal,) = simulated(
        experiment(controller=designed("controllers", Failing, on_failure="hold"), n_runs=2)
    )
    assert status.tolist() == [0, Status.INFEASIBLE] and journal.failures[1].k == 4
    status, _, _, (journal,) = simulated(experiment(controller=designed("controllers", Failing), n_runs=2))
    assert status.tolist() == [0, Status.INFEASIBLE] and journal.failures[1].k == 3


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1.0, 2.0], "control returned 2 numbers; the model has 1 input (k = 2)"),
        (np.nan, "control returned u with NaN or inf (k = 2)"),
        ((1.0, 2.0), "control returned a tuple of 2 entries; u, or (u, info), is expected (k = 2)"),
        ((1.0, {"cost": 1.0}), "control reports 'cost', which `reports` of the class does not name (nothing) (k = 2)"),
    ],
)
def test_a_wrong_input_is_a_crash_with_a_sentence(value, message):
    """Oracle: the sentences."""
    mine = single_run(type("Mine", (), {"control": lambda self, k: value if k == 2 else 0.0}))
    status, _, _, (journal,) = simulated(experiment(controller=designed("controllers", mine), n_runs=1))
    assert status.tolist() == [Status.CRASHED] and journal.failures[0].message == message


def test_the_registry_takes_what_the_design_function_makes():
    """Oracle: the law by hand for a state, without a simulation; `init` needs no runs."""
    design = designed("controllers", Feedback, K=2.0)
    estimate = kalman().correct(0, kalman().init(2), np.ones((2, 1)))[1]
    _, command = design.control(0, design.init(2), np.ones((2, 1)), estimate, np.ones((1, 1)))
    np.testing.assert_allclose(command.u[:, 0], 2.0 * (1.0 - estimate.x_hat[:, 0]), **EXACT)
    assert checked("controllers", "mine", design, {"model": MODEL}) is design
