"""Plant that is a CasADi function, or an equation in the form of `casadi.integrator`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from rmpc_bench.adapters.casadi import CasadiFunction, reason
from rmpc_bench.extras import library
from rmpc_bench.models.ode_functions import Names, count
from rmpc_bench.plants import ode
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError, UserFunction

EQUATION = r"""\dot x = f(t, x, z, u_k, p), \quad
0 = g(t, x, z, u_k, p), \quad x_{k+1} = x((k+1) T_s) + w_k, \quad y_k = h(x_k, p) + v_k"""
ARGUMENTS = {1: ("x",), 2: ("x", "u"), 3: ("x", "u", "p"), 4: ("t", "x", "u", "p")}
"""Number of inputs of an equation -> what they are."""
PARTS = ("t", "x", "z", "u", "p", "ode", "alg")
"""Of an equation that `casadi.integrator` takes."""
KEYS = {"x": "states", "u": "inputs", "p": "parameters"}
"""Input -> key with the names of its entries."""
OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "idas": {"reltol": 1e-8, "abstol": 1e-10},
    "collocation": {"number_of_finite_elements": 20},
}
"""Integrator -> its options where a configuration gives none."""


def named_object(found: Any) -> Any:
    """Return a `casadi.Function`, or the parts of an equation; a function of Python returns one of them."""
    Function = library("casadi").Function
    made = found if isinstance(found, Function | Mapping) or not callable(found) else found()
    if isinstance(made, Mapping):
        if not ({"x", "ode"} <= set(made) <= set(PARTS) and ("z" in made) == ("alg" in made)):
            text = f"has x and ode, z with alg, and may have t, u and p (got {', '.join(map(str, made))})"
            raise DesignError(f"an equation for casadi.integrator {text}", "casadi")
    elif not isinstance(made, Function):
        text = "must be a casadi.Function, a dict as casadi.integrator takes it, or a function that returns one"
        raise DesignError(f"{text} (got {type(made).__name__})", "casadi")
    return made


def equation(made: Any) -> tuple[Any, tuple[str, ...]]:
    """Return the function of an equation without algebraic variables, and the names of its inputs."""
    if not isinstance(made, Mapping):
        return made, input_names(made, ARGUMENTS, "casadi")
    names = ARGUMENTS[4 if "t" in made else 3]
    none = type(made["x"]).sym("none", 0)
    return library("casadi").Function("ode", [made.get(name, none) for name in names], [made["ode"]]), names


def input_names(function: Any, orders: Mapping[int, tuple[str, ...]], key: str) -> tuple[str, ...]:
    """Return what the inputs are: by their names, else those of the symbols, else the order for their number."""
    n, every = function.n_in(), max(orders.values(), key=len)
    automatic = function.name_in() == [f"i{i}" for i in range(n)]
    own = tuple(map(_common_name, _symbols(function)) if automatic else function.name_in())
    if "x" in own and set(own) <= set(every) and len({*own}) == n:
        return own
    order = orders.get(n, ())
    if order and automatic and not any(each in ARGUMENTS[4] and each != order[i] for i, each in enumerate(own)):
        return order
    expected = " or ".join(f"({', '.join(orders[size])})" for size in sorted(orders)[-2:])
    text = f"must have the inputs {expected}, or inputs with names from {', '.join(every)}"
    raise DesignError(f"{text}: Function(name, [..], [..], ['x', ..], [..]) (got {function})", key)


def _symbols(function: Any) -> list[list[str]]:
    """Return the names of the entries of every input; none where CasADi does not keep them."""
    if function.is_a("SXFunction"):
        return [entry_names(each) for each in function.sx_in()]
    symbols = function.mx_in() if function.is_a("MXFunction") else []
    return [[each.name()] if each.is_symbolic() else [] for each in symbols]


def _common_name(entries: Sequence[str]) -> str:
    """Return the name of the symbol that has these entries; empty where they belong to several."""
    name = entries[0].removesuffix("_0") if entries else ""
    return name if len(entries) == 1 or [*entries] == [f"{name}_{i}" for i in range(len(entries))] else ""


def entry_names(column: Any) -> list[str]:
    """Return the names of the entries of a column of symbols; none of a column of MX, which is one symbol."""
    casadi = library("casadi")
    is_column = isinstance(column, casadi.SX) and column.is_column() and column.is_dense()
    return [each.name() if each.is_symbolic() else "" for each in casadi.vertsplit(column)] if is_column else []


def refuse_other_order(entries: Sequence[str], given: Any, what: str, key: str) -> None:
    """Refuse names of a configuration that the entries of a column have in another order."""
    names = [] if isinstance(given, int) else [*given]
    if any(name in entries and entries.index(name) != i for i, name in enumerate(names)):
        text = f"{what} has the entries {', '.join(entries)}; give their names in this order"
        raise DesignError(f"{text} (got {', '.join(names)})", key)


def checked(
    function: Any, names: tuple[str, ...], given: Mapping[str, Names], key: str, *, alone: bool = False
) -> CasadiFunction:
    """Return a `casadi.Function` as a function of numbers; `given` has the names or the number of entries per input."""
    casadi, n, shown_name = library("casadi"), len(names), function.name()
    if function.n_out() != 1:
        raise DesignError(f"must have the inputs {', '.join(names)} and one result (got {function})", key)
    if any(each != 1 for each in [*map(function.size2_in, range(n)), function.size2_out(0)]):
        raise DesignError(f"must take and return columns (got {function})", key)
    entries = dict(zip(names, _symbols(function), strict=False))
    for name, each in given.items():
        if name in names:
            size = function.size1_in(names.index(name))
            if size != count(each):
                raise DesignError(f"{name} of {shown_name} has {size} entries; {KEYS[name]}: {count(each)}", KEYS[name])
            if len(own := entries.get(name, [])) == size:
                refuse_other_order(own, each, f"{name} of {shown_name}", KEYS[name])
        elif count(each) and key != "output":
            raise DesignError(f"{shown_name} has no input {name}: its inputs are {', '.join(names)}", KEYS[name])
    symbols = [casadi.MX.sym(name, function.size1_in(i)) for i, name in enumerate(names)]
    if not all(each.is_dense() for each in [*map(function.sparsity_in, range(n)), function.sparsity_out(0)]):
        # The memory of a call has no structural zeros.
        function = casadi.Function(shown_name, symbols, [casadi.densify(function(*symbols))])
    shown = ("x", "p") if key == "output" else ARGUMENTS[4 if "t" in names else 3]
    return CasadiFunction(function, names, shown, alone=alone)


def sampled_dae(
    dae: Mapping[str, Any], Ts: float, integrator: str, options: Mapping[str, float], guess: Mapping[str, float] | None
) -> tuple[Any, tuple[str, ...]]:
    """Return x(k+1) of (x, u, p) or (t, x, u, p) as `casadi.Function`, and the names of its inputs.

    At the beginning of every sample Newton's method computes the algebraic variables from the same guess, so that
    x(k+1) depends on nothing else.  The guess has the values in the order of z; None is 0.
    """
    casadi, names = library("casadi"), ARGUMENTS[4 if "t" in dae else 3]
    kind, parts = type(dae["x"]), dict(dae)
    none, start = kind.sym("none", 0), kind.sym("start", int("t" in dae))
    if "t" in dae:
        # The integrator counts the time from 0 in every sample.
        moved = casadi.substitute([dae["ode"], dae["alg"]], [dae["t"]], [dae["t"] + start])
        parts |= {"ode": moved[0], "alg": moved[1]}
    parts |= {"p": casadi.vertcat(dae.get("p", none), start)}
    z0 = [0.0] * dae["z"].numel() if guess is None else [*guess.values()]
    if len(z0) != dae["z"].numel():
        raise DesignError(f"has {len(z0)} entries; z has {dae['z'].numel()}", "algebraic")
    refuse_other_order(entry_names(dae["z"]), guess or {}, "z", "algebraic")
    whole = {name: int(value) if float(value).is_integer() else value for name, value in options.items()}
    try:
        begin = parts["alg"] if "t" not in dae else casadi.substitute(parts["alg"], dae["t"], 0)
        given = casadi.vertcat(dae["x"], dae.get("u", none), parts["p"])
        find = casadi.rootfinder("algebraic", "newton", {"x": dae["z"], "p": given, "g": begin})
        # The correction of idas fails at some states that are consistent already, if its first time is Ts.
        first = {"first_time": 1e-4 * Ts} if integrator == "idas" else {}
        over = casadi.integrator("dae", integrator, parts, 0.0, Ts, {**OPTIONS[integrator], **first, **whole})
    except RuntimeError as error:
        raise DesignError(f"CasADi: {reason(error)}", "options" if options else "casadi") from error
    sizes = {"t": 1, "x": dae["x"].numel(), "u": dae.get("u", none).numel(), "p": dae.get("p", none).numel()}
    symbols = {name: casadi.MX.sym(name, sizes[name]) for name in names}
    p = casadi.vertcat(symbols["p"], symbols["t"]) if "t" in symbols else symbols["p"]
    z = find(z0, casadi.vertcat(symbols["x"], symbols["u"], p))
    end = over(x0=symbols["x"], u=symbols["u"], p=p, z0=z)["xf"]
    return casadi.Function("dae", [*symbols.values()], [end]), names


def plant(
    Ts: float,
    n_steps: int,
    *,
    casadi: UserFunction,
    output: UserFunction = None,
    states: Names | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    parameters: dict[str, float] | None = None,
    discrete: bool = False,
    solver: Solver | None = None,
    algebraic: dict[str, float] | None = None,
    integrator: Literal["idas", "collocation"] = "idas",
    options: dict[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    x0: Any = None,
    angles: Mapping[str, float] | None = None,
    time_unit: str = "s",
) -> ode.OdePlant:
    """CasADi function, or differential-algebraic equation, as a plant.

    A function gives time derivatives, integrated as those of `ode`, or x(k+1).  An equation in the form of
    `casadi.integrator` is a dict with x, ode and, where it has them, t, u, p; with z and alg CasADi integrates it, run
    by run.  `linearise: plant` has exact derivatives.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    casadi : a casadi.Function of (x, u, p) or (t, x, u, p), in any order where its inputs have these names, a
        dict for casadi.integrator, or a function that returns one
    output : a casadi.Function or a function of Python of (x, p) (default: all states)
    states, inputs : names, such as ``{pump: ml/s}`` (default: as many as there are)
    outputs : names; needed with `output`
    parameters : name -> nominal value, in the order of p; `perturb` and `set` may name them
    discrete : whether the function returns x(k+1) in place of time derivatives
    solver : integration of an equation without algebraic variables, as for `ode`
    algebraic : algebraic variable -> value from which its computation starts, in the order of z (default: 0)
    integrator : of CasADi, for an equation with algebraic variables
    options : of this integrator, such as ``{reltol: 1e-10}``
    bounds : name of a state or an input -> lower and upper bound
    x0 : (nx,) initial state, from which the functions are tried
    angles : name of a state or an output that counts modulo a period -> this period
    time_unit : unit of the time in texts
    """
    made, nominal = named_object(casadi), parameters or {}
    has_z = isinstance(made, Mapping) and "z" in made
    if discrete and isinstance(made, Mapping):
        raise DesignError("has no effect: an equation for casadi.integrator has time derivatives", "discrete")
    only_z = {"algebraic": algebraic, "options": options, "integrator": integrator if integrator != "idas" else None}
    for key, given in {"solver": solver}.items() if has_z else only_z.items():
        if given is not None:
            raise DesignError(f"has no effect on an equation {'with' if has_z else 'without'} z", key)
    sampled = sampled_dae(made, Ts, integrator, options or {}, algebraic) if has_z else None
    function, names = sampled or equation(made)
    every = {"x": states, "u": inputs, "p": [*nominal]}
    named = {name: each for name, each in every.items() if each is not None}
    rhs = checked(function, names, named, "casadi", alone=has_z)
    for name, each in named.items() if isinstance(made, Mapping) else ():
        refuse_other_order(entry_names(made.get(name)), each, name, KEYS[name])
    if isinstance(output, library("casadi").Function):
        output = checked(output, input_names(output, {1: ("x",), 2: ("x", "p")}, "output"), named, "output")
    sizes = {name: rhs.function.size1_in(i) for i, name in enumerate(names)}
    try:
        return ode.design(
            Ts, n_steps, ode=rhs, output=output, outputs=outputs, parameters=nominal, bounds=bounds, x0=x0,
            states=sizes["x"] if states is None else states, inputs=sizes.get("u", 0) if inputs is None else inputs,
            solver=solver or Solver(), discrete=discrete or has_z, angles=angles, time_unit=time_unit,
        )  # fmt: skip
    except DesignError as error:
        raise DesignError(str(error), "casadi" if error.parameter == "ode" else error.parameter) from error
