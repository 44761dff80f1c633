"""The laws of a configuration: uncertain quantities, noise, and where everything starts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rmpc_bench import registry
from rmpc_bench.experiment import quantities
from rmpc_bench.experiment.parts import read_part
from rmpc_bench.experiment.schema import shown, validate
from rmpc_bench.experiment.sheet import Law, Sheet
from rmpc_bench.experiment.yaml import Map, locate
from rmpc_bench.simulation import distributions
from rmpc_bench.types import Matrix, NonNegative

_DISTRIBUTIONS: dict[str, type] = {
    "uniform": distributions.Uniform,
    "normal": distributions.Normal,
    "choice": distributions.Choice,
    "fixed": distributions.Fixed,
}


_SAME: Any = dict[str, NonNegative]
_CROSS: Any = float | list[list[float]]

_TAKEN = ("run", "pi", "sqrt", "sin", "cos")


def read_uncertainty(sheet: Sheet) -> None:
    """Read the laws of the named uncertain quantities."""
    for name, value in (sheet.values["uncertainty"] or {}).items():
        path: list[str | int] = ["uncertainty", name]
        if not re.fullmatch(r"[A-Za-z_]\w*", name):
            sheet.note(path, "a name starts with a letter and goes on with letters, digits and _", key=True)
        elif name in _TAKEN:
            sheet.note(path, f"{name!r} has a meaning already; choose another name", key=True)
        law = _distribution(sheet, value, path)
        if law is not None:
            sheet.uncertainty[name] = law


def _distribution(sheet: Sheet, value: Any, path: list[str | int]) -> distributions.Distribution | None:
    if isinstance(value, Map):
        kind = value.get("dist")
        if not isinstance(kind, str) or kind not in _DISTRIBUTIONS:
            sheet.note([*path, "dist"], registry.unknown(str(kind), _DISTRIBUTIONS, "distribution"))
            return None
        own = value.copy()
        del own["dist"]
        law: distributions.Distribution | None = validate(_DISTRIBUTIONS[kind], own, path, sheet.problems)
        return law
    try:
        spread = quantities.spread(value) if isinstance(value, str) else None
    except quantities.QuantityError as error:
        sheet.note(path, str(error))
        return None
    if spread is None:
        choices = ", ".join(_DISTRIBUTIONS)
        sheet.note(path, f"expected a spread such as +-10% or {{dist: ..}} with one of {choices} (got {shown(value)})")
        return None
    return distributions.Uniform(-spread, spread)


def read_noise(sheet: Sheet) -> None:
    """Read the noise that happens, per channel."""
    noise = sheet.section("noise")
    if not isinstance(noise, Map):
        noise = {"process": noise, "measurement": noise}
        paths: dict[str, list[str | int]] = {name: ["noise"] for name in noise}
        sheet.cross = "same" if sheet.section("noise") == "same" else None
    else:
        paths = {name: ["noise", name] for name in noise}
    for name, law in noise.items():
        if name == "cross":
            sheet.cross = law if law == "same" else sheet.checked(_CROSS, paths[name])
            if isinstance(sheet.cross, list) and len({len(row) for row in sheet.cross}) != 1:
                sheet.note(paths[name], "must be a number or a list of rows of the same length")
                sheet.cross = None
        elif name not in ("process", "measurement"):
            sheet.note(paths[name], registry.unknown(name, ("process", "measurement", "cross"), "key"), key=True)
        else:
            read_law = _law(sheet, law, paths[name])
            if read_law is not None:
                sheet.noise[name] = read_law


def _law(sheet: Sheet, law: Any, path: list[str | int]) -> Law | None:
    """Read one noise law; None for `none` and for a law that is not one."""
    if law == "none":
        return None
    if law == "same":
        return Law(None, 1.0)
    known = ("none", "same", *registry.names("noises"))
    if law in registry.names("noises"):
        sheet.note(path, f"{law!r} needs its parameters: {{{law}: {{..}}}} (rmpc-bench describe noises/{law})")
        return None
    if not isinstance(law, Map) or len(law) != 1 or next(iter(law)) not in known[1:]:
        named = next(iter(law)) if isinstance(law, Map) and len(law) == 1 else law
        text = named if isinstance(named, str) else shown(law)
        sheet.note(path, registry.unknown(text, known, "noise law", "rmpc-bench list noises"))
        return None
    kind, value = next(iter(law.items()))
    if kind == "same":
        place = locate(law, [kind])
        scale = validate(_SAME, value, [*path, kind], sheet.problems, mark=place)
        if scale is not None and set(scale) - {"scale"}:
            sheet.note([*path, kind], "the only key is 'scale'")
        return None if scale is None else Law(None, scale.get("scale", 1.0))
    part = read_part("noises", value, [*path, kind], sheet.problems, mark=locate(law, [kind]), kind=kind)
    return None if part is None else Law(part, None)


_Vector = float | list[float]
_INITIAL: Mapping[str, Any] = {"x": _Vector, "x_hat": _Vector, "P": Matrix}


def read_initial(sheet: Sheet) -> None:
    """Read the true initial state and the start of the estimators."""
    initial = sheet.values["initial"] or {}
    sheet.initial = {"x": 0.0, "x_hat": 0.0, "P": "process", "law": None}
    for name, value in initial.items():
        path: list[str | int] = ["initial", name]
        if name not in _INITIAL:
            sheet.note(path, registry.unknown(name, _INITIAL, "key"), key=True)
        elif name == "x" and isinstance(value, Map):
            sheet.initial["law"] = _law(sheet, value, path)
        elif name != "P" or value != "process":
            sheet.initial[name] = sheet.checked(_INITIAL[name], path)
