"""Names of a configuration and of a stored layout follow the same rules."""

import re

import pytest
from small_experiment import cli, write

from rmpc_bench.received.names import wrong_experiment, wrong_method, wrong_metric, wrong_text

HIDDEN = ["\x1b", "\x07", "\x7f", "\x9b", "\u061c", "\u202e", "\u2066", "\ud800"]


@pytest.mark.parametrize("character", HIDDEN)
def test_hidden_characters(character):
    """In no text, hence in no name."""
    for rule in (wrong_text, wrong_method, wrong_experiment, wrong_metric):
        assert rule(f"a{character}b") and rule(f"a{character}b").isprintable()


def test_names_that_are_good():
    """As papers write them, in any script."""
    for name in ("R-MPC", "KF", "\u03b8 = 0.1", "\u05d0\u05d1", "a/b", "=1+1|../../x", "<b>"):
        assert wrong_method(name) == ""
    assert (
        wrong_text("two\nlines\tand a tab") == "" and wrong_experiment("a.b-c_1") == "" and wrong_metric("mse_2") == ""
    )


@pytest.mark.parametrize("name", ["", "..", ".a", "-a", "a/b", "/a", "a b", "a\n", "\u0661", 7, None])
def test_names_of_directories(name):
    """Nothing that leads elsewhere."""
    assert wrong_experiment(name)


@pytest.mark.parametrize("escape", ["\\e", "\\x07", "\\u202E", "\\u2066", "\\x9b"])
@pytest.mark.parametrize(
    "keys",
    [
        {"methods": '{"a$b": {estimator: {kind: kalman}}}'},
        {"title": '"a$b"'},
        {"methods": '{S-MPC: {estimator: {kind: kalman}, label: "a$b"}}'},
    ],
)
def test_escapes_in_a_configuration(tmp_path, escape, keys):
    """YAML can write any character; the place and the character are named."""
    result = cli("check", write(tmp_path, **{key: text.replace("$", escape) for key, text in keys.items()}))
    assert result.exit_code == 2 and "tiny.yaml:" in result.stderr
    assert (
        re.search(r"contains the (control|direction) character U\+", result.stderr)
        and result.stderr.replace("\n", "").isprintable()
    )
