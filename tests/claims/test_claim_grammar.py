"""The grammar of claims: trees, errors, and arithmetic against Python's."""

import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.grammar import FUNCTION_HELP, FUNCTIONS, Chain, Link, Term, parse, parse_expression, terms, uses
from rmpc_bench.expressions.arithmetic import Call, Number, Operand, Operation, Percent
from rmpc_bench.expressions.tokens import ExpressionError


def named(chain):
    return {(term.quantity, term.method) for term in terms(chain)}


def pairs(ours, theirs):
    """Return a strategy of one rendering for us beside one for Python."""
    return st.tuples(st.just(ours), st.just(theirs))


NUMBERS = st.one_of(
    st.integers(0, 999).map(lambda n: (str(n), f"{n}.0")),
    st.floats(1e-9, 1e9).map(lambda x: (repr(x), repr(x))),
    st.floats(0.01, 99).map(lambda x: (f"{x!r}%", f"({x!r}/100)")),
    pairs("pi", repr(math.pi)),
    pairs(".5", ".5"),
    pairs("2.", "2."),
    pairs("1E3", "1E3"),
)


def nested(inner):
    """Return larger expressions made of `inner`."""
    binary = st.tuples(inner, st.sampled_from("+-*/"), inner, st.sampled_from(["", " "]))
    return st.one_of(
        binary.map(lambda p: tuple(f"{p[0][i]} {p[1]}{p[3]}{p[2][i]}".replace("+-", "+ -") for i in (0, 1))),
        inner.map(lambda p: (f"({p[0]})", f"({p[1]})")),
        inner.map(lambda p: (f"-{p[0]}", f"-{p[1]}")),
    )


@given(st.recursive(NUMBERS, nested, max_leaves=12))
@example(("8/4/2 - 3 - 1", "8/4/2 - 3 - 1"))
@example(("2*-3 + 5 %", "2*-3 + .05"))
def test_arithmetic_is_pythons(make_numbers, rendered):
    """Precedence, associativity and signs as in Python."""
    ours, theirs = rendered
    try:
        expected = eval(theirs, {"__builtins__": {}})
    except (ZeroDivisionError, OverflowError):
        return
    found = float(make_numbers.value(parse_expression(ours)).array)
    assert found == expected or (math.isnan(expected) and math.isnan(found))


@pytest.fixture(scope="module")
def make_numbers():
    """Return an evaluator of expressions without terms."""

    class Nothing:
        methods, metrics = (), ()

    return Evaluator(Nothing(), Number(0.0))


@given(st.text(alphabet="ab[]() ,<=~+-*/%.0123e\npi", max_size=40))
def test_any_text_is_a_tree_or_a_expression_error(text):
    """No other exception, and the column lies in the text or at its end."""
    for read in (parse, parse_expression):
        try:
            read(text)
        except ExpressionError as error:
            assert 1 <= error.column <= len(text) + 1
            assert str(error).startswith(f"column {error.column}: ")


def test_chain_of_product_md():
    """The claim of the example configuration."""
    text = "mean(mse[R-MPC1]) < mean(mse[ R-MPC2 ]) <= mean(mse[S-MPC])"
    chain = parse(text)
    assert chain.text == text
    assert [link.text for link in chain.links] == [text[:39], text[20:]]
    assert chain.links[0] == Link(
        Call("mean", (Term("mse", "R-MPC1"),)), "<", Call("mean", (Term("mse", "R-MPC2"),)), None, text[:39]
    )
    assert named(chain) == {("mse", "R-MPC1"), ("mse", "R-MPC2"), ("mse", "S-MPC")}
    assert parse(text) == chain
    assert hash(parse(text)) == hash(chain)


def test_all_is_a_statement_of_its_own():
    """The other example: no operator at the top."""
    chain = parse("all(diag(M[ERP]) <= diag(P[ERP]))")
    assert chain.everywhere
    assert chain.text == "all(diag(M[ERP]) <= diag(P[ERP]))"
    assert named(chain) == {("M", "ERP"), ("P", "ERP")}


def test_tolerances():
    """A percentage belongs to the right side, anything else is absolute."""
    assert (parse("1 ~ 2 +- 5%").links[0].relative, parse("1 ~ 2 +- 0.05").links[0].relative) == (True, False)
    link = parse("1 ~ 2 + 3 +- 4 * 5 < 9").links[0]
    assert link.right == Operation(Number(2.0), (Operand("+", Number(3.0)),))
    assert link.tolerance == Operation(Number(4.0), (Operand("*", Number(5.0)),))
    assert parse("1 ~ 2 +- 5 %").links[0].tolerance == Percent(Number(5.0))
    assert not parse("1 ~ 2 +- 2 * 5%").links[0].relative


def test_terms_of_everything():
    """Shares, lists and counts are walked too."""
    chain = parse("share(a[M1] < [1, at(b[M 2], 3)]) >= ratio(n_failed[M1], c[x.y=1])")
    assert named(chain) == {("a", "M1"), ("b", "M 2"), ("n_failed", "M1"), ("c", "x.y=1")}
    assert isinstance(chain.links[0].left.arguments[0], Chain)


def test_terms_know_what_they_are_the_argument_of():
    """By themselves, that is: in an operation or a list they are of none; one term may stand in several functions."""
    chain = parse("share(var(e[A]) < 2 * a[A]) > mean(e[A, c=1]) / quantile([a[A]], b[A]) + n_failed[A] + std(e[A])")
    assert {(term.quantity, term.point, function) for term, function in uses(chain)} == {
        ("e", (), "var"),
        ("e", (), "std"),
        ("a", (), ""),
        ("e", (("c", "1"),), "mean"),
        ("b", (), "quantile"),
        ("n_failed", (), ""),
    }


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("maen(mse[A]) < 1", 1, "did you mean 'mean'?"),
        ("1 < zzz(2)", 5, "known: abs, all, at"),
        ("mean(mse) < 1", 6, "'mse' needs a method: mse[METHOD]"),
        ("mean(mse[A) < 1", 6, "closing bracket"),
        ("mean(mse[ ]) < 1", 6, "needs a method"),
        ("mean(mse[A])", 13, "expected a comparison (<, <=, >, >=, ==, ~) after mean(mse[A])"),
        ("1 < ", 5, "got the end"),
        ("", 1, "got the end"),
        ("1 < 2 3", 7, "an operator is missing before '3'"),
        ("1 ~ 2", 6, "expected '+-'"),
        ("1 +- 2 < 3", 3, "expected a comparison"),
        ("1 < 2 $", 7, "unexpected '$'"),
        ("1 = 2", 3, "unexpected '='"),
        ("quantile(mse[A]) < 1", 1, "takes 2 argument(s), got 1"),
        ("cov(e[A], 1) < 1", 1, "takes 1 argument(s), got 2"),
        ("excess(P[A]) < 1", 1, "takes 2 argument(s), got 1"),
        ("last(since(P[A])) < 1", 6, "takes 2 argument(s), got 1"),
        ("distance(1, 2) < 1", 1, "takes 3 argument(s), got 2"),
        ("distanze(1, 2, 3) < 1", 1, "did you mean 'distance'?"),
        ("share(mse[A]) < 1", 13, "expected a comparison"),
        ("1 < all(1 < 2)", 5, "a check of its own"),
        ("all(1 < 2) < 3", 12, "expected the end"),
        ("mean < 2", 6, "expected '('"),
        ("[[1, 2], [3]] < 4", 1, "rows of the same length"),
        ("[[[1]]] < 4", 1, "rows of the same length"),
        ("1 < 1e999", 5, "infinity is written inf"),
        ("(" * 60 + "1" + ")" * 60 + " < 2", 41, "nested deeper"),
        ("1" + "+1" * 300 + " < 2", 401, "longer than"),
        ("2 pi < 1", 3, "an operator is missing before 'pi'; did you mean 2*pi?"),
        ("mse[A] mse[B] < 1", 8, "an operator is missing before 'mse'"),
        ("1 < (2", 5, "'(' is not closed"),
        ("max([1, 2) < 1", 10, "expected ']' (got ')')"),
        ("1 < 2**3", 6, "a power is written x*x"),
        ("1 < never", 5, "'never' needs a method"),
        ("__import__('os') < 1", 1, "unknown function"),
        ("1 < 'a'", 5, 'unexpected "\'"'),
    ],
)
def test_errors_say_where_and_what(text, column, words):
    """Column and a way out."""
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert (caught.value.column, words in str(caught.value)) == (column, True), str(caught.value)


def test_errors_pickle():
    """An error may come back from a worker."""
    error = pickle.loads(pickle.dumps(ExpressionError(3, "what")))
    assert (str(error), error.column) == ("column 3: what", 3)


def test_no_heavy_import():
    """Plain check must not pay for NumPy."""
    code = (
        "import sys, rmpc_bench.claims.grammar as g; g.parse('mean(a[A]) < 1');"
        "assert not {'numpy', 'pandas', 'scipy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(filter(None, sys.path))})


def test_values_are_numpy_arrays(make_numbers):
    """Lists become vectors and matrices, a sign goes to every entry."""
    np.testing.assert_array_equal(make_numbers.value(parse_expression("-[[1, 2], [3, 4]]")).array, [[-1, -2], [-3, -4]])
    assert float(make_numbers.value(parse_expression("inf - inf")).array) == 0


def test_every_function_has_a_line():
    """Which shows how it is written: what it shows can be parsed, or is a check of its own."""
    assert list(FUNCTION_HELP) == list(FUNCTIONS)
    for name, line in FUNCTION_HELP.items():
        usage, _, text = line.partition(": ")
        arguments = usage.removeprefix(f"{name}(").removesuffix(")").split(", ")
        assert usage == f"{name}({', '.join(arguments)})" and len(arguments) == FUNCTIONS[name]
        assert text and len(line) <= 120 and "\n" not in line
        filled = usage.replace("a < b", "1 < 2") if "<" in usage else f"{name}({', '.join('1' for _ in arguments)})"
        assert parse(filled if name == "all" else f"{filled} < 3").links
