"""Writing YAML that reads back to the same data."""

import math

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump, parse

# The reader refuses the others in a key.
CHARACTERS = st.characters(exclude_categories=("Cc", "Cf", "Cs", "Zl", "Zp"))
SCALARS = st.one_of(
    *(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(CHARACTERS, max_size=8)),
    st.text(st.sampled_from(" -+.:#,[]{}&*!|>'\"%@`~=<?0123456789eExobnulytr_\\"), max_size=6),
    st.sampled_from("1e-3 yes null 2*pi +-10% ~ <<  = - --- ... a:b 1:30 2018-04-18 0x1F 1_0 .inf on".split(" ")),
)
DATA = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(CHARACTERS, max_size=4) | SCALARS.map(str), inner, max_size=4)
    ),
    max_leaves=20,
)


def exactly(value):
    """Make types, signs of zero and the order of keys part of the comparison."""
    if isinstance(value, dict):
        return [(key, exactly(item)) for key, item in value.items()]
    return [exactly(item) for item in value] if isinstance(value, list) else (type(value), repr(value))


@given(DATA)
@settings(deadline=None)
def test_round_trip(value):
    """What is written is read back, with types and order."""
    assert exactly(plain(parse(dump(value), "f"))) == exactly(value)


@pytest.mark.parametrize(
    "value",
    [
        *("x" * 5000, {"k" * 5000: 1}, {"k " * 600: {"a": {"b": {"c": [1]}}}}, [{"k" * 1001: ["y" * 200]}]),
        *([[[[1], [2]], [[3]]]], [["z" * 200], {"a": ["z" * 200]}], {"a": {}, "b": [], "c": ""}, {}, [], None, ""),
        *(
            "\ufeff",
            "\u2028",
            "a\nb",
            "\t",
            "😀: 😀",
            "ü",
            "a ",
            " a",
            "a #b",
            math.inf,
            -math.inf,
            -0.0,
            1e16,
            5e-324,
        ),
    ],
)
def test_round_trip_of_odd_shapes(value):
    """Long keys, lists in lists, empty things, unprintable characters."""
    assert exactly(plain(parse(dump(value), "f"))) == exactly(value)


def test_dump_by_hand():
    """Blocks outside, one line for what is simple; quotes where something else could be meant."""
    value = {
        **{"name": "fig 7", "c": 1e-05, "none": None, "yes": "1e-3", "law": "+-10%", "half": "10%"},
        "controller": {"kind": "mpc", "limits": {"u": [-220, 220.0]}, "y": "2*pi"},
        "methods": {"A": {"estimator": {"kind": "kalman", "x": {"y": 1}}}},
        "claims": [{"says": "a: b", "at": {"x": {"y": {"z": 1}}}}],
    }
    assert dump(value) == (
        'name: fig 7\nc: 1e-05\nnone: null\n"yes": "1e-3"\nlaw: "+-10%"\nhalf: "10%"\n'
        "controller:\n  kind: mpc\n  limits: {u: [-220, 220.0]}\n  y: 2*pi\n"
        "methods:\n  A:\n    estimator: {kind: kalman, x: {y: 1}}\n"
        'claims:\n  - says: "a: b"\n    at:\n      x: {y: {z: 1}}\n'
    )
    assert math.isnan(parse(dump(math.nan), "f"))
    assert dump((1, "a")) == "[1, a]\n"


@pytest.mark.parametrize(
    ("value", "error"),
    [({1: 2}, TypeError), (object(), TypeError), (["\ud800"], ValueError), (10**1001, ValueError)],
)
def test_dump_refuses(value, error):
    """What could not be read back is not written."""
    with pytest.raises(error):
        dump(value)


def test_dump_refuses_what_never_ends():
    """Too deep, or standing in itself."""
    value = []
    value.append(value)
    with pytest.raises(ValueError, match="nested deeper"):
        dump(value)


def test_other_readers_agree_on_quotes():
    """PyYAML's loader of YAML 1.1 reads the texts we write unquoted as texts, too."""

    texts = ["yes", "on", "1_000", "12:30", "2018-04-18", "0b1", "=", "<<", "~", "1e-3", "+-10%", "2*pi", "a b"]
    assert yaml.safe_load(dump(texts)) == texts
