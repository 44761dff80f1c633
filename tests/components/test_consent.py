"""Which Python files a configuration may load, and that each is named before its code runs."""

import os
import subprocess
import sys

import pytest
from own_files import ESTIMATOR, own_estimator, write
from small_experiment import cli

from rmpc_bench import load_config
from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.types import ConfigError


def message(path, **options):
    """Return the only error of a configuration."""
    with pytest.raises(ConfigError) as caught:
        load_config(path, **options)
    (problem,) = caught.value.problems
    return problem.message


def test_every_file_is_named_before_any_code_runs(tmp_path, monkeypatch, capsys):
    """In one line on stderr, with a short hash; once per process as long as the file does not change."""
    files = {"own.py": "import sys\nprint('runs', file=sys.stderr)\n" + ESTIMATOR, "sub/more.py": ESTIMATOR}
    methods = "{A: {estimator: {file: own.py:Own}}, B: {estimator: {file: sub/more.py:Own}, label: 'x.py:B'}}"
    path = write(tmp_path, files, methods=methods)
    monkeypatch.chdir(tmp_path)
    load_config(path)
    first, *rest = capsys.readouterr().err.splitlines()
    assert rest == ["runs"]
    words = first.split()
    assert words[::3] == ["code", "sha"] or words[0] == "code"
    assert [word for word in words if word.endswith(".py")] == ["own.py", "sub/more.py"]
    assert all(len(word) == 7 and int(word[:6], 16) >= 0 for word in words if word.endswith(")"))
    load_config(path)
    assert capsys.readouterr().err == ""
    (tmp_path / "sub" / "more.py").write_text(ESTIMATOR.replace("0.1", "0.2"))
    load_config(path)
    assert capsys.readouterr().err.startswith("code  sub/more.py (sha ")


def test_a_file_outside_the_directory_needs_consent(tmp_path, monkeypatch):
    """With the way out: the file, or a directory above it."""
    write(tmp_path / "lib")
    path = write(tmp_path / "here", estimator="{file: ../lib/own.py:Own}")
    monkeypatch.chdir(tmp_path)
    said = message(path)
    assert said == (
        "../lib/own.py is outside the directory of the configuration; its code runs only if you allow it: "
        "--allow-code lib/own.py"
    )
    for allowed in ("lib/own.py", "lib", tmp_path):
        assert own_estimator(path, allow_code=[allowed]).gain == 0.1
    assert "--allow-code" in message(path, allow_code=["here", "lib/own.p"])
    absolute = write(tmp_path / "here", estimator=f"{{file: {tmp_path}/lib/own.py:Own}}")
    assert "--allow-code lib/own.py" in message(absolute)


def test_data_files_have_the_order_of_their_names(tmp_path):
    """Run i gets file i.  Traps: the order of what links point to, and a directory with the letters of a pattern."""
    home = tmp_path / "a [b]"
    home.mkdir()
    for name, target in (("1.csv", "z.txt"), ("2.csv", "a.txt"), ("3.csv", "z.txt")):
        (tmp_path / target).write_text(target)
        (home / name).symlink_to(tmp_path / target)
    (home / "[x].csv").write_text("x")
    access = CodeAccess(home)
    assert [path.name for path in access.data("*[123].csv", "").paths] == ["z.txt", "a.txt", "z.txt"]
    assert [path.name for path in access.data("[x].csv", "").paths] == ["[x].csv"]


def test_symbolic_links_are_resolved_first(tmp_path):
    """A link below the directory to a file outside is outside; one that leads back inside is inside."""
    write(tmp_path / "lib")
    path = write(tmp_path / "here", estimator="{file: link.py:Own}")
    (tmp_path / "here" / "link.py").symlink_to(tmp_path / "lib" / "own.py")
    assert "outside the directory" in message(path)
    (tmp_path / "here" / "link.py").unlink()
    (tmp_path / "here" / "link.py").symlink_to("own.py")
    assert own_estimator(path).gain == 0.1
    (tmp_path / "alias").symlink_to(tmp_path / "here", target_is_directory=True)
    assert own_estimator(tmp_path / "alias" / "tiny.yaml").gain == 0.1


def test_a_linked_configuration_allows_the_directory_of_the_link(tmp_path):
    """The directory that the user names, since names are relative to it."""
    path = write(tmp_path / "here")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "own.yaml").symlink_to(path)
    assert "there is no file own.py" in message(tmp_path / "there" / "own.yaml")


def test_a_configuration_from_a_pipe_loads_no_code(tmp_path):
    """Such as stdin: it is no regular file, and has no directory whose code could be allowed."""
    path = write(tmp_path)
    read, writing = os.pipe()
    with os.fdopen(writing, "w") as pipe:
        pipe.write(path.read_text())
    try:
        said = message(f"/dev/fd/{read}")
    finally:
        os.close(read)
    assert said == "cannot be read: is not a regular file"


def test_the_environment_refuses_all_code(tmp_path, monkeypatch):
    """Whatever else is allowed; no line of the file runs."""
    path = write(tmp_path, {"own.py": "raise SystemExit('has run')"}, plugins="[own.py]")
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "1")
    assert message(path, allow_code=[tmp_path]) == (
        "own.py: Python files are not loaded, because RMPC_BENCH_NO_CODE=1 is set"
    )
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "0")
    assert "SystemExit" in message(path)


def test_nothing_runs_before_consent(tmp_path, monkeypatch):
    """A plugin and a component outside: exit 2, and neither file has run."""
    mark = tmp_path / "ran"
    write(tmp_path / "lib", {"own.py": f"open({str(mark)!r}, 'w')"})
    path = write(tmp_path / "here", plugins="[../lib/own.py]", estimator="{file: ../lib/own.py:Own}")
    result = cli("run", path)
    assert result.exit_code == 2 and not mark.exists()
    assert "plugins.0: ../lib/own.py is outside" in result.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return a directory with a module that registers an estimator."""
    directory = tmp_path_factory.mktemp("site")
    text = ESTIMATOR + "\nfrom rmpc_bench import register\nregister('estimator', 'from-module', Own)\n"
    (directory / "own_parts.py").write_text(text)
    (directory / "own_broken.py").write_text("import math\n1 / 0\n")
    return directory


def test_import_of_a_module_that_registers(tmp_path, installed):
    """Its names are kinds, in worker processes too; `list` shows them."""
    path = write(tmp_path, estimator="{kind: from-module}")
    command = [sys.executable, "-m", "rmpc_bench", "run", path.name, "--import", "own_parts", "-o", "out", "-j", "2"]
    paths = os.pathsep.join([str(installed), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*command, "-s", "execution.block=2", "--progress", "none"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "code " not in done.stderr


def test_import_that_fails(installed, monkeypatch):
    """An error of the command line, with the line of the module."""
    monkeypatch.syspath_prepend(installed)
    result = cli("list", "estimators", "--import", "own_broken")
    assert result.exit_code == 2
    assert f"own_broken cannot be imported at {installed / 'own_broken.py'}:2 (ZeroDivisionError" in result.stderr
    result = cli("check", "--import", "no_such_module", "x.yaml")
    assert result.exit_code == 2 and "no_such_module cannot be imported (ModuleNotFoundError" in result.stderr


def test_allow_code_of_the_command_line(tmp_path, monkeypatch):
    """The option of every verb that loads a configuration, also for its second look at the file."""
    write(tmp_path / "lib")
    path = write(tmp_path / "here", estimator="{file: ../lib/own.py:Own}")
    monkeypatch.chdir(tmp_path)
    assert cli("check", path).exit_code == 2
    options = ["--allow-code", "lib"]
    assert cli("check", path, *options).exit_code == 0
    assert cli("describe", path, *options).exit_code == 0
    result = cli("run", path, *options, "-s", "seed=3", "-n")
    assert result.exit_code == 0 and "8 of 8 trials to compute" in result.stdout, result.output
    assert cli("check", path, "--allow-code", "no").exit_code == 2
