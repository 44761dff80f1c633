"""Trees of the parser against those of Python's own, and its limits."""

import ast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rmpc_bench.expressions.arithmetic import (
    ArithmeticParser,
    Call,
    Name,
    Negation,
    Number,
    Operation,
    Percent,
    unknown_name,
)
from rmpc_bench.expressions.tokens import ExpressionError

SYMBOLS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}


class Parser(ArithmeticParser):
    """The smallest language: free names and functions of one argument."""

    def named(self, token):
        """named = name ["(" sum ")"]."""
        return Call(token.text, (self.group(),)) if self.token.text == "(" else Name(token.text)


def parse(text):
    """Return the tree of a text."""
    parser = Parser(text)
    tree = parser.sum()
    parser.finish()
    return tree


def negated(inner):
    """Two minus signs are none: the parser folds those in a row, parentheses may stand between them."""
    return inner[1] if isinstance(inner, tuple) and inner[0] == "-" else ("-", inner)


def ours(node):
    """Nested tuples of our tree, with one operator each."""
    match node:
        case Number():
            return node.value
        case Name():
            return node.name
        case Negation():
            return negated(ours(node.operand))
        case Call():
            return (node.function, *map(ours, node.arguments))
        case Operation():
            found = ours(node.first)
            for operand in node.rest:
                found = (found, operand.operator, ours(operand.node))
            return found
    raise AssertionError(node)


def pythons(node):
    """Nested tuples of Python's tree."""
    match node:
        case ast.Expression():
            return pythons(node.body)
        case ast.Constant():
            return float(node.value)
        case ast.Name():
            return node.id
        case ast.UnaryOp():
            inner = pythons(node.operand)
            return inner if isinstance(node.op, ast.UAdd) else negated(inner)
        case ast.Call():
            return (node.func.id, *map(pythons, node.args))
        case ast.BinOp():
            return (pythons(node.left), SYMBOLS[type(node.op)], pythons(node.right))
    raise AssertionError(node)


ATOMS = st.one_of(st.integers(0, 99).map(str), st.floats(0, 1e9).map(repr), st.sampled_from(["a", "b_1", ".5", "2."]))


def _larger(inner):
    signs = st.sampled_from(["", "-", "+", "- ", "- -", "-+-"])
    chains = st.lists(st.tuples(st.sampled_from("+-*/"), signs, inner), max_size=4)
    return st.one_of(
        st.builds(lambda first, rest: first + "".join(f" {op} {sign}{text}" for op, sign, text in rest), inner, chains),
        st.builds(lambda sign, text: f"({sign}{text})", signs, inner),
        st.builds(lambda text: f"f({text})", inner),
    )


@given(st.recursive(ATOMS, _larger, max_leaves=15))
def test_trees_are_pythons(text):
    """The same precedence, the same order from left to right, the same signs."""
    assert ours(parse(text)) == pythons(ast.parse(text, mode="eval"))


def test_nodes_of_one_meaning_are_equal():
    """Wherever they stand; they know their columns all the same."""
    assert parse("a + (2)*b") == parse("a+2 * b") == parse("a + --2*+b")
    assert hash(parse("f(a)%")) == hash(parse(" f( a ) %"))
    assert parse("a - b") != parse("b - a")
    assert parse("50%") == Percent(Number(50.0)) != Number(0.5)
    tree = parse("  a + b / c")
    assert (tree.column, tree.rest[0].node.column) == (5, 9)


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("(" * 51 + "1" + ")" * 51, 51, "nested deeper than 50 levels"),
        ("f(" * 51 + "1" + ")" * 51, 102, "nested deeper than 50 levels"),
        ("+".join("1" * 600), 1001, "longer than 1000 numbers, names and symbols"),
        ("f(a", 2, "'(' is not closed"),
        ("f(a b)", 5, "an operator is missing before 'b'"),
        ("(a]", 3, "unexpected ']'"),
        ("a)", 2, "expected the end (got ')')"),
        ("a */ b", 4, "expected a number (got '/')"),
        ("a ** b", 3, "there is no '**'; a power is written x*x"),
        ("1e400", 1, "the number 1e400 is too large"),
    ],
)
def test_errors(text, column, message):
    """With the column of what is wrong."""
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert (caught.value.column, caught.value.message) == (column, message)


def test_unknown_names():
    """What is known is listed, and what is near is offered."""
    token = Parser("maen").token
    assert unknown_name(token, "function", ["max", "mean"]).message == (
        "unknown function 'maen' (known: max, mean); did you mean 'mean'?"
    )
    assert unknown_name(token, "name", ["k"]).message == "unknown name 'maen' (known: k)"
