"""The grammar of claims, on top of arithmetic: from text to a tree, nothing computed.

A check is a chain of comparisons, or one ``all(...)``::

    check    = chain | "all" "(" chain ")"
    chain    = sum link {link}
    link     = ("<" | "<=" | ">" | ">=" | "==") sum  |  "~" sum "+-" sum
    atom     = number | named | "(" sum ")" | "[" sum {"," sum} "]"
    named    = "pi" | "inf" | term | FUNCTION "(" sum {"," sum} ")" | "share" "(" chain ")"
    term     = QUANTITY "[" METHOD {"," PATH "=" VALUE} "]"

`sum` and what is below it are the rules of `expressions.arithmetic`; ``+-`` is one symbol here.
A term is a metric (a column over runs), a series of a design (over k), a signal or ``n_failed[METHOD]``; METHOD is
everything up to the comma or closing bracket, trimmed, and what follows names a point of a sweep.  ``5%`` is 0.05, but
a tolerance ``+- 5%`` is that share of the right side.
Inside ``share`` and ``all`` comparisons are made entry by entry, over runs or over k.
A list of numbers is a vector; of columns, or of series, and numbers it is a column, or series, of vectors.
The signals, where no metric has the name, are the state x, the estimate x_hat and the error e = x - x_hat.  They
stand in mean, var, std and cov only, which are then taken over the runs at each k and give a series over k.  These
ensemble moments exist with ``evaluate: [runs, moments]``; exact ones count where they exist.

``tree.FUNCTION_HELP`` has a line on each function.

``inf`` stands for what did not occur in a run, such as settling; inf - inf is 0.  Nothing here imports NumPy or
anything that does: plain ``check`` parses claims in milliseconds.
"""

from __future__ import annotations

import math

from rmpc_bench.claims.tree import COMPARISONS, COUNTS, FUNCTIONS, Chain, Link, Listing, Term, terms
from rmpc_bench.expressions.arithmetic import ArithmeticParser, Call, Node, Number, unknown_name
from rmpc_bench.expressions.tokens import ExpressionError, Token

__all__ = ["COUNTS", "Chain", "ExpressionError", "parse", "parse_expression", "terms"]

_CONSTANTS = {"pi": math.pi, "inf": math.inf}


def parse(text: str) -> Chain:
    """Read a check.

    Parameters
    ----------
    text : such as ``mean(mse[R-MPC1]) < mean(mse[S-MPC])``

    Returns
    -------
    the tree

    Raises
    ------
    ExpressionError
        with the column and, for names, the nearest known one
    """
    parser = _ClaimParser(text)
    chain = parser.everywhere() if parser.token.text == "all" else parser.chain()
    parser.finish()
    return chain


def parse_expression(text: str) -> Node:
    """Read one expression, such as ``1 - ratio(mse[A], mse[B])``; raises as `parse` does."""
    parser = _ClaimParser(text)
    expression = parser.sum()
    parser.finish()
    return expression


class _ClaimParser(ArithmeticParser):
    """Arithmetic with terms, lists, functions and comparisons."""

    SYMBOLS = (*ArithmeticParser.SYMBOLS, "[", "]", ",", "+-", *COMPARISONS)
    OPERAND = "a number, a term such as mse[METHOD] or a function"
    INFINITY = "inf"
    MAX_DEPTH = 40
    MAX_TOKENS = 400

    def everywhere(self) -> Chain:
        """Read ``everywhere = "all" "(" chain ")"``."""
        start = self.tokens.next().start
        if self.token.text != "(":
            raise self.unexpected("'('")
        chain = self.chain_in_parentheses()
        return Chain(chain.links, self.tokens.since(start), everywhere=True)

    def chain(self) -> Chain:
        """Read ``chain = sum link {link}``."""
        start = first = self.token.start
        left, links = self.sum(), []
        while operator := self.tokens.accept(*COMPARISONS):
            middle = self.token.start
            right, tolerance = self.sum(), None
            if operator.text == "~":
                if not self.tokens.accept("+-"):
                    raise self.unexpected("'+-'")
                tolerance = self.sum()
            text = self.tokens.since(start)
            links.append(Link(left, operator.text, right, tolerance, text, column=operator.column))
            left, start = right, middle
        if not links:
            known, before = ", ".join(COMPARISONS), self.tokens.since(first)
            raise self.unexpected(f"a comparison ({known}) after {before}")
        return Chain(tuple(links), self.tokens.since(first), column=links[0].column)

    def chain_in_parentheses(self) -> Chain:
        """Read ``"(" chain ")"``."""
        opening = self.open()
        chain = self.chain()
        self.close(opening, ")")
        return chain

    def atom(self) -> Node:
        """Read ``atom = list | what arithmetic knows``."""
        return self.listing() if self.token.text == "[" else super().atom()

    def listing(self) -> Listing:
        """Read ``list = "[" sum {"," sum} "]"``."""
        column, items = self.token.column, self.several("]")
        lengths = {len(item.items) if isinstance(item, Listing) else -1 for item in items}
        nested = any(isinstance(part, Listing) for item in items if isinstance(item, Listing) for part in item.items)
        if len(lengths) > 1 or nested:
            raise ExpressionError(column, "a list has numbers, or rows of the same length")
        return Listing(items, column=column)

    def several(self, closing: str) -> tuple[Node, ...]:
        """Read expressions between brackets, separated by commas."""
        opening = self.open()
        items = [self.sum()]
        while self.tokens.accept(","):
            items.append(self.sum())
        self.close(opening, closing)
        return tuple(items)

    def named(self, token: Token) -> Node:
        """Read ``named = constant | term | function "(" ... ")"``."""
        if self.token.text == "[":
            return self.term(token)
        if self.token.text == "(":
            return self.call(token)
        if token.text in _CONSTANTS:
            return Number(_CONSTANTS[token.text], column=token.column)
        if token.text in FUNCTIONS:
            raise self.unexpected(f"'(' after the function {token.text}")
        raise ExpressionError(token.column, f"{token.text!r} needs a method: {token.text}[METHOD]")

    def term(self, name: Token) -> Term:
        """Read ``term = QUANTITY "[" METHOD {"," PATH "=" VALUE} "]"``."""
        inside = self.tokens.until("]")
        if inside is None or not inside.strip():
            raise ExpressionError(name.column, f"{name.text}[...] needs a method and a closing bracket")
        method, *coordinates = (part.strip() for part in inside.split(","))
        point = [tuple(side.strip() for side in part.partition("=")[::2]) for part in coordinates]
        if not method or not all(path and value for path, value in point):
            raise ExpressionError(name.column, f"{name.text}[...] is {name.text}[METHOD, path=value, ...]")
        return Term(name.text, method, tuple((path, value) for path, value in point), column=name.column)

    def call(self, name: Token) -> Call:
        """Read ``call = FUNCTION "(" sum {"," sum} ")" | "share" "(" chain ")"``."""
        if name.text not in FUNCTIONS:
            raise unknown_name(name, "function", sorted(FUNCTIONS))
        if name.text == "all":
            raise ExpressionError(name.column, "all(...) is a check of its own, not a part of one")
        if name.text == "share":
            return Call(name.text, (self.chain_in_parentheses(),), column=name.column)
        arguments = self.several(")")
        if len(arguments) != FUNCTIONS[name.text]:
            wanted = f"takes {FUNCTIONS[name.text]} argument(s), got {len(arguments)}"
            raise ExpressionError(name.column, f"{name.text} {wanted}")
        return Call(name.text, arguments, column=name.column)

    def is_known(self, name: str) -> bool:
        """Whether a name may begin an operand."""
        return name in _CONSTANTS or name in FUNCTIONS
