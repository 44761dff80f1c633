"""Errors of a user's file: what a configuration shows of them, and that none is an error of the bench."""

import os
import signal

import pytest
from own_files import ESTIMATOR, write
from small_experiment import cli

from rmpc_bench import load_config
from rmpc_bench.types import ConfigError

BROKEN = {
    "a file that is not there": (
        {},
        "{file: onw.py:Own}",
        "tiny.yaml:13:68: methods.Own.estimator.file: there is no file onw.py; did you mean 'own.py'?",
    ),
    "a directory": ({"sub.py/x": ""}, "{file: sub.py:Own}", "methods.Own.estimator.file: sub.py is a directory"),
    "a name that is not there": ({}, "{file: own.py:Onw}", "'Onw' is not a known name in own.py; did you mean 'Own'?"),
    "a name inside a class": ({}, "{file: own.py:Own.x}", "'Own.x' is not a known name in own.py:Own; known: "),
    "a module": (
        {},
        "{file: own.py:np}",
        "own.py:np: an estimator is a class or a function; this is an object of type",
    ),
    "a number": ({"own.py": "Own = 3"}, "{file: own.py:Own}", "this is an object of type int"),
    "a class that is no component": (
        {"own.py": "class Own:\n    def update(self, y): ..."},
        "{file: own.py:Own}",
        "Own is not marked: write @single_run above the class",
    ),
    "a component of another group": (
        {"own.py": "from rmpc_bench import Controller\nclass Own(Controller): ..."},
        "{file: own.py:Own}",
        "methods.Own.estimator.file: own.py:Own: Own is a Controller, no estimator",
    ),
    "a function that makes something else": (
        {"own.py": "def Own(model): return 3"},
        "{file: own.py:Own}",
        "methods.Own.estimator.file: the estimator 'own.py:Own' is an object of type int",
    ),
    "a syntax error": (
        {"own.py": "x = 1\ny = (2,\n"},
        "{file: own.py:Own}",
        "own.py:2:5: SyntaxError: '(' was never closed",
    ),
    "a syntax error in a file beside it": (
        {"own.py": "import other\n", "other.py": "\n\ndef f(:\n"},
        "{file: own.py:Own}",
        "other.py:3:7: SyntaxError: invalid syntax",
    ),
    "an error at import": (
        {"own.py": "import numpy as np\n\ndef f():\n    return np.linalg.inv([[0.0]])\n\nf()\n"},
        "{file: own.py:Own}",
        "own.py:4:12: LinAlgError: Singular matrix",
    ),
    "an error in a file beside it": (
        {"own.py": "import other\n", "other.py": "1 / 0\n"},
        "{file: own.py:Own}",
        "other.py:1:1: ZeroDivisionError: division by zero",
    ),
    "a library that is not installed": (
        {"own.py": "import no_such_library\n"},
        "{file: own.py:Own}",
        "own.py:1:1: ModuleNotFoundError: No module named 'no_such_library'",
    ),
    "an unknown annotation": (
        {"own.py": "from __future__ import annotations\ndef Own(model, *, c: Nothing = 1): ..."},
        "{file: own.py:Own}",
        "own.py:1:1: NameError: name 'Nothing' is not defined",
    ),
    "an error when it is made": (
        {
            "own.py": ESTIMATOR.replace(
                "        self.model,", "        raise OSError('no licence')\n        self.model,"
            )
        },
        "{file: own.py:Own}",
        "methods.Own.estimator: own.py:17: OSError: no licence",
    ),
    "a key that its own check refuses": (
        {
            "own.py": ESTIMATOR.replace(
                "        self.model,",
                "        from rmpc_bench.types import DesignError\n"
                "        raise DesignError('must be small', 'gain')\n        self.model,",
            )
        },
        "{file: own.py:Own, gain: 3}",
        "tiny.yaml:13:86: methods.Own.estimator.gain: must be small",
    ),
    "an error without a text": ({"own.py": "raise ValueError"}, "{file: own.py:Own}", "own.py:1:1: ValueError"),
    "an error whose text fails": (
        {"own.py": "class E(Exception):\n    def __str__(self): 1 / 0\nraise E"},
        "{file: own.py:Own}",
        "own.py:3:1: E",
    ),
    "the end of the program": (
        {"own.py": "import sys\nsys.exit(3)"},
        "{file: own.py:Own}",
        "own.py:2:1: SystemExit: 3",
    ),
    "an interruption of its own": (
        {"own.py": "raise KeyboardInterrupt"},
        "{file: own.py:Own}",
        "own.py:1:1: KeyboardInterrupt",
    ),
    "an error of the operating system": (
        {"own.py": "open('no such file')"},
        "{file: own.py:Own}",
        "own.py:1:1: FileNotFoundError: [Errno 2] No such file or directory: 'no such file'",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_one_problem_with_its_place(tmp_path, monkeypatch, case):
    """The place is in the Python file where its code is wrong, else in the configuration."""
    files, estimator, message = BROKEN[case]
    path = write(tmp_path, {"own.py": ESTIMATOR, **files} if "own.py" not in files else files, estimator=estimator)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        load_config(path.name)
    (problem,) = caught.value.problems
    assert message in str(problem)


def test_all_problems_at_once(tmp_path, monkeypatch):
    """A broken file is reported once, beside the other errors of the configuration."""
    broken = "A: {estimator: {file: bad.py:A}}, B: {estimator: {file: bad.py:B}}"
    methods = f"{{{broken}, C: {{estimator: {{file: own.py:Own, gian: 1}}}}}}"
    path = write(tmp_path, {"bad.py": "1 / 0"}, methods=methods, runs=0)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        load_config(path.name)
    assert [str(problem).partition(": ")[2] for problem in caught.value.problems] == [
        "ZeroDivisionError: division by zero",
        "runs: must be >= 1 (got 0)",
        "methods.C.estimator.gian: 'gian' is not a known key; did you mean 'gain'?",
    ]


def test_interruption_by_the_user_ends_the_program(tmp_path):
    """Ctrl-C while a file is imported in this process is no error of the file."""
    text = f"import os, signal\nif os.getpid() == {os.getpid()}:\n    os.kill(os.getpid(), signal.SIGINT)\n"
    path = write(tmp_path, {"own.py": f"{text}    while True: pass"})
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        load_config(path)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("verb", ["check", "run", "describe"])
def test_exit_code(tmp_path, monkeypatch, verb):
    """The message alone, and exit 2."""
    write(tmp_path, {"own.py": "raise OSError('gone')"})
    monkeypatch.chdir(tmp_path)
    result = cli(verb, "tiny.yaml")
    assert result.exit_code == 2
    assert result.stderr.splitlines()[1:] == ["own.py:1:1: OSError: gone"]


@pytest.mark.parametrize(
    "member",
    ["remarks = property(lambda self: 1 / 0)", "def warm_up(self): 1 / 0", "reports = property(lambda self: 1 / 0)"],
)
def test_an_error_of_the_user_is_never_one_of_the_bench(tmp_path, monkeypatch, member):
    """Also where the bench asks a design outside a run."""
    write(tmp_path, {"own.py": f"{ESTIMATOR}\n    {member}\n"})
    monkeypatch.chdir(tmp_path)
    results = [cli("check", "tiny.yaml"), cli("run", "tiny.yaml", "-o", "out", "-j", 1, "--progress", "none")]
    assert 2 in {result.exit_code for result in results}
    for result in results:
        assert "please report" not in result.stderr and result.exit_code in (0, 2)
        assert result.exit_code == 0 or "own.py:30: ZeroDivisionError: division by zero" in result.stderr


def test_a_file_that_is_corrected_is_loaded_again(tmp_path):
    """As in a notebook, in the same process and within the same second."""
    path = write(tmp_path, {"own.py": "1 / 0"})
    with pytest.raises(ConfigError):
        load_config(path)
    (tmp_path / "own.py").write_text(ESTIMATOR)
    assert load_config(path).experiment.method("Own").estimator.gain == 0.1
    (tmp_path / "own.py").write_text(ESTIMATOR.replace("= 0.1", "= 0.2"))
    assert load_config(path).experiment.method("Own").estimator.gain == 0.2


def test_keys_with_names_of_pydantic_methods(tmp_path):
    """No warning, and the key has its value."""
    text = ESTIMATOR.replace("gain: Positive = 0.1", "gain: Positive = 0.1, copy: int = 1, **rest")
    text = text.replace("        self.model,", "        self.copied = copy\n        self.model,")
    path = write(tmp_path, {"own.py": text}, estimator="{file: own.py:Own, copy: 3}")
    assert load_config(path).experiment.method("Own").estimator.copied == 3
