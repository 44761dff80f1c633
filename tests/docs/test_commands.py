"""Every command of README and guide works; options and targets exist.

test_generated_pages.py runs those of README.md, since it compares what they print.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from docs.followed_page import BLOCK, FOLLOWED, README
from jsonschema import Draft7Validator

from rmpc_bench.cli import main
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.schema.json_schema import json_schema

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
ELSEWHERE = (
    *(page.name for page in FOLLOWED),
    "cluster.md",
    "suite.md",
    "own-components.md",
    "libraries.md",
    "constraints.md",
)
"""Pages with commands that other files of this folder follow."""
COMMAND = re.compile(r"`(rmpc-bench [^`\n]+)`|^\$ (rmpc-bench .+)$|^(rmpc-bench [^#\n]+)", re.MULTILINE)
LONGEST = 120
"""Lines of README.md."""


def read(page):
    return page.read_text(encoding="utf-8")


def commands(page):
    """Commands in code and in blocks; those of a usage line with brackets are no commands."""
    found = ["".join(groups).strip() for groups in COMMAND.findall(read(page))]
    return [line for line in found if "[" not in line and not line.startswith(("rmpc-bench --", "rmpc-bench VERB"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_verbs_and_options_exist(page):
    group = click.Context(main)
    for line in commands(page):
        verb, *arguments = shlex.split(line.replace("\\|", "|"))[1:]
        command = main.get_command(group, verb)
        assert command is not None, line
        context = click.Context(command, **main.context_settings)
        known = {name for param in command.get_params(context) for name in param.opts}
        options = {argument.partition("=")[0] for argument in arguments if re.match(r"--?[a-z]", argument)}
        assert options <= known, (line, options - known)


def test_commands_are_found():
    assert "rmpc-bench run servo.yaml" in commands(README)
    assert len(commands(ROOT / "docs" / "experiments.md")) > 5


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_targets_of_make_exist(page):
    makefile = read(ROOT / "Makefile")
    targets = {name for line in re.findall(r"^([a-z0-9 -]+):.*##", makefile, re.MULTILINE) for name in line.split()}
    asked = re.findall(r"`make ([a-z0-9-]+)`|^make ([a-z0-9-]+)", read(page), re.MULTILINE)
    assert {"".join(names) for names in asked} <= targets


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_writes_no_file_outside_its_directory(page):
    """A block with a path would be none for `BLOCK`."""
    named = re.findall(r"^ *```\w+ (.+)$", read(page), re.MULTILINE)
    assert [name for name in named if not re.fullmatch(r"\w[\w.-]*", name)] == []


def test_every_page_with_commands_is_followed():
    pages = {page.name for page in PAGES if "console" in {language for language, _, _ in BLOCK.findall(read(page))}}
    assert pages == {*ELSEWHERE}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_yaml_follows_the_schema(page, tmp_path):
    """Parts of a configuration; whole ones are loaded by the tests of their pages."""
    parts = [text for language, name, text in BLOCK.findall(read(page)) if language == "yaml" and not name]
    schema = json_schema() if parts else {}
    for text in parts:
        (tmp_path / "part.yaml").write_text(text, encoding="utf-8")
        for key, value in plain(load(tmp_path / "part.yaml")).items():
            part = {**schema["properties"][key], "definitions": schema["definitions"]}
            assert Draft7Validator(part).is_valid(value), (key, value)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_python_is_valid(page):
    """Files are run by the commands that use them; fragments are compiled."""
    for block in re.findall(r"^( *)```python[^\n]*\n(.*?)^ *```", read(page), re.MULTILINE | re.DOTALL):
        indent, text = block
        compile(re.sub(rf"^{indent}", "", text, flags=re.MULTILINE), str(page), "exec")


def test_the_readme_is_short():
    assert len(read(README).splitlines()) <= LONGEST


@pytest.fixture
def checkout(tmp_path):
    """Return a directory with what the commands of a clone need, and a stand-in for its virtual environment."""
    shutil.copytree(ROOT / "configs", tmp_path / "configs", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv" / "bin").symlink_to(Path(sys.executable).parent)
    (tmp_path / ".venv" / ".installed-dev").touch()
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", [README, ROOT / "docs" / "tutorial.md"], ids=lambda page: page.stem)
def test_commands_of_a_clone(page, checkout):
    """`make test` is what runs this test, and the environment is that of the tests: .ci/run makes a new one."""
    blocks = [text for language, _, text in BLOCK.findall(read(page)) if language == "sh"]
    environment = {**os.environ, "PATH": f"{checkout / '.venv' / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    lines = [line.partition(" #")[0].strip() for block in blocks for line in block.splitlines()]
    assert len(lines) >= 2
    for line in lines:
        command = line.replace("make test", "make --dry-run test")
        done = subprocess.run(["sh", "-c", command], cwd=checkout, capture_output=True, text=True, env=environment)
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
