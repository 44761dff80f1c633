"""Every registered noise law passes the checks of rmpc_bench.conformance."""

from inspect import signature

import pytest

from rmpc_bench import registry
from rmpc_bench.conformance import NoiseExample, check_component
from rmpc_bench.noise.bursts import RandomBursts
from rmpc_bench.numerics.sample_times import Burst

KINDS = registry.names("noises")
FIXED, RANDOM = [Burst(0.2, 0.5, 3.0)], RandomBursts([(0.1, 0.5)], (0.1, 0.2), (2.0, 3.0))
PARAMETERS = {
    "coloured": [
        {"std": [1.0, 0.5], "time": 0.4, "mean": [1.0, -1.0]},
        {"cov": [[2.0, 0.5], [0.5, 1.0]], "pole": -0.6, "scale": 0.1},
        {"std": 1.0, "pole": 0.9, "bursts": FIXED},
    ],
    "drift": [{"std": 0.1, "start": [1.0, -1.0]}, {"cov": [[2.0, 0.5], [0.5, 1.0]]}, {"std": 1.0, "bursts": RANDOM}],
    "half-normal": [{"std": [0.5, 2.0], "center": [1.0, -1.0]}, {"std": 1.0, "scale": 0.1, "bursts": RANDOM}],
    "missing": [
        {"probability": 0.2},
        {"probability": 0.3, "gap": 4.0},
        {"probability": 0.5, "outputs": "each"},
        {"probability": 0.5, "outputs": "each", "gap": 3.0},
        {"probability": 1.0},
        {"every": 3, "first": 1, "only": [1]},
    ],
    "delayed": [{"samples": 2}, {"samples": [0, 3], "only": [0]}, {"samples": [1, 4], "per": "run"}],
    "outliers": [
        {"std": 0.5, "probability": 0.1, "factor": 10.0, "mean": [1.0, -1.0]},
        {"cov": [[2.0, 0.5], [0.5, 1.0]], "probability": 0.05, "factor": 3.0, "scale": 0.1},
        {"std": 1.0, "probability": 0.1, "factor": 10.0, "bursts": RANDOM},
    ],
    "quantised": [{"step": 0.25}, {"step": [0.1, 2.0], "offset": [0.05, 1.0]}],
    "student-t": [
        {"dof": 1.0, "scale": 1.0},
        {"dof": 2.0, "scale": 1.0},
        {"dof": 9.0, "scale": [1.0, 2.0], "mean": 1.0},
        {"dof": 9.0, "scale_matrix": [[2.0, 0.5], [0.5, 1.0]], "joint": True},
        {"dof": 3.0, "scale": 1.0, "bursts": RANDOM},
    ],
    "gaussian": [
        {"std": 0.5, "mean": [1.0, -1.0]},
        {"cov": [[2.0, 0.5], [0.5, 1.0]], "scale": 0.1},
        {"std": 0.5, "bursts": FIXED},
    ],
    "uniform": [
        {"radius": [1.0, 2.0], "center": 0.3, "mix": [[1.0, 0.5], [0.0, 1.0]]},
        {"radius": 1.0, "bursts": FIXED},
        {"radius": 1.0, "bursts": RANDOM},
    ],
    "corners": [{"radius": [1.0, 2.0], "center": 0.3}, {"radius": 1.0, "bursts": RANDOM}],
    "ellipsoid": [
        {"shape": [[2.0, 0.5], [0.5, 1.0]]},
        {"shape": [2.0, 1.0], "law": "skewed-cube", "center": 1.0, "scale": 0.5},
        {"shape": [2.0, 1.0], "law": "skewed-cube", "outside": "project", "root": "upper"},
        {"shape": [2.0, 1.0], "law": "skewed-cube", "outside": "reject", "root": "lower"},
        {"shape": [2.0, 1.0], "law": "skewed-cube", "outside": "reject", "bursts": RANDOM},
    ],
}
"""Parameters that make a law of each kind; a new kind gets a line here."""
CASES = [(kind, parameters) for kind in KINDS for parameters in PARAMETERS.get(kind, [])]


def test_every_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.mark.parametrize(("kind", "parameters"), CASES)
def test_conformance(kind, parameters):
    """Oracle: the rules of a noise law, moments within five standard errors."""
    design = registry.get("noises", kind)
    sampled = {"Ts": 0.1} if "Ts" in signature(design).parameters else {}
    law = design(2, **sampled, **parameters)
    assert [str(result) for result in check_component(law, NoiseExample(2)) if result.status == "failed"] == []
