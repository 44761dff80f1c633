"""Linear model of a plant around an operating point.

Model   Around (x_op, u_op) with f = rhs(x_op, u_op): x' = f + A (x - x_op) + B (u - u_op), y = y_op + C (x - x_op).
        With a zero-order hold of the input one exponential of [[A, B, f], [0, 0, 0]] gives the sampled A, B and drift,
        also where A is singular.  In physical coordinates
            x(k+1) = A x(k) + B u(k) + f0 + w(k),  f0 = x_op + drift - A x_op - B u_op,
            y(k)   = C x(k) + D u(k) + d0 + v(k),  d0 = y_op - C x_op - D u_op.
        The drift is exactly 0 in a steady state.  A, B, C are those of the nominal parameters and of t = 0.
Method  Jacobians by central differences with one Richardson step (numerics/jacobian.py), or by the user's function.
Limit   A linear plant is its own linear model.
Fails   Design error: no steady state, a kink at the operating point, or a noise covariance that is not valid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.dynamics import Dynamics, OdeDynamics, OfPlant, Tangent, dynamics_of, sampled, steps_of
from rmpc_bench.models.flow import PlantFlow
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.operating_point import At, Found, find_point, text
from rmpc_bench.models.state_dependent import Affine, Pair, StateDependentModel
from rmpc_bench.numerics.jacobian import DIFFERS, sizes_of_coordinates
from rmpc_bench.numerics.stability import controllable_states, observable_states
from rmpc_bench.types import Array, DesignError, Model, OperatingPoint, Plant, UserFunction

EQUATION = r"""\dot x = f(x_{op}, u_{op}) + A_c (x - x_{op}) + B_c (u - u_{op}), \quad
x_{k+1} = A x_k + B u_k + f_0 + w_k, \quad y_k = C x_k + d_0 + v_k"""


# Model of a nonlinear plant that is linearised again at every estimate.
#
# Model   x(k+1) = F(x(k), u(k)) + w(k), y(k) = h(x(k)) + v(k), F the flow of the nominal plant over a sample.
#         `around(k, x, u)` linearises at a state and an input of every run, as `design` does at an operating point: one
#         exponential of [[A, B, f], [0, 0, 0]] per run.  An equation that depends on the time is linearised at the
#         middle of the sample.
# Cost    About 0.2 ms per run and linearisation for two states: functions of the user are called for every run alone.


@dataclass(frozen=True, eq=False)
class TrajectoryModel(OfPlant, StateDependentModel):
    """A model that is linearised at the latest estimate."""

    has_offsets = True

    @property
    def flow(self) -> PlantFlow:
        """The model without linearisation, as maps of many states at once."""
        return PlantFlow(self.dynamics, self.Ts, self.substeps, self.Q_w, self.R_v)

    def at_state(self, x: Float[Array, "runs nx"]) -> Pair:
        """Linearise at a state of every run, at the input nearest to 0."""
        low, high = self.dynamics.signals.limits(self.dynamics.signals.inputs)
        return Pair(*self.around(0, x, np.tile(np.clip(0.0, low, high), (len(x), 1)))[:2])

    def around(self, k: int, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Affine:
        """Linearise at a state and an input of every run; NaN where the plant is not defined."""
        t = (k + (0.5 if self.dynamics.continuous else 0.0)) * self.Ts
        (runs, n), m, q = x.shape, u.shape[1], self.ny
        found = Affine(*(np.full((runs, *shape), np.nan) for shape in ((n, n), (n, m), (n,), (q, n), (q,))))
        for i, (at, applied) in enumerate(zip(x, u, strict=True)):
            tangent, y = self.dynamics.slopes(at, applied, t), self.dynamics.output(at, applied)
            rest = self.dynamics.rest(at, applied, t)
            if all(np.isfinite(part).all() for part in (*tangent, y, rest)):
                A, B, drift = sampled(self.dynamics, tangent, rest, self.Ts)
                found.A[i], found.B[i], found.f[i] = A, B, at + drift - A @ at - B @ applied
                found.C[i], found.d[i] = tangent.C, y - tangent.C @ at
        return found

    def advance(self, k: int, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Float[Array, "runs nx"]:
        """Integrate every run over a sample; NaN where the plant is not defined."""
        return self.flow.advance(k, x, u)

    def measure(self, x: Float[Array, "runs nx"]) -> Float[Array, "runs ny"]:
        """Return the outputs of every run."""
        return np.array([self.dynamics.output(each, np.zeros(0)) for each in x])


def relinearised(dynamics: Dynamics, Ts: float, noise: DesignNoise, substeps: int | None = None) -> TrajectoryModel:
    """Make a model that is linearised at every estimate."""
    if dynamics.fed:
        raise DesignError("trajectory needs an output that does not depend on u; choose a point", "at")
    Q_w, R_v = dynamics.noise(noise, Ts)
    return TrajectoryModel(dynamics, Ts, substeps or steps_of(dynamics), Q_w, R_v)


class LinearisedModel(LinearModel):
    """A linear model in physical coordinates with its operating point; create it with `linearised`.

    `drift` is x(k+1) - x(k) at the point, 0 in a steady state; `known` is what `facts` returns, and `y_period` is None
    where no output is an angle.
    """

    def __init__(
        self,
        A: Float[Array, "nx nx"],
        B: Float[Array, "nx nu"],
        C: Float[Array, "ny nx"],
        Q_w: Float[Array, "nx nx"],
        R_v: Float[Array, "ny ny"],
        *,
        point: OperatingPoint,
        drift: Float[Array, " nx"] | None = None,
        known: tuple[tuple[str, str], ...] = (),
        remarks: tuple[str, ...] = (),
        y_period: Float[Array, " ny"] | None = None,
        D: Float[Array, "ny nu"] | None = None,
    ) -> None:
        drift = np.zeros(len(point.x)) if drift is None else drift
        f0 = point.x + drift - A @ point.x - B @ point.u
        super().__init__(A, B, C, Q_w, R_v, f0=f0, d0=point.y - C @ point.x - (0.0 if D is None else D @ point.u), D=D)
        vars(self).update(operating_point=point, drift=drift, _known=known, remarks=remarks, y_period=y_period)

    operating_point: OperatingPoint
    drift: Float[Array, " nx"]
    remarks: tuple[str, ...]

    @property
    def deviation(self) -> LinearModel:
        """The model of x - x_op, u - u_op, y - y_op; its constant part f0 is the drift."""
        return LinearModel(self.A, self.B, self.C, self.Q_w, self.R_v, f0=self.drift, D=self.D)

    def facts(self) -> list[tuple[str, str]]:
        """Operating point, eigenvalues and ranks."""
        return list(self._known)

    _known: tuple[tuple[str, str], ...]


def linearised(dynamics: Dynamics, Ts: float, at: At, noise: DesignNoise, jacobian: Any = None) -> LinearisedModel:
    """Linearise a plant around an operating point and sample it."""
    found = find_point(dynamics, at)
    tangent, remarks = _tangent(dynamics, found.point, jacobian)
    Q_w, R_v = dynamics.noise(noise, Ts, tangent.A)
    A, B, drift = sampled(dynamics, tangent, found.rest, Ts)
    known = tuple(_facts(dynamics, found, tangent, A))
    if isinstance(dynamics, OdeDynamics) and dynamics.ode.timed:
        remarks += ("rhs depends on the time: the linear model is that of t = 0",)
    facts: dict[str, Any] = {"known": known, "remarks": remarks, "y_period": dynamics.y_period}
    facts |= {"D": tangent.D} if dynamics.fed else {}
    return LinearisedModel(A, B, tangent.C, Q_w, R_v, point=found.point, drift=drift, **facts)


def _tangent(dynamics: Dynamics, point: OperatingPoint, jacobian: Any) -> tuple[Tangent, tuple[str, ...]]:
    """Return the matrices at a point and remarks on them."""
    tangent, kinks = dynamics.tangent(point.x, point.u)
    if jacobian is not None:
        return _given(dynamics, point, jacobian, tangent)
    if not all(np.isfinite(matrix).all() for matrix in tangent):
        raise DesignError("the plant has no derivative at the operating point; choose another one", "at")
    if kinks:
        raise DesignError(
            f"has a kink at the operating point ({', '.join(kinks)}): the derivatives from the left and from the right "
            "differ; choose another point, or give `jacobian`",
            "at",
        )
    return tangent, ()


def _given(
    dynamics: Dynamics, point: OperatingPoint, jacobian: Any, differences: Tangent
) -> tuple[Tangent, tuple[str, ...]]:
    """Return the user's matrices, and where they differ from differences of the functions."""
    if not isinstance(dynamics, OdeDynamics):
        raise DesignError("has no effect on a linear plant", "jacobian")
    try:
        matrices = [np.array(each, dtype=float) for each in jacobian(point.x.copy(), point.u.copy(), dynamics.ode.p)]
    # The function is the user's: it may raise anything.
    except Exception as error:
        raise DesignError(f"raises {type(error).__name__} at the operating point: {error}", "jacobian") from error
    if len(matrices) not in (2, 3):
        raise DesignError(f"must return (A, B) or (A, B, C) (got {len(matrices)} entries)", "jacobian")
    remarks = []
    for name, matrix, numeric in zip("ABC", matrices, differences, strict=False):
        if matrix.shape != numeric.shape:
            raise DesignError(f"{name} has shape {matrix.shape}; {numeric.shape} fits", "jacobian")
        if not np.isfinite(matrix).all():
            raise DesignError(f"{name} is not finite at the operating point", "jacobian")
        largest = float(np.abs(numeric).max(initial=0.0))
        off = float(np.nanmax(np.abs(matrix - numeric), initial=0.0))
        if not off <= DIFFERS * largest:
            remarks.append(f"{name} of `jacobian` differs from differences of the functions by {off:.3g}")
    C = matrices[2] if len(matrices) == 3 else differences.C
    return Tangent(matrices[0], matrices[1], C, differences.D), tuple(remarks)


def _facts(dynamics: Dynamics, found: Found, tangent: Tangent, A: Float[Array, "nx nx"]) -> list[tuple[str, str]]:
    signals, point, nx = dynamics.signals, found.point, len(found.point.x)
    size = sizes_of_coordinates(point.x)
    # Similar sizes of the states, so that the ranks do not depend on their units.
    scaled, C, B = tangent.A / size[:, None] * size, tangent.C * size, tangent.B / size[:, None]
    observable, controllable = observable_states(scaled, C), controllable_states(scaled, B)
    what = "x'" if dynamics.continuous else "x(k+1) - x(k)"
    rest = f"no steady state, the largest {what} is {found.residual:.3g}"
    if found.residual == 0.0:
        rest = f"steady state, {what} = 0"
    if found.iterations is not None:
        rest = f"steady state with residual {found.residual:.2g}, {found.iterations} Newton steps"
    named = zip((signals.states, signals.inputs, signals.outputs), point, strict=True)
    where = "; ".join(text(signals, names, values) for names, values in named if names)
    rows = [("operating point", where), ("", rest)]
    if isinstance(dynamics, OdeDynamics) and dynamics.continuous:
        rows.append(("eigenvalues", f"{_complex_text(np.linalg.eigvals(tangent.A))} 1/{dynamics.ode.time_unit}"))
    return [
        *rows,
        ("sampled poles", _complex_text(np.linalg.eigvals(A))),
        ("observable", f"{observable} of {nx} states"),
        ("controllable", f"{controllable} of {nx} states"),
    ]


def _complex_text(values: Float[Array, " n"] | Any) -> str:
    """Write eigenvalues, the largest ones first."""
    ordered = sorted(np.asarray(values, dtype=complex), key=lambda z: (-abs(z), -z.imag))
    return ", ".join(f"{z.real:.5g}" if z.imag == 0.0 else f"{z.real:.5g}{z.imag:+.5g}j" for z in ordered)


def design(
    Ts: float,
    plant: Plant,
    *,
    linearise: Literal["plant"] = "plant",
    at: At | Literal["trajectory"],
    noise: DesignNoise,
    jacobian: UserFunction = None,
) -> Model:
    """Linear model of the nominal plant around an operating point.

    The input before k = 0 is u_op, and weights of states and inputs weigh deviations from the point.  Limits,
    references, measurements, estimates and `initial.x_hat` stay in physical units.

    Parameters
    ----------
    Ts : sampling time [s]
    plant : plant of the experiment, with its nominal parameters
    linearise : `plant`
    at : operating point: `{u: .., guess: ..}` is the steady state of an input, `{y: .., guess: ..}` that of an output,
        `{x: .., u: ..}` any point; `trajectory` linearises again at every estimate (for `kalman` and `gpc`)
    noise : covariances `process` and `measurement` of the noise of the sampled model
    jacobian : function (x, u, p) that returns (A, B) or (A, B, C), the derivatives of rhs and output (default:
        differences)

    Raises
    ------
    DesignError
        If there is no such point, the plant has a kink there, or the noise is no covariance.
    """
    dynamics = dynamics_of(plant)
    if at == "trajectory":
        if jacobian is not None:
            raise DesignError("has no effect beside `at: trajectory`", "jacobian")
        return relinearised(dynamics, Ts, noise)
    return linearised(dynamics, Ts, at, noise, jacobian)
