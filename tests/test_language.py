"""No retired phrase in a text that a user reads; the list is `retired_phrases.txt`, one phrase per line."""

import ast
import re
from functools import cache
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from config.test_config_errors import CASES
from small_experiment import write

from rmpc_bench import load_config, registry
from rmpc_bench.cli import main
from rmpc_bench.types import ConfigError

ROOT = Path(__file__).parent.parent
PHRASES = (ROOT / "tests" / "retired_phrases.txt").read_text(encoding="utf-8").splitlines()
PLANTS = ("quickstart", "zenere2018/sim1", "benchmarks/ma2025", "benchmarks/souto2011", "benchmarks/moving-slide")
DOCUMENTS = (
    "*.md",
    "docs/**/*.md",
    "paper/*.md",
    "Makefile",
    "pyproject.toml",
    "configs/**/*.yaml",
    "results/**/claims.md",
)


@cache
def pattern() -> re.Pattern[str]:
    """All phrases, as whole words, in any case, also across a line break."""
    words = (r"\s+".join(re.escape(word) for word in phrase.split()) for phrase in PHRASES)
    return re.compile(rf"(?<!\w)(?:{'|'.join(words)})(?!\w)", re.IGNORECASE)


def retired(text: str, source: str, line: int = 1) -> list[str]:
    """Every retired phrase of a text, with the place of its begin."""
    return [
        f"{source}:{line + text.count(chr(10), 0, match.start())}: {' '.join(match[0].split())}"
        for match in pattern().finditer(text)
    ]


def report(found: list[str]) -> str:
    return "\n".join(["retired phrases (tests/retired_phrases.txt):", *found])


def test_the_list_is_sorted_and_has_no_empty_line():
    assert sorted(set(PHRASES)) == PHRASES and all(phrase == phrase.strip() != "" for phrase in PHRASES)


def test_a_phrase_is_found_in_any_case_and_across_lines():
    """Oracle: written by hand; a part of a longer word does not count."""
    assert retired("x\nThe filter Is\n  told nothing", "a.md") == ["a.md:2: Is told"]
    assert retired("its own Pi, untruths", "a.md") == []


@pytest.mark.parametrize("glob", DOCUMENTS)
def test_documents(glob):
    files = sorted(ROOT.glob(glob))
    found = [hit for file in files for hit in retired(file.read_text("utf-8"), str(file.relative_to(ROOT)))]
    assert files and not found, report(found)


def test_every_file_of_the_map_exists():
    """docs/design.md names folders and files as `config/load.py`, below rmpc_bench."""
    text = (ROOT / "docs" / "design.md").read_text("utf-8").split("## Where each subject is")[1].split("\n## ")[0]
    names = re.findall(r"`([a-z_]+(?:/[a-z_]+)*(?:/|\.py))`", text)
    names += re.findall(r"(?<![\w/])([a-z_]+/)(?![\w/])", text.split("```")[1])
    assert len(names) > 20 and [name for name in names if not (ROOT / "rmpc_bench" / name).exists()] == []


def test_docstrings_and_messages():
    """All string literals of the package: docstrings, help, screen texts, error messages, texts drawn in figures."""
    found = []
    for file in sorted((ROOT / "rmpc_bench").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found += retired(node.value, str(file.relative_to(ROOT)), node.lineno)
    assert not found, report(found)


def output(*arguments: str) -> str:
    """What a verb prints."""
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    return result.output


def test_help_of_every_verb():
    with click.Context(main) as context:
        verbs = main.list_commands(context)
    texts = {"": output("--help"), **{verb: output(verb, "--help") for verb in verbs}}
    found = [hit for verb, text in texts.items() for hit in retired(text, f"rmpc-bench {verb} --help")]
    assert not found, report(found)


def test_describe_of_every_kind_and_of_a_configuration_per_plant():
    """The own texts of all other configurations are among the documents."""
    names = [f"{group}/{kind}" for group in registry.BUILT_IN for kind in registry.names(group)]
    names += [str(ROOT / "configs" / f"{name}.yaml") for name in PLANTS]
    found = [hit for name in names for hit in retired(output("describe", name), f"describe {name}")]
    found += retired(output("list", "functions"), "list functions")
    assert not found, report(found)


def test_messages_of_bad_configurations(tmp_path):
    """The mistakes of tests/config/test_config_errors.py, one at a time."""
    found = []
    for key, value, *_ in CASES:
        with pytest.raises(ConfigError) as caught:
            load_config(write(tmp_path, **{key: value}))
        found += retired(str(caught.value), f"{key}: {value}")
    assert not found, report(found)
