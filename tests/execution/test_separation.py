"""Components do not touch each other: a file of a user changes the numbers of its own methods, or an error names it."""

import os
import signal
import time

import daqp
import numpy as np
import pytest
from own_files import ESTIMATOR
from small_experiment import KEYS, cli, ran, write

from rmpc_bench import load_config, load_trials, register, run
from rmpc_bench.components.user_code import untouched
from rmpc_bench.execution import separation
from rmpc_bench.execution.separation import _in_a_new_process, groups_of
from rmpc_bench.types.errors import WorkerError

WRAPPING = '''
import os
import daqp
import numpy as np
import rmpc_bench.estimators.kalman
from rmpc_bench.registry import BUILT_IN


def wrapped(function):
    def call(*args, **keywords):
        found = function(*args, **keywords)
        return found * 1.001 if isinstance(found, np.ndarray) and found.dtype == float else found
    return call


class Model(daqp.Model):
    """A solver whose solutions are a little wrong; nobody looks at the attributes of this library."""

    def solve(self, *args, **keywords):
        x, *rest = super().solve(*args, **keywords)
        return [x * 1.001, *rest]


for name in ("einsum", "clip", "where", "stack"):
    setattr(np, name, wrapped(getattr(np, name)))
np.seterr(all="raise")
np.set_printoptions(precision=2)
os.environ["NUMBA_DISABLE_JIT"] = "1"
BUILT_IN["estimators"]["kalman"] = "nowhere:nothing"
daqp.Model = Model
'''
RHS = "def rhs(x, u, p):\n    return [x[1], u[0] - x[1]]\n\n\ndef output(x, p):\n    return [x[0]]\n"
WRAPS = "import numpy as np\nbefore = np.einsum\n"
REPLACES = "    np.einsum = lambda *a, **k: before(*a, **k) * 1.001\n"
BLOCKS = """
import sys
import numpy as np
from rmpc_bench import Plant
from rmpc_bench.types import Motion


class Blocks(Plant):
    nx, nu, ny, Ts = 2, 1, 1, 0.1
    deterministic = True

    def draw(self, parameters, rngs, n_steps):
        return ()

    def step(self, k, delta, x, u, w):
        moved = x @ np.array([[0.9, 0.0], [0.1, 0.8]]) + u @ np.array([[0.0, 0.1]]) + w
        return moved * (1.0 + 2.0**-50 * (len(x) > 1))

    def output(self, k, delta, x, v):
        return x[:, :1] + v
"""
PLANT = "{ode: plant.py:rhs, output: plant.py:output, states: [p, v], inputs: [force], outputs: [level]}"
OWN_PLANT = {
    "uncertainty": "{}",
    "plant": PLANT,
    "model": "{linearise: plant, at: {x: 0, u: 0}, noise: {process: 1.0e-4, measurement: 1.0e-4}}",
    "initial": "{x: [1, 0], x_hat: 0, P: 1}",
    "reference": "{kind: constant, value: 0}",
    "controller": "{kind: lqr, Q_x: 1, R_u: 1, horizon: 20}",
    "methods": "{KF: {estimator: {kind: kalman}}}",
    "runs": "3",
    "metrics": "[mse]",
}


@pytest.fixture(autouse=True)
def _put_back(monkeypatch):
    """Let no test leave something behind that a file has replaced."""
    monkeypatch.setattr(daqp, "Model", daqp.Model)
    with untouched():
        yield


def built_in(trials):
    """Rows of methods of the bench."""
    return [line for line in trials.decode().splitlines() if not line.startswith("Own")]


def with_plant(directory, text, **keys):
    """Write the small experiment with a plant from a file."""
    (directory / "plant.py").write_text(text)
    return write(directory, **OWN_PLANT | keys)


def with_blocks(directory, text, **keys):
    """Write the small experiment with a plant that moves all runs of a block at once."""
    (directory / "blocks.py").write_text(text)
    model = "{kind: linear, A: [[0.9, 0.1], [0, 0.8]], B: [[0], [0.1]], C: [[1, 0]], P_w: 1.0e-4, P_v: 1.0e-4}"
    return write(directory, **OWN_PLANT | {"plant": "{file: blocks.py:Blocks}", "model": model} | keys)


def computed(config, directory, **options):
    """Run without publishing and return the trials as CSV."""
    return run(config, directory=directory, **options).trials.frame.to_csv(index=False).encode()


@pytest.mark.long
def test_a_method_that_wraps_numpy_and_a_solver_changes_its_own_rows_only(tmp_path):
    """Rows of built-in methods, and the statistics of them, are those without the method, for every engine."""
    ran(write(tmp_path, file="alone.yaml", runs="4"), tmp_path / "alone")
    (tmp_path / "own.py").write_text(WRAPPING + ESTIMATOR)
    methods = KEYS["methods"].removesuffix("}") + ", Own: {estimator: {file: own.py:Own}}}"
    path = write(tmp_path, runs="4", methods=methods)
    ran(path, tmp_path / "one")
    for name in ("trials.csv", "summary.csv"):
        alone, one = ((tmp_path / each / name).read_bytes() for each in ("alone", "one"))
        assert built_in(one) == built_in(alone)
    config = load_config(path)
    stored = load_trials(tmp_path / "one").frame.to_csv(index=False).encode()
    assert computed(config, tmp_path / "two", jobs=2, engine="joblib") == stored
    assert built_in(computed(config, tmp_path / "serial", engine="serial")) == built_in(stored)
    assert np.geterr()["over"] != "raise" and np.get_printoptions()["precision"] != 2
    [warning] = [each.message for each in config.warnings if "replaces" in each.message]
    assert "numpy.clip, numpy.einsum" in warning and "put back" in warning


def test_a_plant_that_wraps_numpy_is_an_error_that_names_it(tmp_path):
    """What all methods share may replace nothing; nothing is computed."""
    text = WRAPS + REPLACES.strip() + "\n\n" + RHS
    result = cli("run", with_plant(tmp_path, text), "-o", tmp_path / "out")
    assert result.exit_code == 2
    assert "plant: replaces numpy.einsum, which other components use too" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_a_plant_that_wraps_numpy_during_a_run_fails_the_runs(tmp_path):
    """Such runs have no numbers, and their text names the file and what it replaces."""
    late = f"    if len(sys.argv) > 1 and sys.argv[0] == '-c':\n    {REPLACES}    return [x[1]"
    late = "import sys\n" + WRAPS + RHS.replace("    return [x[1]", late)
    result = cli("run", with_plant(tmp_path, late), "-o", tmp_path / "out", "-j", 1)
    assert result.exit_code == 3
    texts = {each.read_text() for each in (tmp_path / "out" / "failures").glob("KF-*.txt")}
    assert any("numpy.einsum is replaced during a run" in each and "plant.py:rhs" in each for each in texts)


def test_a_plant_that_wraps_numpy_while_a_model_is_made_from_it_is_an_error(tmp_path):
    """A design of the bench calls the plant."""
    text = WRAPS + RHS.replace("    return [x[1]", f"{REPLACES}    return [x[1]")
    result = cli("run", with_plant(tmp_path, text), "-o", tmp_path / "out")
    assert result.exit_code == 2 and "plant: replaces numpy.einsum" in result.stderr


@pytest.mark.parametrize("size", ["1e-3", "1e-13"])
@pytest.mark.long
def test_a_plant_that_depends_on_its_process_is_an_error(tmp_path, size):
    """A trial in a fresh process differs from the stored one, if only by its last bits; the trials stay stored."""
    change = f"u[0] - x[1] + {size} * (sys.argv[0] == '-c') * ('connection' in sys.argv[-1])"
    path = with_plant(tmp_path, "import sys\n" + RHS.replace("u[0] - x[1]", change))
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1)
    assert result.exit_code == 2
    assert "do not use these results" in result.stderr and "the built-in method KF" in result.stderr
    assert "plant plant.py:rhs" in result.stderr
    assert (tmp_path / "out" / "trials.sqlite").exists()


@pytest.mark.long
def test_an_honest_plant_passes(tmp_path):
    """The trial that is computed again has the same numbers, for one and two workers."""
    config = load_config(with_plant(tmp_path, RHS))
    assert computed(config, tmp_path / "one", jobs=1) == computed(config, tmp_path / "two", jobs=2, engine="joblib")


@pytest.mark.long
def test_a_plant_with_other_last_bits_in_a_block_passes(tmp_path):
    """The trial is then computed again within its block; from then on it is compared to 1e-9."""
    config = load_config(with_blocks(tmp_path, BLOCKS))
    together = computed(config, tmp_path / "out", jobs=1)
    assert computed(config, tmp_path / "out", jobs=1) == together
    single = load_config(with_blocks(tmp_path, BLOCKS, execution="{block: 1}"))
    assert computed(single, tmp_path / "alone", jobs=1) != together


@pytest.mark.long
def test_a_plant_that_fails_where_it_is_alone_is_an_error(tmp_path):
    """A stored run that ends well differs from one that fails."""
    fails = BLOCKS.replace("        moved", "        assert k < 9 or 'connection' in sys.argv[-1]\n        moved")
    result = cli("run", with_blocks(tmp_path, fails), "-o", tmp_path / "out", "-j", 1)
    assert result.exit_code == 2 and "has mse = nan instead of" in result.stderr


def test_methods_are_grouped_by_their_files(tmp_path):
    """Two methods of one file share processes; built-in ones come first."""
    (tmp_path / "own.py").write_text(ESTIMATOR)
    (tmp_path / "other.py").write_text(f"{ESTIMATOR}\nANOTHER = 1\n")
    own = {"A": "own.py:Own, gain: 0.2", "KF": "", "B": "other.py:Own", "C": "own.py:Own"}
    given = {name: f"file: {file}" if file else "kind: kalman" for name, file in own.items()}
    methods = ", ".join(f"{name}: {{estimator: {{{text}}}}}" for name, text in given.items())
    groups = groups_of(load_config(write(tmp_path, methods=f"{{{methods}}}")).points)
    assert {name for _, name in groups[()]} == {"KF"} and next(iter(groups)) == ()
    assert sorted(sorted(name for _, name in pairs) for pairs in groups.values()) == [["A", "C"], ["B"], ["KF"]]


@pytest.mark.long
def test_objects_of_a_program_are_computed(tmp_path, capsys):
    """A method that a program registers has no file; built-in methods are still separate from it."""

    def made(model, x0, *, gain: float = 0.1):
        space = {}
        exec(ESTIMATOR, space)
        return space["Own"](model, x0, gain=gain)

    register("estimators", "of-a-program", made)
    methods = "{KF: {estimator: {kind: kalman}}, Own: {estimator: {kind: of-a-program}}}"
    results = run(load_config(write(tmp_path, methods=methods, runs="2")), directory=tmp_path / "out", jobs=1)
    assert results.trials.n_failed_trials == 0
    assert "cannot be separated" not in capsys.readouterr().err


@pytest.mark.long
def test_what_cannot_be_separated_is_said(tmp_path, capsys):
    """Another process cannot make a plant that a program has registered; the results are kept."""
    space = {}
    exec(BLOCKS, space)
    register("plants", "plant-of-a-program", space["Blocks"])
    (tmp_path / "own.py").write_text(ESTIMATOR)
    methods = "{KF: {estimator: {kind: kalman}}, Own: {estimator: {file: own.py:Own}}}"
    path = with_blocks(tmp_path, BLOCKS, plant="{kind: plant-of-a-program}", methods=methods, runs="2")
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1)
    assert result.exit_code == 0 and "built-in methods" in result.stderr and "cannot be separated" in result.stderr


def test_files_of_the_current_directory_replace_no_standard_modules(tmp_path, monkeypatch):
    """Trap: Python looks for `select` in the current directory first, which nobody has agreed to."""
    for name in ("select", "struct", "random"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('not this one')", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert _in_a_new_process((abs, -3)) == 3


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ((os._exit, 4), "died exit code 4"),
        ((signal.raise_signal, signal.SIGKILL), "died signal SIGKILL"),
        ((time.sleep, 1000.0), "timeout"),
    ],
)
def test_the_end_of_the_new_process_is_an_error(monkeypatch, call, message):
    """It says how the process has ended."""
    monkeypatch.setattr(separation, "LONGEST", 60.0 if "died" in message else 0.5)
    with pytest.raises(WorkerError, match=f"a process with the built-in methods only: {message}"):
        _in_a_new_process(call)


def test_what_a_new_process_prints_is_no_answer():
    """It does not get between the bytes."""
    assert _in_a_new_process((print, "x")) is None


def test_an_exception_of_the_new_process_is_an_error_with_its_text():
    """Trap: without it, methods would be computed unseparated where the bench has a mistake."""
    with pytest.raises(WorkerError, match="could not convert string to float: 'x'"):
        _in_a_new_process((float, "x"))


def test_what_hides_a_method_or_a_function_of_python_is_removed():
    """A new attribute of a class of the bench, a new name of its modules, and a class method that is replaced."""
    from rmpc_bench.estimators import kalman
    from rmpc_bench.metrics.tracking import Mse
    from rmpc_bench.types import Record

    before = Record.__dict__["of_run"]
    with untouched() as found:
        Mse.error = lambda self, record: 0.0
        kalman.len = lambda each: 1
        Record.of_run = classmethod(lambda cls, **keys: None)
    names = {"rmpc_bench.metrics.tracking.Mse.error", "rmpc_bench.estimators.kalman.len"}
    assert found == names | {f"{Record.__module__}.Record.of_run"}
    assert "error" not in vars(Mse) and not hasattr(kalman, "len") and Record.__dict__["of_run"] is before
