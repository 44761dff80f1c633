"""The noise law `same`: that of the design model, as it is or with a known departure from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt
from jaxtyping import Float

from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.noise.heavy_tailed import outliers, student_t
from rmpc_bench.noise.parameters import Share
from rmpc_bench.types import Array, Noise, NonNegative


@dataclass(frozen=True)
class SameOutliers:
    """Outliers of the noise.

    Parameters
    ----------
    probability : probability that a sample is an outlier, in all coordinates together
    factor : factor on the deviation of an outlier from the mean
    """

    probability: Share
    factor: NonNegative


@dataclass(frozen=True)
class SameLaw:
    """The noise of the design model, with departures from it that every system has in the same measure.

    Parameters
    ----------
    scale : factor on the standard deviation
    bias : shift of the mean, in standard deviations of every coordinate
    outliers : a sample is an outlier with some probability; the covariance of the others is that of the model
    dof : degrees of freedom of Student's t with the covariance of the model; normal unless given
    """

    scale: NonNegative = 1.0
    bias: float = 0.0
    outliers: SameOutliers | None = None
    dof: Annotated[float, Gt(2)] | None = None

    def __post_init__(self) -> None:
        """Refuse two heavy-tailed laws at once."""
        if self.outliers is not None and self.dof is not None:
            raise ValueError("give outliers or dof")

    @property
    def data(self) -> dict[str, Any]:
        """Its keys; what has no effect is left out, so that earlier trials stay valid, but for the scale."""
        given = {"bias": self.bias or None, "outliers": self.outliers and asdict(self.outliers), "dof": self.dof}
        return {"scale": self.scale, **{key: value for key, value in given.items() if value is not None}}

    def noise(self, mean: Float[Array, " n"], cov: Float[Array, "n n"]) -> Noise:
        """Build the stochastic part from mean (n,) and cov (n, n) of the noise of the design model.

        The normal numbers of a run are the same with every key.
        """
        n, shifted = len(mean), mean + self.bias * self.scale * np.sqrt(np.diag(cov))
        centre = shifted.tolist()
        if self.outliers is not None:
            law = self.outliers
            made: Noise = outliers(
                n, probability=law.probability, factor=law.factor, cov=cov, mean=centre, scale=self.scale
            )
        elif self.dof is not None:
            matrix = (self.dof - 2) / self.dof * self.scale**2 * cov
            made = student_t(n, dof=self.dof, scale_matrix=matrix, mean=centre)
        else:
            made = gaussian(n, mean=centre, cov=cov, scale=self.scale)
        return made
