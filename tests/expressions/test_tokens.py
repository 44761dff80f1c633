"""The tokeniser: offsets, symbols, raw text between brackets, errors."""

import pickle

import pytest

from rmpc_bench.expressions.tokens import ExpressionError, Tokens

SYMBOLS = ("<", "<=", "+", "+-", "[", "]")


def everything(tokens):
    """Return all tokens that are left."""
    found = []
    while tokens.current.kind != "end":
        found.append(tokens.next())
    return found


def test_kinds_and_offsets():
    """A token is its piece of the text; of two symbols that begin alike the longer one is read."""
    text = "  a_1 <=\t.5e-3+- é\n+ 2"
    found = everything(Tokens(text, SYMBOLS))
    assert [(token.kind, token.text) for token in found] == [
        ("name", "a_1"),
        ("symbol", "<="),
        ("number", ".5e-3"),
        ("symbol", "+-"),
        ("name", "é"),
        ("symbol", "+"),
        ("number", "2"),
    ]
    assert all(text[token.start : token.end] == token.text and token.column == token.start + 1 for token in found)


def test_a_text_may_begin_later():
    """Offsets count from the start of the whole text."""
    assert [token.column for token in everything(Tokens("++ a + b", SYMBOLS, start=2))] == [4, 6, 8]


def test_text_between_brackets_is_read_as_it_is():
    """Whatever characters it has; None where the bracket is not closed."""
    tokens = Tokens("mse[R-MPC, $c=1$] < 2", SYMBOLS)
    start = tokens.next().start
    assert (tokens.until("]"), tokens.current.text, tokens.since(start)) == ("R-MPC, $c=1$", "<", "mse[R-MPC, $c=1$]")
    open_ = Tokens("mse[A", SYMBOLS)
    open_.next()
    assert open_.until("]") is None and open_.current.text == "["


def test_accept():
    """Only the symbols that are asked for; a name with the same text is none of them."""
    tokens = Tokens("a < b", (*SYMBOLS, "a"))
    assert tokens.accept("a", "<") is None and tokens.next().text == "a"
    assert tokens.accept("<", "+").column == 3 and tokens.current.text == "b"


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("a $ b", 3, "unexpected '$'"),
        ("1,5", 2, "unexpected ','; decimals are written with a point"),
        ("x^2", 2, "unexpected '^'; a power is written x*x"),
        (" -", 2, "unexpected '-'"),
        ("a < .INF", 5, "'.INF' is not a number; numbers here are finite"),
    ],
)
def test_unreadable_characters(text, column, message):
    """They are reported when they are reached, one token ahead."""
    with pytest.raises(ExpressionError) as caught:
        everything(Tokens(text, SYMBOLS))
    assert (caught.value.column, caught.value.message) == (column, message)
    assert str(pickle.loads(pickle.dumps(caught.value))) == f"column {column}: {message}"
