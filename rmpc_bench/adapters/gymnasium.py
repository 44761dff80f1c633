"""Environment of Gymnasium as kind of plant: its keys, and the trial whether its random numbers depend on actions.

Model   x(k+1) is the state after `step` with the action u(k), plus w(k);  y(k) are entries of the state or the
        observation, or output(x, p), plus v(k).
Random  The seed of `reset` is drawn from the stream of the run, so that all methods have the same initial state.
        `check` says where an environment draws other random numbers after other actions.
Time    One call of `step` is one sample.  The time limit of the registration does not apply.
Inputs  A box limits u to its bounds; how often is counted.  Discrete actions need values of u, the key `action`.
Fails   Status `out-of-range`: the environment has terminated or truncated the episode, with `terminated: end`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from timeit import default_timer
from traceback import extract_tb
from typing import Any, Literal, NamedTuple, TypeVar
from warnings import catch_warnings, simplefilter

import numpy as np

from rmpc_bench.adapters.gymnasium_env import env as env
from rmpc_bench.adapters.gymnasium_plant import Access, DiscreteInput, EnvironmentPlant, EnvironmentRun, actions_of
from rmpc_bench.components.loading import is_source
from rmpc_bench.components.user_code import last_user_frame, one_line
from rmpc_bench.extras import MissingLibraryError
from rmpc_bench.models.ode_functions import Names, is_fed, names_of, refuse_shared
from rmpc_bench.plants.ode_design import bounds_by_name
from rmpc_bench.received.consent import reason_against_module
from rmpc_bench.types import Array, DesignError, OutOfRange, Parameters, Signals, UserFunction, UserFunctionOrText
from rmpc_bench.types.errors import unknown

SAMPLES = 20
"""Steps for which an environment is tried."""
NO_NOISE = np.zeros(0)
T = TypeVar("T")


# What an environment does with random numbers, its state and its parameters: tried when a plant is designed.
#
# Two copies of the environment start from the same seed.  Where they draw other random numbers after other actions, the
# methods of an experiment have different noise.


class Trial(NamedTuple):
    """Some steps of one environment."""

    x: list[Array]  # states from k = 0 on
    random: list[Any]  # state of its random generator after each of them; None where it has none
    seconds: float  # shortest time of a step [s]


def attempt(key: str, call: Callable[[], T]) -> T:
    """Call something of the environment or of the user; what it raises is a DesignError at the key."""
    try:
        return call()
    except (DesignError, MissingLibraryError):
        raise
    except Exception as error:
        frame = extract_tb(error.__traceback__)[-1]
        # The line of an error is shown where it is in a file of the user, not in a library.
        place = last_user_frame(error) if is_source(frame.filename) else ""
        text = one_line(error)
        if type(error).__module__.startswith("gymnasium"):
            text = text.partition(": ")[2]
        raise DesignError(f"{place}: {text}" if place else text, key) from None


def started(access: Access, p: Parameters, x0: Array | None = None) -> EnvironmentRun:
    """Start a new environment from a fixed seed, at x0 or at the state of `reset`."""
    run = EnvironmentRun(replace(access, starts_at_x0=x0 is not None))
    run.start(p, np.zeros(0) if x0 is None else x0, np.random.Generator(np.random.PCG64(0)))
    return run


def trial(access: Access, p: Parameters, inputs: Sequence[Array], x0: Array | None = None) -> Trial:
    """Step a new environment with one input per step, until it ends an episode."""
    run = started(access, p, x0)
    x, random, seconds = [run.x], [_generator(run.inner)], np.inf
    for u in inputs:
        before = default_timer()
        try:
            x.append(run.step(u.copy(), NO_NOISE))
        except OutOfRange:
            break
        seconds = min(seconds, default_timer() - before)
        random.append(_generator(run.inner))
    return Trial(x, random, float(seconds) if np.isfinite(seconds) else 0.0)


def _generator(inner: Any) -> Any:
    """State of the generator of an environment; None where `reset` has not made one."""
    generator = getattr(inner, "_np_random", None)
    return None if generator is None else repr(generator.bit_generator.state)


def inputs_between(low: Array, high: Array, share: float) -> list[Array]:
    """Return constant inputs at a share of their range; without limits it is -1 to 1."""
    low, high = np.where(np.isfinite(low), low, -1.0), np.where(np.isfinite(high), high, 1.0)
    return [np.asarray(low + share * (high - low), dtype=float)] * SAMPLES


def is_repeatable(first: Trial, again: Trial) -> bool:
    """Whether the same seed and the same actions give the same states."""
    same_length = len(first.x) == len(again.x)
    return same_length and all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first.x, again.x, strict=True))


def random_numbers(first: Trial, other: Trial) -> str:
    """Say when an environment draws: ``never``, ``every action alike`` or ``by action``, from trials of two actions."""
    n = min(len(first.random), len(other.random))
    if first.random[:n] != other.random[:n]:
        return "by action"
    return "never" if len(set(first.random)) == 1 else "every action alike"


def is_writable(access: Access, p: Parameters, inputs: Sequence[Array]) -> bool:
    """Whether a state that is written is read back, and the next step starts from it."""
    if access.state is None or not access.writes:
        return False
    run = started(access, p)
    other = run.x + 1e-3 * (1.0 + np.abs(run.x))
    try:
        access.write(run.inner, other.copy())
        read_back = access.read(run.inner, run.observation)
        moved, unmoved = trial(access, p, inputs[:1], other), trial(access, p, inputs[:1])
    except (AttributeError, TypeError, ValueError):
        return False
    # An episode that ends at once has no second state.
    differs = len(moved.x) != len(unmoved.x) or not np.array_equal(moved.x[-1], unmoved.x[-1])
    return bool(np.array_equal(read_back, other) and differs)


def without_effect(access: Access, p: Parameters, inputs: Sequence[Array], first: Trial) -> list[str]:
    """Return the parameters of which a change by 10 % changes no state."""
    found = []
    for name in p:
        changed = Parameters({**p, name: p[name] * 1.1 if p[name] else 0.1})
        if is_repeatable(first, trial(access, changed, inputs)):
            found.append(name)
    return found


BY_ACTION = (
    "the environment draws other random numbers after other actions: in one run the methods have different noise, so "
    "that paired differences have a larger standard error"
)
UNSEEDED = (
    "equal seeds and actions give different states, so that equal methods differ and runs cannot be repeated: the "
    "environment draws from another generator than its own `np_random`, or changes what all its objects share"
)


class Keys(NamedTuple):
    """Keys of the configuration; see `rmpc_bench.adapters.gymnasium.design`."""

    env: Any
    options: dict[str, Any]
    state: Any
    set_state: Any
    start: str
    output: Any
    states: Names | None
    inputs: Names | None
    outputs: Names | None
    action: Any
    p: Parameters
    set_parameters: Any
    ends: bool
    bounds: Mapping[str, tuple[float, float]]


def _designed(Ts: float, n_steps: int, keys: Keys) -> EnvironmentPlant:
    """Try an environment and return the plant."""
    inner, access = _accessed(keys)
    first = attempt("state", lambda: started(access, keys.p))
    if first.inner is inner:
        raise DesignError("returns the same environment every time: make a new one, since every run has its own", "env")
    assert access.action is not None
    signals = _signals(keys, first.x, access.action.low, access.action.high)
    if access.action.values is not None:
        signals = DiscreteInput(**vars(signals), values=access.action.values)
    access, measured = _with_output(access, keys, signals, np.size(first.observation))
    if measured is None:
        y = attempt("output", lambda: access.measure(first.x, keys.p, first.observation))
        if np.size(y) != signals.ny:
            raise DesignError(f"returns {np.size(y)} numbers; outputs: {signals.ny}", "output")
    access, tried = _tried(access, keys.p)
    if keys.start == "initial":
        if not access.writes:
            text = "the state cannot be set: name an attribute as `state`, or a function as `set_state`"
            raise DesignError(text, "start")
        access = replace(access, starts_at_x0=True)
    plant = EnvironmentPlant(access, signals, measured, dict(keys.p), float(Ts), n_steps)
    plant.repeats, plant.seconds_per_step = tried.is_repeatable, tried.trial.seconds
    _describe(plant, keys, first, tried)
    return plant


def _accessed(keys: Keys) -> tuple[Any, Access]:
    """Make an environment; return it, and how every other one is made, moved and read."""
    # An option may name an environment, too.
    for key, value in (("env", keys.env), *((f"options.{name}", each) for name, each in keys.options.items())):
        for reason in filter(None, map(reason_against_module, _texts(value))):
            raise DesignError(reason, key)
    writes = isinstance(keys.state, str) or keys.set_state is not None
    access = Access(keys.env, keys.options, keys.state, keys.set_state, keys.ends, writes)
    # The first import of the library: a missing one is reported with its extra.
    inner = attempt("env", lambda: access.make(Parameters({}))).unwrapped
    change, taken = keys.set_parameters, inspect.signature(type(inner).__init__).parameters
    keywords = [name for name in keys.p if name in taken and not change]
    if not change:
        _refuse_unknown(inner, [name for name in keys.p if name not in keywords])
    if keys.state is None and inner.observation_space.shape is None:
        kind = type(inner.observation_space).__name__
        raise DesignError(f"the observation is a {kind}; name an attribute or a function that is the state", "state")
    nu = None if keys.inputs is None else len(names_of(keys.inputs, "inputs", "u")[0])
    action = actions_of(inner.action_space, keys.action, nu)
    return inner, replace(access, keywords=keywords, change=change, action=action)


def _texts(value: Any) -> Iterator[str]:
    """Yield the texts of plain data, those of names included."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list | tuple):
        for each in (*value, *value.values()) if isinstance(value, dict) else value:
            yield from _texts(each)


def _refuse_unknown(inner: Any, names: list[str]) -> None:
    """Refuse parameters that are neither keywords nor attributes."""
    numbers = [name for name, each in vars(inner).items() if isinstance(each, int | float) and name[0] != "_"]
    for name in names:
        if not hasattr(inner, name):
            text = unknown(name, [each for each in numbers if not isinstance(getattr(inner, each), bool)], "attribute")
            raise DesignError(f"{type(inner).__name__}: {text}", f"parameters.{name}")


def _signals(keys: Keys, x: Array, low: Array, high: Array) -> Signals:
    """Return names, units and bounds; those of an input are within the limits of the actions."""
    nx, nu = len(x), len(low)
    state, units = names_of(nx if keys.states is None else keys.states, "states", "x")
    inputs, u_units = names_of(nu if keys.inputs is None else keys.inputs, "inputs", "u")
    refuse_shared(state, inputs)
    for key, names, n in (("states", state, nx), ("inputs", inputs, nu)):
        if len(names) != n:
            raise DesignError(f"has {len(names)} names; the environment has {n} {key}", key)
    entries = keys.output if isinstance(keys.output, list) else None
    if callable(keys.output):
        is_fed(keys.output, allowed=False)
        if keys.outputs is None:
            raise DesignError("name the outputs, or give their number", "outputs")
    default = (
        list(state) if entries is None else [each if each in state else f"y.{i}" for i, each in enumerate(entries)]
    )
    given = keys.outputs
    outputs, y_units = (tuple(default), units) if given is None else names_of(given, "outputs", "y")
    if not callable(keys.output) and len(outputs) != len(default):
        raise DesignError(f"has {len(outputs)} names; there are {len(default)} outputs", "outputs")
    own = bounds_by_name(keys.bounds, state, inputs)
    for name, least, most in zip(inputs, low.tolist(), high.tolist(), strict=True):
        lower, upper = own.get(name, (-np.inf, np.inf))
        if np.isfinite([least, most]).any() or name in own:
            own[name] = max(least, lower), min(most, upper)
    return Signals(state, inputs, outputs, {**y_units, **u_units, **units}, own)


def _with_output(access: Access, keys: Keys, signals: Signals, n_seen: int) -> tuple[Access, list[int] | None]:
    """Return the access with what measures, or the indices of the states that are measured."""
    if keys.output is None:
        return access, list(range(signals.nx))
    if callable(keys.output):
        return replace(access, output=keys.output), None
    entries = [_entry(each, signals, n_seen) for each in keys.output]
    if all(of_state for of_state, _ in entries):
        return access, [i for _, i in entries]
    if keys.start == "initial":
        text = "an observation of x(0) is not known with `start: initial`; give names of states, or a function"
        raise DesignError(text, "output")
    return replace(access, output=entries), None


def _entry(name: str, signals: Signals, n_seen: int) -> tuple[bool, int]:
    """Return whether an output is an entry of the state, and its index."""
    known = [*signals.states, *(f"x.{i}" for i in range(signals.nx))]
    seen = [f"observation.{i}" for i in range(n_seen)]
    if name in known:
        return True, known.index(name) % signals.nx
    if name in seen:
        return False, seen.index(name)
    raise DesignError(unknown(name, [*signals.states, *seen], "state or observation"), "output")


class _Tried(NamedTuple):
    """Results of the trials of an environment."""

    trial: Trial
    is_repeatable: bool
    random: str
    is_rounded: bool
    useless: list[str]


def _tried(access: Access, p: Parameters) -> tuple[Access, _Tried]:
    """Step copies of the environment."""
    action, rounded = access.action, False
    assert action is not None
    few, many = (inputs_between(action.low, action.high, share) for share in (0.25, 0.75))
    try:
        first = trial(access, p, few)
    except Exception:
        if not action.is_box:
            return access, attempt("action", lambda: trial(access, p, few))  # type: ignore[return-value]
        access, rounded = replace(access, action=replace(action, dtype=np.float32)), True
        first = attempt("env", lambda: trial(access, p, few))
    again, other = trial(access, p, few), trial(access, p, many)
    if not is_writable(access, p, few):
        access = replace(access, writes=False)
    repeatable = is_repeatable(first, again)
    useless = without_effect(access, p, few, first) if repeatable else []
    return access, _Tried(first, repeatable, random_numbers(first, other), rounded, useless)


def _describe(plant: EnvironmentPlant, keys: Keys, first: EnvironmentRun, tried: _Tried) -> None:
    """Add what `check` and `describe` say."""
    name, inner, remarks = type(first.inner).__name__, first.inner, _remarks(keys, first, tried, plant.Ts)
    limits = tuple(f"{each[0].upper()}{each[1:]}." for each in remarks if each in (BY_ACTION, UNSEEDED))
    plant.__dict__ |= {"remarks": tuple(remarks), "limitations": limits}
    assert plant.signals is not None
    random = {"never": "none after reset", "every action alike": "the same for every action"}
    plant.described = (
        ("environment", f"{name}, one per run and method"),
        ("actions, observation", f"{inner.action_space}, {inner.observation_space}"),
        ("states", ", ".join(plant.signals.states) + ("" if plant.access.writes else " (cannot be set)")),
        ("parameters", ", ".join(f"{each} = {keys.p[each]:g}" for each in keys.p) or "none"),
        ("random numbers", random.get(tried.random, "other ones after other actions")),
    )


def _remarks(keys: Keys, first: EnvironmentRun, tried: _Tried, sampling_time: float) -> list[str]:
    name, inner = type(first.inner).__name__, first.inner
    own = "is that of `initial`" if keys.start == "initial" else "is drawn by `reset`, with a seed of the run"
    remarks = [f"x(0) {own}"]
    if keys.state is None:
        kind = np.asarray(first.observation).dtype
        remarks.append(f"the state is the observation ({kind}); `state` may name an attribute in double precision")
    if tried.random == "by action":
        remarks.append(BY_ACTION)
    if not tried.is_repeatable:
        remarks.append(UNSEEDED)
    Ts = next((getattr(inner, each) for each in ("dt", "tau") if hasattr(inner, each)), None)
    if isinstance(Ts, int | float) and not np.isclose(Ts, sampling_time):
        remarks.append(f"a step of the environment takes {Ts:g} s, and `time.step` is {sampling_time:g} s")
    if tried.is_rounded:
        remarks.append("the environment refuses actions in double precision: they are rounded to float32")
    if first.env is not inner:
        remarks.append("the wrappers of its registration stay: " + str(first.env).partition("<" + name)[0].strip("<"))
    for each in tried.useless:
        remarks.append(f"a change of the parameter {each} by 10 % changes no state of {len(tried.trial.x) - 1} steps")
    return remarks


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
    set_state : set(environment, x), where the state is no attribute that can be assigned
    start : x(0) is that of `reset` of the environment, or that of the section `initial`
    output : names of states and ``observation.0``, ``observation.1`` .., or ``PATH.py:NAME`` of output(x, p); without
        it all states are measured
    states, inputs, outputs : names, such as ``{torque: N m}``; a count where not given
    action : values of u for the discrete actions 0, 1, .. (the nearest is applied), or ``PATH.py:NAME`` of a function
        from u to an action
    parameters : name -> nominal value, of keywords or attributes of the environment; `perturb` and `set` may name them
    set_parameters : set(environment, p), where other attributes depend on the parameters
    terminated : whether a run ends where the environment ends an episode
    bounds : name of a state or an input -> lower and upper bound

    Raises
    ------
    DesignError
        If there is no such environment, or a key does not fit it.
    """
    p, ends = Parameters({name: float(value) for name, value in (parameters or {}).items()}), terminated == "end"
    given = options or {}, state, set_state, start, output, states, inputs, outputs, action
    # Warnings of the environment are counted in the runs.
    with catch_warnings():
        simplefilter("ignore")
        return _designed(Ts, n_steps, Keys(env, *given, p, set_parameters, ends, bounds or {}))
