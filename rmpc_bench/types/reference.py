"""Base class of references."""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.types.basics import Array


class Reference:
    """A signal that the output should follow, known ahead of time.  A subclass gives the method `sample`."""

    def sample(self, n_samples: int) -> Float[Array, "samples ny"]:
        """Values at k = 0..n_samples - 1."""
        raise NotImplementedError("sample")
