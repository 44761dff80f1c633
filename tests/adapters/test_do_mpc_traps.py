"""MPC of do-mpc: each test shows that a plain call of the library goes wrong, and that the adapter does not."""

import pickle
import time
import warnings

import numpy as np
import pytest
from adapters.do_mpc_laws import small_mpc, tracking
from components.one_run import MODEL, TS, designed, experiment, simulated
from conftest import EXACT

from rmpc_bench import SolverError
from rmpc_bench.adapters.do_mpc import do_mpc_controller, quiet, set_up
from rmpc_bench.extras import is_installed
from rmpc_bench.types import Status

if not is_installed("do-mpc"):
    pytest.skip("do-mpc is not installed", allow_module_level=True)

STATES = np.random.default_rng(0).standard_normal((5, 2))
R = np.ones(1)


def plain(Ts=TS, r=1.0):
    """Return an MPC that is set up, with a constant reference, as a plain loop uses it."""
    mpc = quiet(tracking)(MODEL, 6, 1.0, 0.5)
    template = mpc.get_tvp_template()
    template["_tvp", :, "r"] = r
    mpc.set_tvp_fun(lambda t: template)
    set_up(mpc, Ts)
    return mpc


def inputs(mpc, states=STATES):
    """Call an MPC of do-mpc in a plain loop."""
    return np.array([mpc.make_step(x[:, None]).ravel() for x in states])


def adapted(states=STATES, **keys):
    """Call a new controller of the adapter in the same way."""
    law, u = small_mpc(model=MODEL, Ts=TS, **keys), [None]
    for k, x in enumerate(states):
        u.append(law.control(x, R, u[-1], k * TS))
    return np.array(u[1:])


def test_the_object_is_not_pickled_but_made_by_every_worker():
    """A design has the function and the keys; a copy of it gives the same bits."""
    mpc = plain()
    with pytest.raises(Exception, match="pickle"):
        pickle.dumps(mpc)
    law = designed("controllers", small_mpc, preview=7)
    got, expected = (simulated(experiment(controller=each))[2]["u"] for each in (pickle.loads(pickle.dumps(law)), law))
    np.testing.assert_array_equal(got, expected)


def test_the_history_is_reset_and_the_last_input_is_not():
    """A plain second run after `reset_history` has other inputs; here a run alone has the bits of a run in a block."""
    mpc = plain()
    mpc.set_initial_guess()
    first = inputs(mpc)
    mpc.reset_history()
    mpc.set_initial_guess()
    assert np.abs(inputs(mpc) - first).max() > 0.1
    np.testing.assert_allclose(first, adapted(), rtol=0, atol=1e-9)
    block, alone = (simulated(experiment(controller=designed("controllers", small_mpc)), n) for n in (6, 1))
    np.testing.assert_allclose(block[2]["u"], alone[2]["u"], **EXACT)


def test_a_solver_that_has_failed_gives_an_input_all_the_same():
    """With NaN in the state a plain call returns a number; the adapter raises, and begins anew at the next sample."""
    law, mpc, bad = small_mpc(model=MODEL, Ts=TS), plain(), np.array([np.nan, 0.0])
    mpc.set_initial_guess()
    assert mpc.make_step(bad[:, None]).shape == (1, 1)
    assert not mpc.solver_stats["success"]
    before = law.control(STATES[0], R, None, 0.0)
    with pytest.raises(SolverError, match="Invalid_Number_Detected"):
        law.control(bad, R, before, TS)
    after = law.control(STATES[1], R, before, 2 * TS)
    np.testing.assert_allclose(after, adapted()[1], rtol=0, atol=1e-9)


def impossible(model, Hp: int = 6, lowest: float = 0.0):
    """Keep the first state above a value, without slack."""
    mpc = tracking(model, Hp, 1.0, 0.5)
    mpc.bounds["lower", "_x", "x"] = np.array([lowest, -np.inf])
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = -0.5, 0.5
    return mpc


def test_a_failed_step_ends_the_run_or_is_held():
    """States that violate a bound whatever the input is: the run is infeasible; with `hold` it repeats the input."""
    law = do_mpc_controller(impossible)
    stopped = simulated(experiment(controller=designed("controllers", law, lowest=1.2)))
    assert set(stopped[0]) <= {Status.INFEASIBLE, Status.NOT_CONVERGED}
    messages = {failure.message for journal in stopped[3] for failure in journal.failures.values()}
    assert all(message.startswith("SolverError: the solver of do-mpc: ") for message in messages)
    keys = {"lowest": 0.2, "on_failure": "hold", "max_held": 1.0}
    held = simulated(experiment(controller=designed("controllers", law, **keys)))
    assert (held[0] == Status.OK).all()
    assert 0 < sum(sum(journal.held.values()) for journal in held[3]) < 6 * 12


def test_the_history_does_not_grow():
    """A plain loop keeps every sample and copies them all at each one; the adapter keeps one horizon."""
    states = np.tile(STATES, (4, 1))
    mpc, law = plain(), small_mpc(model=MODEL, Ts=TS)
    mpc.set_initial_guess()
    inputs(mpc, states)
    assert len(mpc.data["_x"]) == 20
    for k, x in enumerate(states):
        law.control(x, R, np.zeros(1), k * TS)
    assert {len(getattr(law.mpc.data, name)) for name in law.mpc.data.data_fields} <= {0, 6}


def test_without_an_initial_guess_do_mpc_warns_and_waits(monkeypatch):
    """It waits for five seconds in the first step, and for two in `setup` where moves have no weight."""
    waits = []
    monkeypatch.setattr(time, "sleep", waits.append)
    mpc = plain()
    with pytest.warns(UserWarning, match="guess"):
        mpc.make_step(np.zeros((2, 1)))
    assert waits == [5]

    def without_moves(model):
        import do_mpc

        from rmpc_bench.adapters.do_mpc import do_mpc_model

        made = do_mpc_model(model)
        mpc = do_mpc.controller.MPC(made)
        mpc.settings.n_horizon = 3
        mpc.set_objective(lterm=made.aux["y"] ** 2 + 1e-3 * made.u["u"] ** 2, mterm=made.aux["y"] ** 2)
        return mpc

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law = do_mpc_controller(without_moves)(model=MODEL, Ts=TS)
        law.control(np.ones(2), R, None, 0.0)
    assert waits == [5]


def test_the_solver_prints_to_the_c_stream(capfd):
    """An MPC that the user has set up prints; one that the adapter sets up does not."""

    def loud(model):
        mpc = tracking(model, 3, 1.0, 0.5)
        mpc.settings.t_step = TS
        template = mpc.get_tvp_template()
        mpc.set_tvp_fun(lambda t: template)
        mpc.setup()
        return mpc

    noisy = do_mpc_controller(loud)(model=MODEL, Ts=TS).control(np.ones(2), R, None, 0.0)
    assert "EXIT: Optimal Solution Found" in capfd.readouterr().out
    silent = small_mpc(model=MODEL, Ts=TS, Hp=3).control(np.ones(2), R, None, 0.0)
    assert capfd.readouterr().out == ""
    np.testing.assert_array_equal(noisy, silent)


def test_the_reference_of_a_plain_function_of_time_is_constant():
    """do-mpc asks a function for the reference; without the adapter it is not that of the experiment."""
    mpc, law = plain(), small_mpc(model=MODEL, Ts=TS, preview=7)
    mpc.set_initial_guess()
    r = np.linspace(0.0, 3.0, 7)[:, None]
    assert abs(inputs(mpc)[0, 0] - law.control(STATES[0], r, None, 0.0)[0]) > 0.1


@pytest.mark.parametrize(
    ("keys", "Ts", "message"),
    [
        ({"preview": 8}, TS, "preview = 8; an MPC with n_horizon = 6 uses 7 samples"),
        ({}, 2 * TS, "t_step of do-mpc is 0.5; the sampling time is 1.0"),
    ],
)
def test_what_does_not_fit_the_experiment(keys, Ts, message):
    """Another sampling time, or more samples of the reference than the horizon has."""

    def timed(model):
        mpc = tracking(model, 6, 1.0, 0.5)
        mpc.settings.t_step = TS
        return mpc

    with pytest.raises(ValueError, match=message):
        do_mpc_controller(timed)(model=MODEL, Ts=Ts, **keys)
