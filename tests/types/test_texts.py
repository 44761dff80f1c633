"""Characters that names and texts must not contain; the oracle is the table of Unicode of this Python."""

import sys
import unicodedata

import pytest

from rmpc_bench.received.names import HIDDEN
from rmpc_bench.types.texts import refused_in_name, refused_in_text, visible


@pytest.fixture(scope="module")
def every():
    """All characters of Unicode."""
    return [chr(code) for code in range(sys.maxunicode + 1)]


def test_a_name_has_no_character_that_cannot_be_seen(every):
    """Controls, formats, surrogates and line separators; letters, marks and blanks of every script are allowed."""
    refused = [each for each in every if refused_in_name(f"K{each}F")]
    assert refused == [each for each in every if unicodedata.category(each) in ("Cc", "Cf", "Cs", "Zl", "Zp")]
    assert not refused_in_name("Kálmán\u00a0$c_1$, 卡尔曼, क़")


def test_a_text_may_have_lines_and_joiners(every):
    """Its other controls, and all characters of direction, are refused."""
    marks = {*"LRE RLE LRO RLO PDF LRI RLI FSI PDI".split()}
    direction = [each for each in every if unicodedata.bidirectional(each) in marks]
    refused = {each for each in every if refused_in_text(each)}
    controls = {each for each in every if unicodedata.category(each) == "Cc"} - {"\n", "\t"}
    assert controls | {*direction, "\u200e", "\u200f", "\u061c"} <= refused
    assert not refused & {"\n", "\t", "\u200d", "\u200c", "\u200b", "é"}


@pytest.mark.parametrize("kind, character", [("control", "\x9b"), ("direction", "\u2067"), ("invisible", "\u200b")])
def test_the_message_names_the_character(kind, character):
    """By its code, since it cannot be shown."""
    assert refused_in_name(f"a{character}") == f"contains the {kind} character U+{ord(character):04X}; leave it out"


def test_what_is_shown_can_be_shown(every):
    """A screen gets escapes; a second pass changes nothing."""
    shown = visible("a\x1b]0;pwn\x07\tb\u202e\n\udc80")
    assert shown == "a\\x1b]0;pwn\\x07\tb\\u202e\n\\udc80"
    assert visible(shown) == shown
    assert not any(refused_in_text(visible(each)) for each in every)


def test_stored_files_refuse_the_same_characters(every):
    """Otherwise results of an accepted configuration could not be read again."""
    assert HIDDEN.findall("".join(every)) == [each for each in every if refused_in_text(each)]
