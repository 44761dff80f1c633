"""From the signature of a design to checked keys."""

import inspect
import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from annotated_types import Ge, Gt
from small_experiment import write

from rmpc_bench import registry
from rmpc_bench.config.load import load_config
from rmpc_bench.config_file.keys import PROVIDED, keys_of, model_of, shown, validate
from rmpc_bench.config_file.tree import Problems
from rmpc_bench.config_file.yaml import parse
from rmpc_bench.types import ConfigError, Count, Matrix, NonNegative, Positive

PARTS = [(group, name) for group in registry.BUILT_IN for name in registry.names(group)]


@dataclass(frozen=True)
class Band:
    """A nested mapping of keys."""

    low: float
    high: float = 1.0

    def __post_init__(self):
        """Refuse a crossed band."""
        if self.low > self.high:
            raise ValueError("low must not exceed high")


@dataclass(frozen=True)
class Still:
    """One kind of two."""

    kind: Literal["still"] = "still"


@dataclass(frozen=True)
class Moving:
    """The other one, with keys."""

    kind: Literal["moving"] = "moving"
    speed: Positive = 1.0
    band: tuple[NonNegative, NonNegative] = (0.0, 1.0)


def check(annotation, yaml):
    """Return the validated value of a YAML text, or the list of (line:column, path, message)."""
    problems = Problems()
    tree = parse(f"a: {yaml}", "f.yaml")
    value = problems.tried(validate, dict[str, annotation], tree, [])
    found = [(f"{problem.line}:{problem.column}", problem.path, problem.message) for problem in problems]
    return found if found else value["a"]


@pytest.mark.parametrize(
    ("annotation", "yaml", "value"),
    [
        (float, "2*pi", 2 * math.pi),
        (float, "5%", 0.05),
        (Positive, "sqrt(4)", 2.0),
        (Annotated[int, Ge(0)], "2*3", 6),
        (Count, "1e3", 1000),
        (list[float], "[1, 2*pi]", [1.0, 2 * math.pi]),
        (tuple[float, float], "[-1, 5%]", (-1.0, 0.05)),
        (float | list[float], "pi", math.pi),
        (float | list[float], "[1, 2]", [1.0, 2.0]),
        (Matrix, "0.5*2", 1.0),
        (Matrix, "[1, 50%]", [1.0, 0.5]),
        (Matrix, "[[1, 0], [0, 2*2]]", [[1.0, 0.0], [0.0, 4.0]]),
        (NonNegative | Literal["N"] | None, "N", "N"),
        (NonNegative | Literal["N"] | None, "1/2", 0.5),
        (NonNegative | Literal["N"] | None, "null", None),
        (str | Band, "word", "word"),
        (str | Band, "{low: 1/2}", Band(0.5)),
        (Band, "{low: -1, high: 2*2}", Band(-1.0, 4.0)),
        (Band | None, "{low: 0}", Band(0.0)),
        (Still | Moving, "{kind: still}", Still()),
        (Still | Moving, "{speed: 2*2, kind: moving, band: [5%, 1]}", Moving(speed=4.0, band=(0.05, 1.0))),
        (Still | Moving | None, "null", None),
        (Still | Moving | float, "1/2", 0.5),
        (Still | Moving | float, "{kind: moving}", Moving()),
        (list[Still | Moving], "[{kind: still}, {kind: moving, speed: 3}]", [Still(), Moving(speed=3.0)]),
        (bool, "true", True),
        (dict[str, float], "{x: 5%}", {"x": 0.05}),
        (Any, "{x: [1]}", {"x": [1]}),
    ],
)
def test_values_that_are_accepted(annotation, yaml, value):
    """Numbers may be arithmetic wherever they stand; a union goes by the shape of the value."""
    assert check(annotation, yaml) == value


@pytest.mark.parametrize(
    ("annotation", "yaml", "place", "path", "message"),
    [
        (Positive, "-1", "1:4", "a", "must be > 0 (got -1)"),
        (NonNegative, "-5%", "1:4", "a", "must be >= 0 (got '-5%')"),
        (Count, "0", "1:4", "a", "must be >= 1 (got 0)"),
        (Count, "2.5", "1:4", "a", "must be a whole number (got 2.5)"),
        (str, "3", "1:4", "a", "must be text (got 3)"),
        (bool, "nope", "1:4", "a", "must be true or false (got 'nope')"),
        (Literal["clip", "qp"], "cut", "1:4", "a", "must be 'clip' or 'qp' (got 'cut')"),
        (list[float], "3", "1:4", "a", "must be a list (got 3)"),
        (list[Positive], "[1, 0]", "1:8", "a.1", "must be > 0 (got 0)"),
        (tuple[float, float], "[1]", "1:4", "a", "has too few entries"),
        (Matrix, "{x: 1}", "1:4", "a", "expected a number or a list or a matrix (got a mapping)"),
        (
            Matrix,
            "[[1, 2], [-x, 3]]",
            "1:14",
            "a.1.0",
            "column 2 of '-x': unknown name 'x' (known: pi, sqrt, sin, cos, exp, log)",
        ),
        (
            float | list[float],
            "[[1]]",
            "1:5",
            "a.0",
            "must be one number, not a list (got [1])",
        ),
        (float, "true", "1:4", "a", "expected a number or arithmetic such as '2*pi' (got True)"),
        (float, ".nan", "1:4", "a", "nan is not a quantity; numbers here are finite"),
        (Band, "3", "1:4", "a", "must be a mapping (got 3)"),
        (Band, "{high: 3}", "1:4", "a", "'low' is missing"),
        (Band, "{low: 3}", "1:4", "a", "low must not exceed high"),
        (Band, "{low: 0, hihg: 3}", "1:13", "a.hihg", "'hihg' is not a known key; did you mean 'high'?"),
        (Still | Moving, "{speed: 1}", "1:4", "a", "'kind' is missing; known kinds: still, moving"),
        (Still | Moving, "{kind: mvoing}", "1:11", "a.kind", "'mvoing' is not a known kind; did you mean 'moving'?"),
        (Still | Moving, "{kind: 3}", "1:11", "a.kind", "'3' is not a known kind; known: still, moving"),
        (Still | Moving, "3", "1:4", "a", "expected a mapping (got 3)"),
        (Still | Moving | float, "[3]", "1:4", "a", "expected a mapping or a number (got a list of 1)"),
        (Still | Moving, "{kind: moving, speed: 0}", "1:26", "a.speed", "must be > 0 (got 0)"),
        (Still | Moving, "{kind: moving, band: [0, -1]}", "1:29", "a.band.1", "must be >= 0 (got -1)"),
        (Still | Moving, "{kind: still, speed: 1}", "1:18", "a.speed", "'speed' is not a known key; known: kind"),
        (
            list[Still | Moving] | None,
            "[{kind: moving, sped: 1}]",
            "1:20",
            "a.0.sped",
            "'sped' is not a known key; did you mean 'speed'?",
        ),
        (
            tuple[float | list[float], Still | Moving],
            "[1, {kind: moving, sped: 1}]",
            "1:23",
            "a.1.sped",
            "'sped' is not a known key; did you mean 'speed'?",
        ),
        (
            tuple[Band, ...],
            "[{low: 0}, {low: 0, hi: 3}]",
            "1:24",
            "a.1.hi",
            "'hi' is not a known key; did you mean 'high'?",
        ),
        (Annotated[float, Gt(0)] | None, "{}", "1:4", "a", "expected a number (got a mapping)"),
    ],
)
def test_values_that_are_refused(annotation, yaml, place, path, message):
    """One message for a mistake, at its place, in words of the YAML."""
    assert check(annotation, yaml) == [(place, path, message)]


def test_too_many_entries_are_counted_in_plain_words():
    """No word of pydantic's shows through."""
    [(place, path, message)] = check(tuple[float, float], "[1, 2, 3]")
    assert (place, path) == ("1:4", "a")
    assert "Tuple" not in message and "validation" not in message


def test_several_mistakes_of_one_part_are_all_noted():
    """Pydantic does not stop at the first."""
    found = check(Band, "{low: x, high: [1], hi: 2}")
    assert [path for _, path, _ in found] == ["a.low", "a.high", "a.hi"]


@pytest.mark.parametrize(("group", "name"), PARTS)
def test_keys_are_the_parameters_of_the_design(group, name):
    """Names, defaults and what is required come from the signature; what the bench provides is no key."""
    signature = inspect.signature(registry.get(group, name)).parameters
    parameters = {key: value for key, value in signature.items() if key not in PROVIDED[group]}
    fields = model_of(group, name).model_fields
    assert set(fields) == set(parameters)
    for key, field in fields.items():
        assert field.is_required() == (parameters[key].default is inspect.Parameter.empty)
        assert field.is_required() or field.default == parameters[key].default
        assert (field.alias or key) == key.rstrip("_")


def test_a_key_named_like_a_python_word():
    """`from_` is the parameter, `from` the key, and `from_` is no key."""
    problems = Problems()
    made = problems.tried(validate, model_of("metrics", "mse"), parse("{from: 1/2}", "f.yaml"), [])
    assert made.from_ == 0.5 and not problems
    assert problems.tried(validate, model_of("metrics", "mse"), parse("{from_: 1}", "f.yaml"), []) is None
    assert problems[0].message == "'from_' is not a known key; did you mean 'from'?"


@pytest.mark.parametrize(
    ("value", "text"),
    [({"a": 1}, "a mapping"), ([1, 2], "a list of 2"), (None, "nothing"), ("a", "'a'"), (1e-3, "0.001")],
)
def test_shown(value, text):
    """Collections are not printed in full."""
    assert shown(value) == text


def test_a_key_without_an_annotation_is_read_as_a_number_where_its_default_is_one(monkeypatch):
    """A user's class need not annotate its keys for `5%` to be a number."""

    def design(model, factor=10.0, Ne=6, word="a", anything=None):
        return None

    monkeypatch.setitem(registry._REGISTERED["estimators"], "plain", design)
    tree = {"factor": "5%", "Ne": "2*3", "word": "5%", "anything": "5%"}
    checked = validate(model_of("estimators", "plain"), tree, [])
    assert (checked.factor, checked.Ne, checked.word, checked.anything) == (0.05, 6, "5%", "5%")
    assert isinstance(checked.Ne, int)


@pytest.mark.parametrize("given", [True, False, "auto"])
def test_a_key_may_be_true_false_or_a_word(given):
    """The scale of a boxplot: logarithmic, linear, or chosen by its values."""
    assert model_of("figures", "boxplot").model_validate({"log": given}).log == given


@pytest.mark.parametrize("given", ["maybe", 3, [True], {"a": True}])
def test_other_values_of_such_a_key_are_refused(given):
    """The message names what is accepted."""
    with pytest.raises(ValueError, match="auto|true or false or a word"):
        model_of("figures", "boxplot").model_validate({"log": given})


CODE = """
from rmpc_bench import single_run

@single_run
class Typo:
    def __init__(self, modle):
        self.model = modle
    def update(self, y):
        return y
"""


def test_a_misspelt_argument_of_the_code(tmp_path):
    """It would be a key that must be given; the value that the bench gives is named."""
    (tmp_path / "own.py").write_text(CODE, encoding="utf-8")
    path = write(tmp_path, methods="{A: {estimator: {file: own.py:Typo}}}")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert "'modle' is missing; if it is an argument in your code, did you mean 'model'" in str(caught.value)


def test_own_components_may_have_keys_that_the_bench_gives_to_its_own():
    """Oracle: the key of a law and of a controller of a user; those of the bench have none."""

    def law(n, *, sampled: float = 1.0): ...

    def control(model, *, measured: float = 1.0): ...

    assert "sampled" in keys_of("noises", "own.py:law", law).model_fields
    assert "measured" in keys_of("controllers", "own.py:control", control).model_fields
    assert "sampled" not in model_of("noises", "gaussian").model_fields
    assert "measured" not in model_of("controllers", "pid").model_fields
