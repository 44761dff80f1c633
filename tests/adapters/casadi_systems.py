"""Equations of CasADi for tests: the two tanks of `plants.tanks`, and small ones with known solutions."""

import pytest

pytest.importorskip("casadi")

import casadi
from plants import tanks

from rmpc_bench.adapters.casadi_plant import plant

TS, STEPS = 5.0, 12
NAMES = {"states": tanks.STATES, "inputs": tanks.INPUTS, "outputs": tanks.OUTPUTS, "parameters": tanks.PARAMETERS}
RANGE = {"x0": [0.2, 0.1], "bounds": {"h1": [1e-3, 2.0], "h2": [1e-3, 2.0], "pump": [0.0, 30.0]}}


def symbols(kind=casadi.SX, nz=2):
    """Return x, z, u and p of the tanks."""
    return kind.sym("x", 2), kind.sym("z", nz), kind.sym("u"), kind.sym("p", 3)


def derivatives(q, u, p):
    """Time derivatives of the levels for given outflows."""
    return casadi.vertcat((p[2] * 1e-6 * u - q[0]) / tanks.S1, (q[0] - q[1]) / tanks.S2)


def outflows(x, p):
    """Outflows by Torricelli's law, in the order of operations of `plants.tanks`."""
    return casadi.vertcat(p[0] * casadi.sqrt(2 * tanks.G * x[0]), p[1] * casadi.sqrt(2 * tanks.G * x[1]))


def function(kind=casadi.SX):
    """Return the tanks as a function of (x, u, p)."""
    x, _, u, p = symbols(kind)
    return casadi.Function("tanks", [x, u, p], [derivatives(outflows(x, p), u, p)])


def level(kind=casadi.SX):
    """Return the output of (x, p)."""
    x, _, _, p = symbols(kind)
    return casadi.Function("level", [x, p], [x[1]])


def dae(kind=casadi.SX):
    """Return the tanks with the outflows as algebraic variables."""
    x, z, u, p = symbols(kind)
    return {"x": x, "z": z, "u": u, "p": p, "ode": derivatives(z, u, p), "alg": z - outflows(x, p)}


def two_tanks(casadi=None, **keys):
    """Return the tanks as a plant of CasADi."""
    given = {"casadi": function() if casadi is None else casadi, "output": level(), **NAMES, **RANGE, **keys}
    return plant(TS, STEPS, **given)
