"""Characters that names and texts must not contain; the oracle is the table of Unicode of this Python."""

import sys
import unicodedata

import pytest

from rmpc_bench.received.names import HIDDEN
from rmpc_bench.types.texts import refused_in_name, refused_in_text, visible

ALL = [chr(code) for code in range(sys.maxunicode + 1)]
DIRECTION = [
    each for each in ALL if unicodedata.bidirectional(each) in {*"LRE RLE LRO RLO PDF LRI RLI FSI PDI".split()}
]


def test_a_name_has_no_character_that_cannot_be_seen():
    """Controls, formats, surrogates and line separators; letters, marks and blanks of every script are allowed."""
    refused = [each for each in ALL if refused_in_name(f"K{each}F")]
    assert refused == [each for each in ALL if unicodedata.category(each) in ("Cc", "Cf", "Cs", "Zl", "Zp")]
    assert not refused_in_name("Kálmán\u00a0$c_1$, 卡尔曼, क़")


def test_a_text_may_have_lines_and_joiners():
    """Its other controls, and all characters of direction, are refused."""
    refused = {each for each in ALL if refused_in_text(each)}
    controls = {each for each in ALL if unicodedata.category(each) == "Cc"} - {"\n", "\t"}
    assert controls | {*DIRECTION, "\u200e", "\u200f", "\u061c"} <= refused
    assert not refused & {"\n", "\t", "\u200d", "\u200c", "\u200b", "é"}


@pytest.mark.parametrize("kind, character", [("control", "\x9b"), ("direction", "\u2067"), ("invisible", "\u200b")])
def test_the_message_names_the_character(kind, character):
    """By its code, since it cannot be shown."""
    assert refused_in_name(f"a{character}") == f"contains the {kind} character U+{ord(character):04X}; leave it out"


def test_what_is_shown_can_be_shown():
    """A screen gets escapes; a second pass changes nothing."""
    shown = visible("a\x1b]0;pwn\x07\tb\u202e\n\udc80")
    assert shown == "a\\x1b]0;pwn\\x07\tb\\u202e\n\\udc80"
    assert visible(shown) == shown
    assert not any(refused_in_text(visible(each)) for each in ALL)


def test_stored_files_refuse_the_same_characters():
    """Otherwise results of an accepted configuration could not be read again."""
    assert HIDDEN.findall("".join(ALL)) == [each for each in ALL if refused_in_text(each)]
