"""Environment of Gymnasium as plant, and a configuration as an environment.

Model   x(k+1) is the state after `step` with the action u(k), plus w(k);  y(k) are entries of the state or the
        observation, or output(x, p), plus v(k).  There is one environment per run and method.
Random  The seed of `reset` is drawn from the stream of the run, so that all methods have the same initial state.  An
        environment that draws other random numbers after other actions gives the methods different noise; `check`
        tests this and says so.
Time    One call of `step` is one sample.  The time limit of the registration does not apply.
Inputs  A box limits u to its bounds; how often is counted.  Discrete actions need values of u, the key `action`.
Fails   Status `out-of-range`: the environment has terminated or truncated the episode, with `terminated: end`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal
from warnings import catch_warnings, simplefilter

from rmpc_bench.adapters.gymnasium_design import Keys, designed
from rmpc_bench.adapters.gymnasium_env import env as env
from rmpc_bench.adapters.gymnasium_plant import EnvironmentPlant
from rmpc_bench.models.ode_functions import Names
from rmpc_bench.types import UserFunction, UserFunctionOrText


def design(
    Ts: float,
    n_steps: int,
    *,
    env: UserFunctionOrText,
    options: dict[str, Any] | None = None,
    state: UserFunctionOrText = None,
    set_state: UserFunction = None,
    start: Literal["reset", "initial"] = "reset",
    output: list[str] | UserFunction = None,
    states: Names | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    action: list[float] | UserFunction = None,
    parameters: dict[str, float] | None = None,
    set_parameters: UserFunction = None,
    terminated: Literal["end", "ignore"] = "end",
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> EnvironmentPlant:
    """Environment of Gymnasium, one per run and method.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    env : ID such as ``Pendulum-v1`` or ``package:Name-v0``, or ``PATH.py:NAME`` of a class or a function that makes one
    options : keywords of its class
    state : attribute that is the state, or ``PATH.py:NAME`` of get(environment); the observation if not given
    set_state : ``PATH.py:NAME`` of set(environment, x), where the state is no attribute that can be assigned
    start : x(0) is that of `reset` of the environment, or that of the section `initial`
    output : names of states and ``observation.0``, ``observation.1`` .., or ``PATH.py:NAME`` of output(x, p); without
        it all states are measured
    states, inputs, outputs : names, such as ``[theta, omega]`` or ``{torque: N m}``; a count where not given
    action : values of u for the discrete actions 0, 1, .., of which the nearest is applied, or ``PATH.py:NAME`` of a
        function from u to an action
    parameters : name -> nominal value, of keywords or attributes of the environment; `perturb` and `set` may name them
    set_parameters : ``PATH.py:NAME`` of set(environment, p), where other attributes depend on the parameters
    terminated : whether a run ends where the environment ends an episode
    bounds : name of a state or an input -> lower and upper bound

    Raises
    ------
    DesignError
        If there is no such environment, or a key does not fit it.
    """
    given = Keys(env, options or {}, state, set_state, start, output, states, inputs, outputs, action)
    # Warnings of the environment are counted in the runs.
    with catch_warnings():
        simplefilter("ignore")
        return designed(Ts, n_steps, given, parameters or {}, set_parameters, terminated == "end", bounds or {})
