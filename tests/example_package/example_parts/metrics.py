"""A metric: a frozen dataclass whose fields are its keys."""

from dataclasses import dataclass

from rmpc_bench.types import Metric


@dataclass(frozen=True, kw_only=True)
class Overshoot(Metric):
    """Largest y - r over the run; lower is better."""

    name: str = "overshoot"

    def evaluate(self, record):
        """Return one value per run."""
        return (record.y - record.r).max(axis=(1, 2))
