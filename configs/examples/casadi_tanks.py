"""Plants of casadi.yaml: two tanks in series that are drained by pipes, as equations of CasADi.

Plant   A pump with flow u fills the first tank, whose pipe empties into the second one.  The level h_i [m] is the head
        that its pipe of length L and diameter d_i loses by friction and at its ends, at the velocity v_i [m/s]:
            A h1' = u - q1,   A h2' = q1 - q2,   q_i = (pi / 4) d_i^2 v_i,
            0 = h_i - (f_i L / d_i + 1.5) v_i^2 / (2 g),   f_i = 0.316 (v_i d_i / nu)^(-1/4).
        The last two equations are algebraic, since v_i cannot be written as a function of h_i.
Source  Darcy-Weisbach equation with the friction factor of Blasius for smooth pipes.
"""

import casadi

GRAVITY, LENGTH, VISCOSITY, AREA = 9.81, 2.0, 1e-6, 2.8e-3  # m/s^2, m, m^2/s, m^2


def head(v, d):
    """Return the level [m] that keeps the velocity v [m/s] in a pipe of diameter d [m]."""
    friction = 0.316 * (v * d / VISCOSITY) ** -0.25
    return (friction * LENGTH / d + 1.5) * v**2 / (2 * GRAVITY)


def pipes():
    """Return the equation as casadi.integrator takes it: states x, algebraic variables z, input u, parameters p."""
    h, v, pump, d = casadi.SX.sym("h", 2), casadi.SX.sym("v", 2), casadi.SX.sym("pump"), casadi.SX.sym("d", 2)
    q = casadi.pi / 4 * d**2 * v
    return {
        "x": h,
        "z": v,
        "u": pump,
        "p": d,
        "ode": casadi.vertcat(1e-6 * pump - q[0], q[0] - q[1]) / AREA,
        "alg": h - casadi.vertcat(head(v[0], d[0]), head(v[1], d[1])),
    }


def level(x, p):
    """Return what is measured: the level of the second tank [m]."""
    return [x[1]]
