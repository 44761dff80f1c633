"""An old number is never used for new code: what an edit of a user's file computes again, and what it does not."""

import pytest
from small_experiment import cli, write
from stored_rows import n_stored

from rmpc_bench import load_config, load_trials

FILTERS = '''
"""Filters for one run."""
import math

from rmpc_bench import single_run


class Observer:
    """An observer with a constant gain."""

    def __init__(self, model, c: float = 0.5):
        self.model, self.c = model, c

    def start(self, x0, P0):
        self.x = x0

    def update(self, y, u_previous):
        if u_previous is not None:
            self.x = self.model.A @ self.x + self.model.B @ u_previous
        self.x = self.x + self.correction(y)
        return self.x

    def correction(self, y):
        return self.c * (y - self.model.C @ self.x)[0] * self.model.C[0]


@single_run
class Plain(Observer):
    pass


@single_run
class Tuned(Observer):
    def correction(self, y):
        from tables import gain

        return gain * Observer.correction(self, y)
'''
TABLES = "from helpers.numbers import number\n\ngain = 0.5 * number\n"
LIMITED = """
from rmpc_bench import single_run


@single_run
class Limited:
    def __init__(self, K: float = 0.1):
        self.K = K

    def control(self, x_hat, r):
        return [self.K * (r.flat[0] - x_hat[0])]
"""
METHODS = """{Kalman: {estimator: {kind: kalman}},
  Plain: {estimator: {file: filters.py:Plain}}, Tuned: {estimator: {file: filters.py:Tuned, c: 0.9}},
  Limited: {estimator: {kind: kalman}, controller: {file: law.py:Limited}}}"""


@pytest.fixture(scope="module", autouse=True)
def no_first_calls():
    """Leave out the calls before any run, which nothing here is about."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rmpc_bench.config.own_code.FirstCalls.estimates", lambda *_: {})
        yield


@pytest.fixture
def own(tmp_path):
    """Return a configuration with methods of two files and their neighbours."""
    (tmp_path / "helpers").mkdir()
    (tmp_path / "helpers" / "numbers.py").write_text("number = 1.0\n")
    for name, text in {"filters.py": FILTERS, "tables.py": TABLES, "law.py": LIMITED}.items():
        (tmp_path / name).write_text(text)
    return write(tmp_path, methods=METHODS, runs=3)


def edit(file, before, after):
    """Replace a text in a file."""
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after))


def keys(path):
    """Keys of the trials by method."""
    return load_config(path).points[0].method_keys


def changed(path, before):
    """Methods with other keys than before."""
    return {name for name, key in keys(path).items() if key != before[name]}


def ran(path, out, *options, code=0):
    """Run in this process or one worker; return the lines of stderr about changed files."""
    result = cli("run", path, "-o", out, "-j", 1, "--progress", "none", *options)
    assert result.exit_code == code, result.output
    return [line for line in result.stderr.splitlines() if not line.startswith("code ")]


def n_rows(out):
    """Number of stored trials."""
    return n_stored(out)


@pytest.mark.parametrize(
    ("file", "before", "after", "methods"),
    [
        ("filters.py", "        self.x = x0", "        self.x  =  (x0)  # the start", set()),
        ("filters.py", "An observer with a constant gain.", "A Luenberger observer.", set()),
        ("filters.py", "class Plain(Observer):\n    pass", "class Plain(Observer):\n    '''As it is.'''", set()),
        ("filters.py", "return gain *", "return 2 * gain *", {"Plain", "Tuned"}),
        ("tables.py", "0.5", "0.9", {"Plain", "Tuned"}),
        ("helpers/numbers.py", "1.0", "2.0", {"Plain", "Tuned"}),
        ("helpers/numbers.py", "1.0", "1.0  # one", set()),
        ("law.py", "x_hat[0]", "x_hat[-1]", {"Limited"}),
    ],
)
def test_an_edit_changes_the_keys_of_the_methods_of_its_file(own, file, before, after, methods):
    """Comments, layout and docstrings do not; a neighbour does, also one that is imported inside a function."""
    known = keys(own)
    edit(own.parent / file, before, after)
    assert changed(own, known) == methods


@pytest.mark.long
def test_only_what_changed_is_computed_again_and_it_is_said(own, tmp_path):
    """The old rows are kept and enter no table; the old code finds them again."""
    out = tmp_path / "out"
    ran(own, out)
    assert n_rows(out) == 12
    first = load_trials(out).frame
    edit(own.parent / "tables.py", "0.5", "0.9")
    said = " has changed since 3 runs were stored: computing them again (old ones kept)"
    assert ran(own, out) == [f"{name}: tables.py{said}" for name in ("Plain", "Tuned")]
    assert n_rows(out) == 18
    second = load_trials(out).frame
    differs = second.groupby("method")["mse"].first() != first.groupby("method")["mse"].first()
    assert differs.to_dict() == {"Kalman": False, "Limited": False, "Plain": False, "Tuned": True}
    assert len(second) == 12 and ran(own, out) == []
    edit(own.parent / "tables.py", "0.9", "0.5")
    assert ran(own, out) == [] and n_rows(out) == 18
    assert load_trials(out).frame.equals(first)


@pytest.mark.long
def test_more_runs_after_an_edit(own, tmp_path):
    """No row of the old code is in the table of ten runs."""
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    ran(own, out)
    edit(own.parent / "law.py", "K: float = 0.1", "K: float = 0.2")
    ran(own, out, "--runs", 5)
    ran(own, fresh, "--runs", 5)
    assert (out / "trials.csv").read_bytes() == (fresh / "trials.csv").read_bytes()


def test_an_edit_of_an_estimator_in_the_file_of_the_plant_is_no_other_experiment(tmp_path):
    """The part of the file on which the plant depends identifies the experiment; the files of `init` are such ones."""
    from rmpc_bench.cli.init import starter

    for name, text in starter("tanks", "ode", "plain", "plain").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    config, module = tmp_path / "tanks.yaml", tmp_path / "tanks.py"
    text = module.read_text(encoding="utf-8")
    before = load_config(config, smoke=True).points[0]
    module.write_text(text.replace("L1: float = 0.2", "L1: float = 0.3"), encoding="utf-8")
    edited = load_config(config, smoke=True).points[0]
    assert edited.experiment_hash == before.experiment_hash
    assert edited.metric_keys == before.metric_keys
    assert edited.method_keys["Observer"] != before.method_keys["Observer"]
    module.write_text(text.replace("GRAVITY = 9.81", "GRAVITY = 9.82"), encoding="utf-8")
    assert load_config(config, smoke=True).points[0].experiment_hash != before.experiment_hash
