"""Every registered reference passes the checks of rmpc_bench.conformance."""

import inspect

import pytest

from rmpc_bench import registry
from rmpc_bench.conformance import ReferenceExample, check_component

KINDS = registry.names("references")
PARAMETERS = {
    "constant": [(2, {"value": [1.0, -2.0]})],
    "square": [(2, {"values": (1.0, [0.0, -1.0]), "period": 1.0, "duty": 0.3})],
    "s-shape": [(3, {})],
}
"""Number of outputs and parameters that make a reference of each kind; a new kind gets a line here."""
CASES = [(kind, *case) for kind in KINDS for case in PARAMETERS.get(kind, [])]


def test_every_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.mark.parametrize(("kind", "ny", "parameters"), CASES)
def test_conformance(kind, ny, parameters):
    """Oracle: the rules of a reference."""
    make = registry.get("references", kind)
    sampled = {"Ts": 0.1} if "Ts" in inspect.signature(make).parameters else {}
    reference = make(ny, **sampled, **parameters)
    results = check_component(reference, ReferenceExample(ny))
    assert [str(result) for result in results if result.status == "failed"] == []
