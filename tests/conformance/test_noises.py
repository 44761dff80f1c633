"""Every registered noise law passes the checks of rmpc_bench.conformance."""

import pytest

from rmpc_bench import registry
from rmpc_bench.conformance import NoiseExample, check_component
from rmpc_bench.noise.bursts import RandomBursts
from rmpc_bench.numerics.burst_times import Burst

KINDS = registry.names("noises")
PARAMETERS = {
    "gaussian": [{"std": 0.5, "mean": [1.0, -1.0]}, {"cov": [[2.0, 0.5], [0.5, 1.0]], "scale": 0.1}],
    "uniform": [
        {"radius": [1.0, 2.0], "center": 0.3, "mix": [[1.0, 0.5], [0.0, 1.0]]},
        {"radius": 1.0, "bursts": [Burst(0.2, 0.5, 3.0)]},
        {"radius": 1.0, "bursts": RandomBursts([(0.1, 0.5)], (0.1, 0.2), (2.0, 3.0))},
    ],
    "corners": [{"radius": [1.0, 2.0], "center": 0.3}],
    "ellipsoid": [
        {"shape": [[2.0, 0.5], [0.5, 1.0]]},
        {"shape": [2.0, 1.0], "law": "skewed-cube", "center": 1.0, "scale": 0.5},
        {"shape": [2.0, 1.0], "law": "skewed-cube", "outside": "project", "root": "upper"},
        {"shape": [2.0, 1.0], "law": "skewed-cube", "outside": "reject", "root": "lower"},
    ],
}
"""Parameters that make a law of each kind; a new kind gets a line here."""
CASES = [(kind, parameters) for kind in KINDS for parameters in PARAMETERS.get(kind, [])]


def test_every_registered_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.mark.parametrize(("kind", "parameters"), CASES)
def test_conformance(kind, parameters):
    """Oracle: the rules of a noise law, moments within five standard errors."""
    sampled = {"Ts": 0.1} if kind == "uniform" else {}
    law = registry.get("noises", kind)(2, **sampled, **parameters)
    assert [str(result) for result in check_component(law, NoiseExample(2)) if result.status == "failed"] == []
