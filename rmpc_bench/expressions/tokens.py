"""Tokens of an expression: numbers, names and symbols, with their offsets in the text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

_NUMBER = r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
_NAME = r"(?P<name>[^\W\d]\w*)"
_HINTS = {",": "; decimals are written with a point", "^": "; a power is written x*x"}


class ExpressionError(ValueError):
    """A text that is no expression; `column`, from 1, is that of the character that the message is about."""

    def __init__(self, column: int, message: str) -> None:
        self.column, self.message = column, message
        super().__init__(f"column {column}: {message}")

    def __reduce__(self) -> tuple[type[ExpressionError], tuple[int, str]]:
        """Pickle by column and message."""
        return type(self), (self.column, self.message)


class Token(NamedTuple):
    """One word of an expression."""

    kind: str  # ``number``, ``name``, ``symbol``, ``start`` (before the first one) or ``end`` (after the last one)
    text: str
    start: int  # offset of the first character
    end: int  # offset behind the last character

    @property
    def column(self) -> int:
        """Where it stands for a reader, counted from 1."""
        return self.start + 1


class Tokens:
    """Reads a text token by token, with one token of lookahead; blanks between tokens are skipped.

    The symbols may stand between numbers and names; of two that begin alike the longer one is read.  An ExpressionError
    says that a character begins no token.
    """

    def __init__(self, text: str, symbols: Sequence[str], start: int = 0) -> None:
        alternatives = "|".join(re.escape(symbol) for symbol in sorted(symbols, key=len, reverse=True))
        self.text = text
        self._pattern = re.compile(rf"\s*(?:{_NUMBER}|{_NAME}|(?P<symbol>{alternatives})|(?P<end>$))")
        self.current = self.previous = Token("start", "", start, start)
        self.n_read = 0
        self.next()

    def next(self) -> Token:
        """Move on by one token and return the one passed."""
        self.previous, start = self.current, self.current.end
        match = self._pattern.match(self.text, start)
        if match is None or match.lastgroup is None:
            raise self._unreadable(start)
        kind = match.lastgroup
        self.current = Token(kind, match[kind], match.start(kind), match.end())
        self.n_read += 1
        return self.previous

    def accept(self, *symbols: str) -> Token | None:
        """Move past the current token if it is one of these symbols, and return it."""
        return self.next() if self.current.kind == "symbol" and self.current.text in symbols else None

    def until(self, closing: str) -> str | None:
        """Return the text up to a closing symbol, with any characters, and move past it; None if there is none."""
        place = self.text.find(closing, self.current.end)
        if place < 0:
            return None
        inside = self.text[self.current.end : place]
        self.current = Token("symbol", closing, place, place + len(closing))
        self.next()
        return inside

    def since(self, start: int) -> str:
        """Return the text from an offset to the end of the token passed last."""
        return self.text[start : self.previous.end]

    def _unreadable(self, start: int) -> ExpressionError:
        place = start + len(self.text[start:]) - len(self.text[start:].lstrip())
        if self.text[place:].lower().startswith((".inf", ".nan")):
            word = self.text[place : place + 4]
            return ExpressionError(place + 1, f"{word!r} is not a number; numbers here are finite")
        character = self.text[place]
        return ExpressionError(place + 1, f"unexpected {character!r}{_HINTS.get(character, '')}")
