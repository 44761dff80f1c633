"""Differential-algebraic equations, integrated over a sample by CasADi."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rmpc_bench.adapters.casadi_block import reason
from rmpc_bench.adapters.casadi_equation import ARGUMENTS
from rmpc_bench.extras import library
from rmpc_bench.types import DesignError

OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "idas": {"reltol": 1e-8, "abstol": 1e-10},
    "collocation": {"number_of_finite_elements": 20},
}
"""Integrator -> its options where a configuration gives none."""


def sampled_dae(
    dae: Mapping[str, Any], Ts: float, integrator: str, options: Mapping[str, float], guess: Mapping[str, float] | None
) -> tuple[Any, tuple[str, ...]]:
    """Return x(k+1) of (x, u, p) or (t, x, u, p) as `casadi.Function`, and the names of its inputs.

    At the begin of every sample Newton's method computes the algebraic variables from the same guess, so that x(k+1)
    depends on nothing else.

    Parameters
    ----------
    dae : parts as `casadi.integrator` takes them
    Ts : sampling time [s]
    integrator : a key of `OPTIONS`
    options : of CasADi, in addition to those of `OPTIONS`
    guess : of the algebraic variables, in their order; None for 0

    Raises
    ------
    DesignError
        If CasADi refuses the equation or the options, or the guess has another size.
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
    whole = {name: int(value) if float(value).is_integer() else value for name, value in options.items()}
    try:
        begin = parts["alg"] if "t" not in dae else casadi.substitute(parts["alg"], dae["t"], 0)
        given = casadi.vertcat(dae["x"], dae.get("u", none), parts["p"])
        find = casadi.rootfinder("algebraic", "newton", {"x": dae["z"], "p": given, "g": begin})
        over = casadi.integrator("dae", integrator, parts, 0.0, Ts, {**OPTIONS[integrator], **whole})
    except RuntimeError as error:
        raise DesignError(f"CasADi: {reason(error)}", "options" if options else "casadi") from error
    sizes = {"t": 1, "x": dae["x"].numel(), "u": dae.get("u", none).numel(), "p": dae.get("p", none).numel()}
    symbols = {name: casadi.MX.sym(name, sizes[name]) for name in names}
    p = casadi.vertcat(symbols["p"], symbols["t"]) if "t" in symbols else symbols["p"]
    z = find(z0, casadi.vertcat(symbols["x"], symbols["u"], p))
    end = over(x0=symbols["x"], u=symbols["u"], p=p, z0=z)["xf"]
    return casadi.Function("dae", [*symbols.values()], [end]), names
