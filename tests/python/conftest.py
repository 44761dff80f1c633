"""What the tests of this folder register is gone after each of them."""

import pytest

from rmpc_bench import registry


@pytest.fixture(autouse=True)
def _as_registered(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", {group: dict(known) for group, known in registry._REGISTERED.items()})
