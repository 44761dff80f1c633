"""Metrics that a user derives from the base class: they need no decorator and no name."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any, get_type_hints

from rmpc_bench.components.words import snake_case


def metric_design(cls: type) -> Callable[..., Any]:
    """Return the design function of a class derived from `Metric`.

    Annotated attributes are its keys, also without ``@dataclass``.  The column has the name of the class or its `name`.
    """
    if cls.__dict__.get("__annotations__") and "__dataclass_fields__" not in vars(cls) and "__init__" not in vars(cls):
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)
    signature = inspect.signature(cls)
    name = signature.parameters.get("name")
    if name is None or name.default is not inspect.Parameter.empty:
        return cls
    # Resolved here, since inherited annotations belong to the module of their own class.
    hints = get_type_hints(cls, include_extras=True)
    changed = [
        each.replace(
            annotation=hints.get(key, each.annotation),
            default=snake_case(cls.__name__) if key == "name" else each.default,
        )
        for key, each in signature.parameters.items()
    ]
    ordered = inspect.Signature([each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in changed])

    def design(**keys: Any) -> Any:
        bound = ordered.bind(**keys)
        bound.apply_defaults()
        return cls(**bound.arguments)

    design.__signature__ = ordered  # type: ignore[attr-defined]
    design.__doc__ = inspect.getdoc(cls)
    design.__name__, design.__qualname__, design.__module__ = cls.__name__, cls.__qualname__, cls.__module__
    return design
