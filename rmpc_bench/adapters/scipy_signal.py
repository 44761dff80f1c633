"""Linear systems of scipy.signal as plants and as design models."""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.models.library_systems import Realisation, design_model, parametric_system
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.plants.linear import linear_plant
from rmpc_bench.types import DesignError, Plant, UserFunction

EQUATION = r"""\dot x = A x + B u_k: \quad
x_{k+1} = e^{A T_s} x_k + \int_0^{T_s} e^{A s} ds B u_k + w_k, \quad y_k = C x_k + v_k"""


def plant(
    Ts: float, n_steps: int, *, scipy: UserFunction, parameters: dict[str, float] | None = None, bounds: Any = None
) -> Plant:
    """Linear system of scipy.signal.

    A continuous system (`lti`) is sampled exactly; the `dt` of a discrete one (`dlti`) must be the sampling time.  A
    transfer function has the states x.0, x.1 .. of `to_ss`.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    scipy : a system, or a function that returns one; its arguments are parameters, which `perturb` and `set` may
        name
    parameters : argument of the function -> nominal value (default: that of the function)
    bounds : name of a state or an input -> lower and upper bound

    Raises
    ------
    DesignError
        If the output depends on the input of the same sample, or the sampling times differ.
    """
    return linear_plant(parametric_system(scipy, _realisation, parameters or {}, "scipy"), Ts, n_steps, bounds)


def model(
    Ts: float, *, scipy: UserFunction, parameters: dict[str, float] | None = None, noise: DesignNoise
) -> LinearModel:
    """Linear design model that is a system of scipy.signal.

    Parameters
    ----------
    Ts : sampling time [s]; a continuous system is sampled with the input held
    scipy : a system, or a function of parameters that returns one
    parameters : argument of the function -> value (default: that of the function)
    noise : covariances `process` and `measurement` of the noise of the sampled model

    Raises
    ------
    DesignError
        If the output depends on the input of the same sample, or the sampling times differ.
    """
    return design_model(parametric_system(scipy, _realisation, parameters or {}, "scipy"), Ts, noise)


def _realisation(system: Any) -> Realisation:
    # Imported on use, because it takes a second.
    from scipy.signal import dlti, lti

    if not isinstance(system, lti | dlti):
        what = "must be an lti or a dlti of scipy.signal, or a function that returns one"
        raise DesignError(f"{what} (got {type(system).__name__})", "scipy")
    form = system.to_ss()
    own = 0.0 if isinstance(system, lti) else (None if system.dt is True else float(system.dt))
    A, B, C, D = (np.asarray(each, dtype=float) for each in (form.A, form.B, form.C, form.D))
    return Realisation(A, B, C, D, own, len(A), B.shape[1], len(C))
