"""Rules for names: those of a stored layout pass the same checks as those of a configuration.

Files have the names of experiments, papers, metrics and figures, and a terminal shows all names.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable

EXPERIMENT = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,99}$"  # name of an experiment or a paper, which is that of a directory
METRIC = re.compile(r"[A-Za-z_]\w{0,99}")  # name of a metric, which is that of a table
HIDDEN = re.compile("[\0-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Characters that no text may contain, those of `types.texts`, which imports NumPy: controls and directions."""
_IN_METHOD = re.compile(r"[\[\],\n\t]")
_LONGEST, LONGEST_LABEL = 10_000, 500
_DEEPEST = 10
_NESTED = re.compile(r"\\sqrt\s*+\[|\\[A-Za-z]++|\\.|[{}$]", re.DOTALL)
_DOLLAR, _MATHS = re.compile(r"(?<!\\)\$"), re.compile(r"[\\^_{]")
_IN_A_ROW = re.compile(r"(?:\\(?:[A-Za-z]++|.)\s*+){21}")


def wrong_text(text: object) -> str:
    """Say what is wrong with a text that is shown; empty where nothing is."""
    if not isinstance(text, str):
        return "must be text"
    found = HIDDEN.search(text)
    if found is not None:
        return f"contains the control character U+{ord(found[0]):04X}"
    return f"has more than {_LONGEST} characters" if len(text) > _LONGEST else wrong_formula(text)


def wrong_formula(text: str) -> str:
    """Say that a formula between dollar signs is nested deeper than its readers follow; empty where none is."""
    parts = _DOLLAR.split(text)
    if any(len(part) > LONGEST_LABEL and _MATHS.search(part) for part in parts[1:-1:2]):
        return f"has a formula of more than {LONGEST_LABEL} characters"
    depth = 0
    for found in _NESTED.finditer(text if "$" in text else ""):
        part = found[0]
        if part == "$":
            depth = 0
        elif part in ("}", r"\right"):
            depth = max(depth - 1, 0)
        elif part in ("{", r"\left") or part[-1] == "[" and len(part) > 2:
            depth += 1
        if depth > _DEEPEST:
            return f"has a formula that is nested more than {_DEEPEST} levels deep"
    return "has a formula with more than 20 commands in a row" if "$" in text and _IN_A_ROW.search(text) else ""


def wrong_line(text: object) -> str:
    """Say what is wrong with a text that is shown in one line; empty where nothing is."""
    if isinstance(text, str) and not text.isprintable():
        unseen = [each for each in text if unicodedata.category(each) in ("Cc", "Cf", "Cs", "Zl", "Zp")]
        return f"contains the control or invisible character U+{ord(unseen[0]):04X}" if unseen else wrong_text(text)
    return wrong_text(text)


def wrong_method(text: object) -> str:
    """Say what is wrong with the name of a method; empty where nothing is."""
    if isinstance(text, str) and (not text.strip() or _IN_METHOD.search(text)):
        return "the name of a method must not be empty or contain brackets, commas or line breaks"
    return wrong_line(text)


def wrong_label(text: object) -> str:
    """Say what is wrong with the label of a method; empty where nothing is."""
    long = isinstance(text, str) and len(text) > LONGEST_LABEL
    return f"has more than {LONGEST_LABEL} characters" if long else wrong_text(text)


def text_of_form(pattern: str, otherwise: str) -> Callable[[object], str]:
    """Return a function that says `otherwise` of what is no text of a pattern, and nothing of any other."""
    return lambda value: "" if isinstance(value, str) and re.fullmatch(pattern, value) else otherwise


wrong_experiment = text_of_form(EXPERIMENT[1:-1], "must be a name of at most 100 letters, digits, _, - and points")
wrong_metric = text_of_form(METRIC.pattern, "must be a name of up to 100 letters, digits, _")
