"""Quantities against Python's own arithmetic, and every way a text can be wrong."""

import math
import pickle
import subprocess
import sys

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rmpc_bench.expressions.quantity import QuantityError, number, parse, spread, with_unit

NAMES = {"k": 3.0, "eps_min": -0.25}
SCOPE = {"__builtins__": {}, "pi": math.pi, "sqrt": math.sqrt, "sin": math.sin, "cos": math.cos, **NAMES}
SCOPE |= {"exp": math.exp, "log": math.log}


def _literals():
    texts = st.one_of(
        st.integers(0, 10**6).map(str),
        st.floats(0, 1e6, allow_nan=False).map(repr),
        st.sampled_from(["1.", ".5", "1e-3", "2E+2", "007.5"]),
    )
    return texts.map(lambda text: (text, repr(float(text))))


def _extend(inner):
    def pair(template, *parts):
        return template.format(*(part[0] for part in parts)), template.format(*(f"({part[1]})" for part in parts))

    def sum_of(first, others):  # no parentheses in our text: the grammar's own precedence is what is compared
        text = first[0] + "".join(sign + other[0] for sign, other in others)
        return "(" + text + ")", first[1] + "".join(sign + other[1] for sign, other in others)

    operators = st.sampled_from([" + ", "-", "*", " / "])
    return st.one_of(
        st.builds(lambda a: pair("({0})", a), inner),
        st.builds(lambda f, a: (f"{f}({a[0]})", f"{f}({a[1]})"), st.sampled_from(["sqrt", "sin", "cos"]), inner),
        st.builds(sum_of, inner, st.lists(st.tuples(operators, inner), max_size=4)).map(
            lambda both: (both[0], f"({both[1]})")
        ),
    )


def _atoms():
    bare = st.one_of(_literals(), st.sampled_from([(name, name) for name in ["pi", *NAMES]]))
    percent = bare.map(lambda both: (both[0] + "%", f"({both[1]}/100)"))
    return st.one_of(bare, percent)


def _signed(strategy):
    signs = st.text("+-", max_size=3)
    return st.builds(lambda sign, both: (sign + both[0], sign + both[1]), signs, strategy)


EXPRESSIONS = st.recursive(_signed(_atoms()), lambda inner: _signed(_extend(inner)), max_leaves=12)


@given(EXPRESSIONS)
def test_same_bits_as_python(both):
    """The grammar agrees with Python to the last bit wherever Python finds a finite float."""
    text, python = both
    assume(len(text) <= 1000)
    try:
        expected = eval(python, SCOPE)
    except (ZeroDivisionError, ValueError, OverflowError):
        expected = math.nan
    if math.isfinite(expected):
        assert parse(text, NAMES)(NAMES) == expected
    else:
        with pytest.raises(QuantityError):
            parse(text, NAMES)(NAMES)


@given(st.text("0123456789.e+-*/()% pisqrtcoknaf_,^", max_size=30))
def test_any_text_gives_a_number_or_the_one_error(text):
    """No other exception leaves the parser."""
    try:
        assert math.isfinite(number(text))
    except QuantityError:
        pass


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_floats_come_back_exactly(value):
    """A number given as float keeps its bits."""
    assert number(value) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2*pi", 2 * math.pi),
        ("10%", 0.1),
        ("-50%", -0.5),
        ("(1 + 1)%", 0.02),
        ("1e-3", 1e-3),
        ("7 - 2 - 1", 4),
        ("8/4/2", 1),
        ("1 + 2*3", 7),
        ("- -2*+3", 6),
        ("2*-3", -6),
        ("sqrt(16)*cos(0) + sin(0)", 4),
        ("exp(log(3) + log(2)) - exp(log(6))", 0),
        ("log(exp(2))", 2),
        (3, 3),
        (-2.5, -2.5),
        ("\t1\n", 1),
    ],
)
def test_by_hand(text, value):
    """Values worked out by hand."""
    assert number(text) == value


@pytest.mark.parametrize(
    ("text", "column", "piece"),
    [
        ("", 1, "expected a number (got the end)"),
        ("1 +", 4, "expected a number (got the end)"),
        ("1_000", 2, "not grouped with '_' (1_000)"),
        ("2pi", 2, "did you mean 2*pi?"),
        ("2 (3)", 3, "did you mean 2*(...)?"),
        ("1.2.3", 4, "an operator is missing before '.3'"),
        ("10%5", 4, "an operator is missing before '5'"),
        ("(1)(2)", 4, "an operator is missing before '('"),
        ("2**3", 2, "x*x"),
        ("2^3", 2, "x*x"),
        ("1,5", 2, "written with a point"),
        ("5%%", 3, "expected the end (got '%')"),
        ("1)", 2, "expected the end (got ')')"),
        ("2*(1", 3, "'(' is not closed"),
        ("(1 2)", 4, "an operator is missing before '2'"),
        ("1+*2", 3, "expected a number (got '*')"),
        ("1 + nan", 5, "'nan' is not a number"),
        ("-inf", 2, "'inf' is not a number"),
        ("-.inf", 2, "'.inf' is not a number"),
        (".NaN", 1, "'.NaN' is not a number"),
        ("1e999", 1, "too large"),
        ("sqr(4)", 1, "unknown name 'sqr' (known: pi, sqrt, sin, cos, exp, log); did you mean 'sqrt'?"),
        ("sqrt 4", 1, "'sqrt' needs parentheses"),
        ("1 $ 2", 3, "unexpected '$'"),
        ("1/(2-2)", 2, "division by zero"),
        ("0/0", 2, "division by zero"),
        ("sqrt(1-2)", 1, "sqrt of a negative number (-1.0)"),
        ("1 + log(0)", 5, "log of a number that is not positive (0.0)"),
        ("exp(1000)", 1, "exp(1000.0) is too large"),
        ("1e308*10", 6, "not finite"),
        ("1/(1e308*10)", 9, "not finite"),
        ("(" * 51 + "1" + ")" * 51, 51, "nested deeper than 50"),
    ],
)
def test_errors_name_piece_and_column(text, column, piece):
    """Each message has the column and the piece."""
    with pytest.raises(QuantityError) as caught:
        number(text)
    assert str(caught.value).startswith(f"column {column} of ")
    assert piece in str(caught.value)


@pytest.mark.parametrize("value", [True, False, None, [1], math.nan, math.inf, 10**400, "1" * 1001])
def test_what_is_no_quantity_at_all(value):
    """Wrong types, sizes and numbers that are not finite."""
    with pytest.raises(QuantityError):
        number(value)


def test_long_texts_do_not_reach_the_stack_limit():
    """Chains of operators and signs are as long as the text may be; nesting is allowed to its limit."""
    assert number("+".join("1" * 500)) == 500
    assert number("-" * 998 + "1") == 1
    assert number("(" * 50 + "1" + ")" * 50) == 1


def test_free_names():
    """Names are reported, needed, and cannot hide what is built in."""
    expression = parse("1 + eps_min*k", ["k", "eps_min", "eps_max"])
    assert expression.names == {"k", "eps_min"}
    assert expression({"k": 2, "eps_min": 0.25, "other": 9}) == 1.5
    with pytest.raises(QuantityError, match="column 5 of .*no value is given for 'eps_min'"):
        expression({"k": 2})
    with pytest.raises(QuantityError, match="column 5 of .*not finite"):
        expression({"k": 2, "eps_min": math.inf})
    with pytest.raises(QuantityError, match=r"unknown name 'eps_mn' \(known: .*eps_min.*'eps_min'\?"):
        parse("eps_mn", ["eps_min"])
    with pytest.raises(QuantityError, match="'pi' already has a meaning"):
        parse("1", ["pi"])
    assert parse("-3").names == frozenset()


def test_expressions_are_values():
    """Equal texts are equal, hash alike and survive pickling."""
    expression = parse("sqrt(k)%", ["k"])
    again = pickle.loads(pickle.dumps(expression))
    assert again == expression == parse("sqrt(k)%", ("k", "n"))
    assert len({again, expression}) == 1
    assert again({"k": 4.0}) == 0.02
    assert expression.text == "sqrt(k)%"
    with pytest.raises(AttributeError):
        expression.text = "1"
    error = pickle.loads(pickle.dumps(QuantityError("x")))
    assert str(error) == "x"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("+-10%", 0.1),
        ("±10%", 0.1),
        ("  + - 2*3 ", 6.0),
        ("± sqrt(4)", 2.0),
        ("+-0", 0.0),
        ("10%", None),
        ("-+10%", None),
        ("1 +- 2", None),
        ("", None),
        (0.1, None),
    ],
)
def test_spread(text, value):
    """Only a text that starts with the sign states a spread."""
    assert spread(text) == value


@pytest.mark.parametrize(
    ("text", "piece"),
    [("+--5%", "must be >= 0"), ("+-", "column 3 of '+-'"), ("± 2pi", "column 4 of '± 2pi'"), ("+-x", "'x'")],
)
def test_spread_errors(text, piece):
    """Columns count from the start of the whole text."""
    with pytest.raises(QuantityError) as caught:
        spread(text)
    assert piece in str(caught.value)


def test_import_is_light():
    """The grammar needs NumPy and no larger library."""
    heavy = "{'scipy', 'pandas', 'numba', 'pydantic'}"
    code = f"import sys, rmpc_bench.expressions.quantity; sys.exit(bool({heavy} & {{*sys.modules}}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [("8 ml/s", 8.0, "ml/s"), ("0.5 N m", 0.5, "N m"), ("-1e-3 m^2", -1e-3, "m^2"), ("10 %", 0.1, ""), (3, 3.0, "")],
)
def test_a_unit_may_stand_behind_a_number(text, value, unit):
    """Oracle: the number and the name of the unit, which is not converted."""
    assert with_unit(text) == (value, unit)


@pytest.mark.parametrize("text", ["ml/s", "8ml", "eps m", "8 +", True, None])
def test_a_unit_needs_a_number_and_a_blank(text):
    """Oracle: the error of the number."""
    with pytest.raises(QuantityError):
        with_unit(text)
