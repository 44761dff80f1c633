"""check: what is wrong, or what would be compared."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from small_experiment import KEYS, cli, text, write
from uncertain_experiment import write_estimation

from rmpc_bench.controllers.mpc_law import Mpc
from rmpc_bench.plants.servo import ServoLinear

BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
WRONG = {
    "unknown key": (text(metrix="[mse]"), "16:1: metrix: 'metrix' is not a known key; did you mean 'metrics'?"),
    "wrong type": (text(title="[1]"), "16:8: title: must be text (got a list of 1)"),
    "negative c": (
        text(methods="{a: {estimator: {kind: robust-kalman, c: -1}}}"),
        "13:51: methods.a.estimator.c: must be > 0 (got -1)",
    ),
    "Hu > Hp": (
        text(controller="{kind: mpc, Hp: 3, Hu: 4, Q: 0.1, R: 0.1}"),
        "12:36: controller.Hu: must be at most Hp = 3 (got 4)",
    ),
    "unknown plant": (
        text(plant="{kind: sevro}"),
        "7:15: plant.kind: 'sevro' is not a known plant; did you mean 'servo'? (rmpc-bench list plants)",
    ),
    "duplicate key": (text() + "seed: 8\n", "16:1: seed: the key is given twice; first on line 3, column 1"),
    "empty file": ("# nothing\n", "1:1: the file is empty"),
    "tag": (text(title="!!python/object/apply:os.system [ls]"), "16:8: title: tags are not allowed"),
    "alias bomb": (BOMB, "more than 100000 values"),
    "not a mapping": (text(time="[0.1, 10]"), "5:7: time: must be a mapping (got a list of 2)"),
    "NaN": (text(time="{step: .nan, steps: 10}"), "5:14: time.step: nan is not a quantity; numbers here are finite"),
    "wrong indentation": ("a:\n  b: 1\n c: 2\n", "3:2: "),
}


@pytest.mark.parametrize("verb", ["check", "run"])
@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_configuration(tmp_path, verb, mistake):
    """Exit 2, file:line:column, key and reason on stderr, no traceback, nothing on stdout, nothing written."""
    content, message = WRONG[mistake]
    path = tmp_path / "wrong.yaml"
    path.write_text(content, encoding="utf-8")
    result = cli(verb, path, *(["-o", tmp_path / "out"] if verb == "run" else []))
    assert result.exit_code == 2
    assert result.stdout == ""
    [line] = result.stderr.splitlines()
    assert line.startswith(f"{path}:") and message in line
    assert [each.name for each in tmp_path.iterdir()] == ["wrong.yaml"]


def test_a_missing_file(tmp_path):
    """The nearest name in the same directory is offered."""
    path = write(tmp_path)
    missing = tmp_path / "tinny.yaml"
    result = cli("run", missing)
    assert result.exit_code == 2
    assert result.stderr == f"{missing}:1:1: there is no such file; did you mean '{path}'?\n"


@pytest.mark.parametrize("mistake", ["negative c", "alias bomb", "tag"])
@pytest.mark.long
def test_a_wrong_configuration_in_a_process(tmp_path, mistake):
    """The installed program reports the same."""
    content, message = WRONG[mistake]
    (tmp_path / "wrong.yaml").write_text(content, encoding="utf-8")
    command = [Path(sys.executable).with_name("rmpc-bench"), "check", "wrong.yaml"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("wrong.yaml:") and message in done.stderr and "Traceback" not in done.stderr


def test_all_mistakes_sorted_by_place(tmp_path):
    """Of schema and of designs, one a line."""
    controller, methods = "{kind: mpc, Hp: 3, Hu: 4, Q: 0.1, R: 0.1}", "{a: {estimator: {kind: robust-kalman, c: -1}}}"
    path = write(tmp_path, seed=-1, controller=controller, methods=methods, figures="[boxplt]")
    result = cli("check", path)
    lines = [line.removeprefix(f"{path}:").split(": ")[:2] for line in result.stderr.splitlines()]
    assert result.exit_code == 2
    assert [key for _, key in lines if key != "controller.Hu"] == ["seed", "methods.a.estimator.c", "figures.0"]
    assert [int(place.split(":")[0]) for place, _ in lines] == sorted(int(place.split(":")[0]) for place, _ in lines)


def test_a_valid_configuration(tmp_path):
    """Plant beside design model, differences between the methods, assumptions, size and cost."""
    claims = "[{says: a, check: 'mean(mse[S-MPC]) < 1', assumptions: [the weights]}]"
    path = write(tmp_path, title="A title", claims=claims)
    result = cli("check", path, "--full")
    shown = " ".join(result.stdout.split())
    assert (result.exit_code, result.stderr) == (0, "")
    assert shown.startswith(f"{path} is valid: 6 runs x 2 methods x 10 steps, about ") and " A title " in shown
    short = cli("check", path).stdout
    assert (
        len(short.splitlines()) <= 16 and "assumptions" not in short and f"check{path}--full" in "".join(short.split())
    )
    for words in (
        "plant design model kind servo-linear servo-linear",
        "J_l 25 x (1 + eps) 25",
        "S-MPC estimator.kind = kalman",
        "R-MPC estimator.kind = robust-kalman, estimator.c = 0.1",
        "assumptions (not stated in the paper) - the weights",
        "S-MPC kalman mpc baseline R-MPC robust-kalman, c 0.1 mpc",
        "plant servo-linear; uncertain per run: J_l +-20 %",
    ):
        assert words in shown


def test_remarks_of_plant_and_controller(tmp_path, monkeypatch):
    """Each under the name of the plant or of the method."""
    for kind in (ServoLinear, Mpc):
        monkeypatch.setattr(kind, "remarks", (f"a remark on {kind.__name__}",), raising=False)
    shown = cli("check", write(tmp_path)).stdout
    assert " -  plant: a remark on ServoLinear\n -  S-MPC: a remark on Mpc\n -  R-MPC: a remark on Mpc\n" in shown


def test_remarks_on_methods_that_are_equal_or_linear(tmp_path):
    """Equal in all keys; a label is none of them.  A moving-horizon filter of a linearised model is linear."""
    methods = (
        "{A: {estimator: {kind: kalman}}, B: {estimator: {kind: kalman}, label: other}, "
        "C: {estimator: {kind: robust-kalman, c: 0.1}}, MHE: {estimator: {kind: moving-horizon, window: 5}}}"
    )
    linearised = "{linearise: plant, at: {x: 0, u: 0}, noise: {process: 1, measurement: 1}}"
    shown = cli("check", write(tmp_path, methods=methods, model=linearised, figures="[]")).stdout
    remarks = [line for line in shown.splitlines() if line.startswith(" -  ") and "warning" not in line]
    assert remarks[0] == " -  B is the same as A"
    linear = "moving-horizon of 'MHE' is linear, around `at`; without active bounds it is `kalman`"
    assert linear in " ".join(shown.split())
    shown = cli("check", write(tmp_path, methods=methods)).stdout
    assert "is linear, around" not in shown and "C is the same" not in shown


@pytest.mark.long
def test_remarks_on_mixed_units():
    """Which metrics add errors of components with different units."""
    shown = " ".join(cli("check", "configs/examples/pendulum.yaml").stdout.split())
    words = "adds squares of m, m/s, rad and rad/s"
    assert f"- estimation_mse {words}" in shown and f"- state_mse {words}" in shown
    assert re.search(r"m and rad; \S+ makes [\d.]+ % of it in the first run: use `only` or `scale`", shown) is None
    assert re.search(r"rad/s; \S+ makes [\d.]+ % of it in the first run: use `only` or `scale`", shown)
    assert "adds squares" not in cli("check", "configs/quickstart.yaml").stdout


def test_columns_do_not_run_together(tmp_path):
    """Whatever the length of the first one."""
    shown = cli("check", write(tmp_path), "--full").stdout
    line = [line for line in shown.splitlines() if line.startswith(" noise ")][-1]
    assert line.split("  ")[-1] == "process: 1.0 measurement: 1.0"


def test_several_files(tmp_path):
    """All are looked at, and one that is wrong spoils the exit code."""
    right, wrong = write(tmp_path), write(tmp_path, file="wrong.yaml", runs=0)
    result = cli("check", wrong, right, tmp_path / "none.yaml")
    assert result.exit_code == 2
    assert f"{right} is valid" in " ".join(result.stdout.split())
    assert [line.split(":")[0] for line in result.stderr.splitlines()] == [str(wrong), str(tmp_path / "none.yaml")]


@pytest.mark.long
def test_deep(tmp_path):
    """What it adds stands below what is printed anyhow, warnings included; the exit code does not change."""
    methods = "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}}"
    changed = methods.replace("c: 0.1}", "c: 0.1}, controller: {R: 0.2}")
    path = write(tmp_path, methods=changed)
    plain, deep = cli("check", path), cli("check", path, "--deep")
    assert (plain.exit_code, deep.exit_code, deep.stderr) == (0, 0, "")
    # What the option measures needs no hint to it.
    above = plain.stdout.replace(" measure time and model mismatch: rmpc-bench check ... --deep\n", "")
    assert above != plain.stdout and deep.stdout.startswith(above)
    added = deep.stdout.removeprefix(above)
    assert (
        "  divergence of the plant from the design model" in added and "  linear closed loop without friction" in added
    )
    assert "warning: R-MPC differs from S-MPC in the estimator and in controller.R" in " ".join(added.split())
    assert all(line == "" or line.startswith("  ") for line in added.splitlines())


@pytest.mark.long
def test_deep_looks_at_every_point_of_a_sweep(tmp_path):
    """Each under its coordinates; what the tables mean stands once, at the end."""
    sweep = "{grid: {controller.Hu: [3, 8]}}"
    shown = cli("check", write(tmp_path, sweep=sweep), "--deep").stdout
    places = [shown.index(f"\n  controller.Hu={Hu}\n") for Hu in (3, 8)]
    tables = [match.start() for match in re.finditer("divergence of the plant", shown)]
    assert len(tables) == 2 and places[0] < tables[0] < places[1] < tables[1]
    words = " ".join(shown.split())
    captions = ("s: standard deviation of the plant's noise", "c is compared with twice (10)")
    assert [words.count(caption) for caption in captions] == [1, 1]
    assert words.endswith("With `kl: printed`, c is compared with twice (10).")


@pytest.mark.long
def test_only_deep_imports_what_it_needs(tmp_path):
    """Neither the code of the analysis nor anything heavy is loaded by plain `check`; `--deep` stays light, too."""
    program = (
        "import sys; from rmpc_bench.cli import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit as done: assert not done.code\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    own = {
        "rmpc_bench.cli.deep_check",
        "rmpc_bench.diagnostics.mismatch",
        "rmpc_bench.diagnostics.tolerance",
    }
    for options, expected in (([], set()), (["--deep"], own)):
        command = [sys.executable, "-c", program, "check", str(write(tmp_path)), *options]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        modules = set(done.stderr.split())
        assert modules & own == expected
        assert not modules & {"numba", "pandas", "matplotlib"}


def test_lines_of_the_small_experiment():
    """The places above count on one line per key."""
    assert text().splitlines()[12].startswith("methods:") and len(KEYS) == 15


def test_perturbed_parameters_of_a_differential_equation_are_shown(tmp_path):
    """They stand inside `parameters`; a value that is set is shown as it is, and not as a factor."""
    (tmp_path / "lag.py").write_text("def rhs(x, u, p):\n    return [(u[0] - x[0]) / p.T * p.K]\n", encoding="utf-8")
    sizes = "states: [level], inputs: [flow], parameters: {T: 2, K: 3}"
    plant = f"{{ode: lag.py:rhs, {sizes}, perturb: {{T: 1 + eps}}, set: {{K: 4 + eps}}}}"
    model = "{kind: linear, A: 0.9, B: [[0.1]], C: [[1]], P_w: 1, P_v: 1}"
    keys = {"uncertainty": "{eps: +-10%}", "plant": plant, "model": model, "noise": "none", "initial": None}
    path = write_estimation(tmp_path, **keys, methods="{KF: {estimator: {kind: kalman}}}")
    lines = [" ".join(line.split()) for line in cli("check", path, "--full").stdout.splitlines()]
    assert "T 2 x (1 + eps) -" in lines
    assert "K 4 + eps -" in lines
