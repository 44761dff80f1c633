"""What design models say about themselves, such as an operating point; `check` and `describe` print it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rmpc_bench.config.draft import DraftConfig, ModelFacts
from rmpc_bench.config_file.component import Component


def model_facts(draft: DraftConfig, model: Callable[[Component | None], Any]) -> tuple[ModelFacts, ...]:
    """Return the properties of every design model that has any, for a draft without errors."""
    found: list[ModelFacts] = []
    for name, components in draft.methods.items():
        shared = components.model is draft.model
        where = "model" if shared else f"methods.{name}.model"
        made = model(components.model)
        if made is not None and where not in [each.where for each in found]:
            found.append(ModelFacts(where, tuple(made.facts()), tuple(made.remarks)))
    return tuple(each for each in found if each.facts or each.remarks)
