"""Covariances of the noises of a design model: of one that is made from a plant, and factors on given ones."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance
from rmpc_bench.types import Array, DesignError, Matrix, NonNegative


@dataclass(frozen=True)
class DesignNoise:
    """Noise of a design model, white and added to the sampled state and to the output.

    Parameters
    ----------
    process : covariance Q_w of the noise of x(k+1): a number (times the identity), a diagonal or a matrix
    measurement : covariance R_v of the noise of y(k): a number (times the identity), a diagonal or a matrix
    """

    process: Matrix
    measurement: Matrix

    def covariances(self, nx: int, ny: int) -> tuple[Float[Array, "nx nx"], Float[Array, "ny ny"]]:
        """Return Q_w and R_v.

        Raises
        ------
        DesignError
            If a size does not fit, or a matrix is not positive semidefinite.
        """
        found = []
        for name, n in (("process", nx), ("measurement", ny)):
            try:
                found.append(as_covariance(getattr(self, name), n))
            except ValueError as error:
                raise DesignError(str(error), f"noise.{name}") from None
        return found[0], found[1]


@dataclass(frozen=True)
class NoiseScale:
    """Factors on the standard deviations of the noises of a design model; the noise of the plant does not change.

    Parameters
    ----------
    process : factor on the standard deviation of the process noise; its covariance is multiplied by the square
    measurement : factor on the standard deviation of the measurement noise
    """

    process: NonNegative = 1.0
    measurement: NonNegative = 1.0


SAME_SCALE = NoiseScale()
