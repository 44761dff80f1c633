"""do-mpc: a discrete do-mpc model of a design model."""

from __future__ import annotations

from typing import Any

from rmpc_bench.adapters.do_mpc_setup import do_mpc_library, quiet
from rmpc_bench.extras import library
from rmpc_bench.models.disturbed import DisturbedNonlinear
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.types import DesignError


@quiet
def do_mpc_model(model: Any) -> Any:
    """Return a discrete do-mpc model of a design model, in physical units.

    Parameters
    ----------
    model : a linear model that is the same at all k, or ``{nonlinear: plant}``

    Returns
    -------
    A model with the state ``x``, the input ``u``, the time-varying parameter ``r`` (reference), additive process noise
    and the measurements ``y`` (with noise) and ``u`` (without).  ``model.aux["y"]`` is the output.

    Raises
    ------
    DesignError
        If the model depends on the time, or on functions that CasADi does not know.
    """
    made = do_mpc_library().model.Model("discrete", "SX")
    x, u = (made.set_variable(f"_{name}", name, shape=(n, 1)) for name, n in (("x", model.nx), ("u", model.nu)))
    made.set_variable("_tvp", "r", shape=(model.ny, 1))
    step, output = functions_of(model)
    made.set_expression("y", output(x))
    made.set_rhs("x", step(x, u), process_noise=True)
    made.set_meas("y", output(x), meas_noise=True)
    made.set_meas("u", u, meas_noise=False)
    made.setup()
    return made


def functions_of(model: Any) -> tuple[Any, Any]:
    """Return x(k+1) of (x, u) and y of x as functions of CasADi expressions."""
    if isinstance(model, NonlinearModel):
        from rmpc_bench.adapters.casadi import output_function, step_function

        step = step_function(model)
        if step.n_in() > 2:
            raise DesignError("a do-mpc model is made of an equation that does not depend on the time", "kind")
        return step, output_function(model)
    if isinstance(model, DisturbedNonlinear):
        return _disturbed(model)
    if model.varies:
        raise DesignError("a do-mpc model is made of a model that is the same at all k", "kind")
    casadi = library("casadi")
    A, B, C = (casadi.DM(each) for each in (model.A, model.B, model.C))
    return lambda x, u: A @ x + B @ u + model.f0, lambda x: C @ x + model.d0


def _disturbed(model: DisturbedNonlinear) -> tuple[Any, Any]:
    """Return the functions of a nonlinear model with the disturbances as its last states."""
    casadi, nx = library("casadi"), model.undisturbed.nx
    step, output = functions_of(model.undisturbed)
    S, N, C_d = (casadi.DM(each) for each in (model.entry.S, model.entry.N, model.entry.C_d))

    def moved(z: Any, u: Any) -> Any:
        x, d = z[:nx], z[nx:]
        return casadi.vertcat(step(x, u + S @ d) + N @ d, d)

    return moved, lambda z: output(z[:nx]) + C_d @ z[nx:]
