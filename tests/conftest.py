"""Which tests run, shapes checked at run time, the four words for tolerances, a seed and small models.

House rule: a tolerance is one of the four words below, or the line that holds it says why it is another.
"""

import gc
import os
import signal
import sys
from collections import defaultdict
from pathlib import Path

import jaxtyping
import remembered_checks

# A quarter of the time of tests would be spent on looking for garbage among the objects of imports and syntax trees.
gc.set_threshold(50_000, 20, 20)

# First of all, before any test imports the package.  Compiled functions cannot be wrapped: their modules are left out
# (jaxtyping matches whole dotted names; plants/test_servo.py asserts that `servo` does not cover `servo_kernel`).
COMPILED = {
    "bounded_window_kernel",
    "compiled_step",
    "game_kernel",
    "linear_loop_kernel",
    "minimax_kernel",
    "moving_slide_kernel",
    "output_weights_kernel",
    "servo_kernel",
    "tracking_kernel",
}
PACKAGE = Path(__file__).parents[1] / "rmpc_bench"
PARTS = ("models", "estimators", "controllers", "simulation", "noise", "metrics", "diagnostics", "numerics")
FILES = [file for part in PARTS for file in sorted((PACKAGE / part).glob("*.py")) if file.stem not in COMPILED]
CHECKED = [f"rmpc_bench.{file.parent.name}.{file.stem}" for file in FILES]
CHECKED += [f"rmpc_bench.plants.{name}" for name in ("servo", "moving_slide")]
TESTS = os.environ.get("RMPC_BENCH_TESTS", "")
ALL = TESTS in ("all", "ci")
"""Shapes are checked, and no mark is left to `.ci/run`."""
EVERY = {"all": 1, "ci": 5}.get(TESTS, 10)
"""From so many cases of a function with many (`WIDE`) one runs, unless a file of tests is named."""
os.environ.setdefault("RMPC_BENCH_DOC_RUNS", "" if TESTS == "all" else "4")
TURN = int(os.environ.get("RMPC_BENCH_TURN", "0"))
"""Which of them: `.ci/run` counts commits, so that five commits after each other run all cases, and all pages."""
if ALL:
    jaxtyping.jaxtyped = remembered_checks.jaxtyped
    jaxtyping.install_import_hook(CHECKED, "remembered_checks.checked")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts programs in the background with Ctrl-C ignored, and their children inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
sys.modules.setdefault("conftest", sys.modules[__name__])  # `from conftest import ROUND` must not run this file again

import forked_workers  # noqa: E402
import hypothesis  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402

forked_workers.install()
# A slow machine is no fault of the code.  The rest of the profile stays: hypothesis knows one for CI.
SLOW = [hypothesis.HealthCheck.too_slow]
hypothesis.settings.register_profile("untimed", hypothesis.settings(), deadline=None, suppress_health_check=SLOW)
hypothesis.settings.load_profile("untimed")

WIDE = 5
"""Number of cases from which on a function has many."""
FOR_CI = ("page", "kill", "long")
"""Marks of tests that take time: `.ci/run` runs some of them by turn, all of a page together, `make test` none."""

UNDRAWN = {"execution"} if ALL else {"execution", "cli"}
"""Folders of tests in which a page has the figures of the configuration only; `.ci/run` draws all of cli."""

EXACT = {"rtol": 0.0, "atol": 0.0}
"""Bit for bit, as np.testing.assert_array_equal."""
ROUND = {"rtol": 1e-12}
"""Two ways to write the same arithmetic."""
SOLVER = {"rtol": 1e-6}
"""Two iterative methods that stop by themselves."""
STAT = 5.0
"""How many standard errors a Monte Carlo mean may be off: once in 1.7 million tests by chance."""


def by_turn(cases, first=0):
    """Return of many cases those of this turn, from another one on for another ``first``."""
    return cases[(TURN + first) % EVERY :: EVERY]


def within_stat(samples, expected):
    """Whether the means over axis 0 lie within STAT standard errors of what is expected."""
    samples = np.asarray(samples)
    se = samples.std(axis=0, ddof=1) / np.sqrt(len(samples))
    return bool((np.abs(samples.mean(axis=0) - expected) <= STAT * se).all())


def random_psd(rng, n, condition=10.0, rank=None):
    """Random symmetric positive semidefinite matrix with the given ratio of its largest to its smallest eigenvalue."""
    U = np.linalg.qr(rng.standard_normal((n, n)))[0]
    lam = np.geomspace(1.0, 1.0 / condition, n)
    lam[rank if rank is not None else n :] = 0.0
    P = (U * lam) @ U.T
    return 0.5 * (P + P.T)


def random_model(rng, nx=3, nu=1, ny=1, radius=0.95):
    """Random stable linear model with spectral radius ``radius`` and full noise."""
    from rmpc_bench.models.linear import LinearModel

    A = rng.standard_normal((nx, nx))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((nx, nu)), rng.standard_normal((ny, nx))
    return LinearModel(A, B, C, random_psd(rng, nx), random_psd(rng, ny))


def servo_model():
    """The linear servomechanism of servo.md section 1: g = d = 1, T = 0.1 s."""
    from rmpc_bench.models.servo import ServoNoise, design

    return design(0.1, noise=ServoNoise(process=1.0, measurement=1.0))


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path):
    """Of the files beside this one only those with an example are imported for their doctests."""
    collectors = yield
    if file_path.is_relative_to(Path(__file__).parent) and ">>> " not in file_path.read_text("utf-8", "replace"):
        return [each for each in collectors if type(each) is pytest.Module]
    return collectors


def names_a_file(config):
    """Whether the command line has a file of tests, not only folders, or those of pyproject.toml."""
    return any(Path(arg.partition("::")[0]).name.startswith("test_") for arg in config.args)


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Tests of a named file, those in a debugger and measurements run in this process alone, others on all cores."""
    option = config.option
    alone = names_a_file(config) or option.trace or "perf" in option.markexpr.replace("not perf", "")
    if getattr(option, "numprocesses", 0) is None and not hasattr(config, "workerinput") and not alone:
        option.numprocesses, option.dist = "auto", "worksteal"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Leave to `.ci/run` what `FOR_CI` and `WIDE` say; a named file and a mark of ``-m`` run as they stand."""
    if names_a_file(config):
        return
    cases, marked, kept = defaultdict(list), defaultdict(list), set()
    for item in items:
        marks = [mark for mark in item.iter_markers() if mark.name in FOR_CI]
        if any(mark.name in config.option.markexpr for mark in item.iter_markers()):
            kept.add(item)
        elif marks:
            marked[next(iter(marks[0].args), item.nodeid)].append(item)
        else:
            cases[item.nodeid.partition("[")[0]].append(item)
    # A mark and a number among the cases would choose few tests in the same turn.
    kept |= {item for each in cases.values() for item in (each if len(each) < WIDE else by_turn(each))}
    kept |= {item for name in (by_turn([*marked]) if ALL else ()) for item in marked[name]}
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = [item for item in items if item in kept]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Workers of most tests are forks."""
    forked_workers.Forks.allowed = not forked_workers.NEW & {*item.path.parts}


def pytest_collection_finish():
    """Modules and tests stay until the end, so that no collection of garbage need look through them again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="module")
def only_chosen_figures(request):
    """Leave out figures that only the page has, where no test looks at them: a sixth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        if UNDRAWN & {*request.path.relative_to(Path(__file__).parent).parts}:
            patch.setattr("rmpc_bench.publishing.pages.more_figures", lambda *_: [])
        yield


@pytest.fixture
def rng():
    """Return a generator with the same seed in every test."""
    return np.random.default_rng(20180418)


@pytest.fixture
def scalar_model():
    """Return the random walk in noise, the smallest model there is."""
    from rmpc_bench.models.linear import LinearModel

    return LinearModel([[1.0]], [[1.0]], [[1.0]], [[0.5]], [[2.0]])


@pytest.fixture
def small_model():
    """Return a stable model with three states, two inputs and two outputs."""
    return random_model(np.random.default_rng(3), 3, 2, 2)


@pytest.fixture(scope="session")
def servo():
    """Return the linear servomechanism of servo.md section 1."""
    return servo_model()
