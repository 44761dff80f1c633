"""Co-simulation units of FMI 2.0 and 3.0, compiled in the test, as plants."""

import os
import pickle
import shutil
import subprocess
import sys

import numpy as np
import packed
import pytest

pytest.importorskip("fmpy")
if shutil.which("gcc") is None:
    pytest.skip("gcc compiles the units", allow_module_level=True)

from adapters.fmu_units import NAMES, build
from plants import tanks
from small_experiment import cli, ran

from rmpc_bench import load_config, run
from rmpc_bench.adapters.fmu import loaded, plant
from rmpc_bench.components.single_design import run_info
from rmpc_bench.conformance import PlantExample, check_component
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError, Status

TS, STEPS, N = 5.0, 12, 5
GIVEN = {**NAMES, "parameters": tanks.PARAMETERS, "x0": [0.2, 0.1]}
CONFIGURATION = """
version: 1
name: unit
paper: tests
seed: 3
runs: 6
time: {step: 5, steps: 8}
uncertainty: {eps: +-10%}
plant:
  fmu: tanks2.fmu
  states: [h1, h2]
  inputs: [pump]
  outputs: [level]
  parameters: {a1: 7.1e-6, a2: 6.3e-6}
  perturb: {a1: 1 + eps}
noise: {process: none, measurement: {gaussian: {std: 1e-3}}}
model: {kind: linear, A: [[0.95, 0], [0.05, 0.95]], B: [[1e-3], [0]], C: [[0, 1]], P_w: 1e-6, P_v: 1e-6}
initial: {x: [0.2, 0.1], x_hat: [0.2, 0.1], P: 1e-4}
methods: {KF: {estimator: {kind: kalman}}, robust: {estimator: {kind: robust-kalman, c: 1e-2}}}
metrics: [estimation_mse]
"""


@pytest.fixture(scope="module", params=[2, 3])
def unit(request, tmp_path_factory):
    """A unit of each version."""
    return build(tmp_path_factory.mktemp("unit"), request.param)


def drawn(seed=0):
    """Return random parameters, states and inputs of some runs."""
    rng = np.random.default_rng(seed)
    parameters = {name: value * rng.uniform(0.9, 1.1, N) for name, value in tanks.PARAMETERS.items()}
    return parameters, rng.uniform(0.1, 0.4, (N, 2)), rng.uniform(0.0, 20.0, (STEPS, N, 1))


def trajectory(made, rows=slice(None)):
    """Return x and y of all samples, and the last status."""
    parameters, x, u = drawn()
    x = x[rows]
    delta = made.draw({name: each[rows] for name, each in parameters.items()}, [None] * len(x), STEPS)
    delta = made.start(delta, x, run_info(len(x))) if made.starts_runs else delta
    x, found = made.first_state(delta, x), []
    for k in range(STEPS):
        found.append(np.hstack([x, made.output(k, delta, x, np.zeros((len(x), 1)))]))
        x, status = made.step(k, delta, x, u[k, rows], np.zeros((len(x), made.nw)))
        assert not status.any()
    return np.array(found)


def test_it_is_the_plant_of_the_same_equation(unit):
    """Oracle: our own Runge-Kutta method with as many substeps, for parameters that differ from run to run."""
    ours = ode_plant(TS, STEPS, ode=tanks.rhs, output=tanks.output, solver=Solver(substeps=5), **GIVEN)
    np.testing.assert_allclose(trajectory(plant(TS, STEPS, fmu=(unit,), **GIVEN)), trajectory(ours), rtol=0, atol=1e-12)


def test_a_run_alone_has_the_bits_of_the_block(unit):
    """Every run has its own instance, although all of them share the library of the file."""
    made = plant(TS, STEPS, fmu=(unit,), **GIVEN)
    together = trajectory(made)
    for row in (3, 0):
        np.testing.assert_array_equal(trajectory(made, slice(row, row + 1)), together[:, row : row + 1])
    np.testing.assert_array_equal(trajectory(pickle.loads(pickle.dumps(made))), together)


def test_one_instance_for_two_runs_is_wrong(unit):
    """Naive form: one instance in which runs take turns. Its state is that of the run before."""
    made = plant(TS, STEPS, fmu=(unit,), **GIVEN)
    instance = made.unit.instance({**tanks.PARAMETERS, "h1": 0.2, "h2": 0.1})
    put, get = (
        getattr(instance, f"{verb}{'Real' if made.unit.version == 2 else 'Float64'}") for verb in ("set", "get")
    )
    ends = []
    for _ in range(2):
        put(made.unit.inputs, [8.0])
        instance.doStep(0.0, TS)
        ends.append(get(made.unit.read))
    assert ends[0] != ends[1]


def test_it_passes_the_checks_of_a_plant(unit):
    """Oracle: the rules of a plant."""
    made = plant(0.1, 10, fmu=(unit,), **GIVEN)
    example = PlantExample.random(made, n_steps=10, scale=0.1)
    example.x[:] = np.abs(example.x) + 0.2
    assert [str(result) for result in check_component(made, example) if result.status == "failed"] == []


def test_an_error_of_the_unit_ends_its_run_only(unit):
    """A level below zero has no outflow: the unit reports an error, and the other runs have their bits."""
    made = plant(TS, STEPS, fmu=(unit,), **GIVEN)
    parameters, x, u = drawn()
    before = trajectory(made)
    x[2, 0] = -0.1
    runs = run_info(N)
    delta = made.start(made.draw(parameters, [None] * N, STEPS), x, runs)
    motion = made.step(0, delta, x, u[0], np.zeros((N, 0)))
    assert motion.status.tolist() == [0, 0, int(Status.CRASHED), 0, 0]
    assert "DoStep failed with status 3 (error)" in runs.journal.failures[2].message
    np.testing.assert_array_equal(np.delete(motion.x, 2, axis=0), np.delete(before[1, :, :2], 2, axis=0))


def test_a_unit_of_version_3_may_end_the_simulation(tmp_path):
    """The status is that of a plant that has left its range."""
    made = plant(TS, STEPS, fmu=(build(tmp_path, 3),), **GIVEN)
    parameters, x, u = drawn()
    u[0, 1] = 2000.0
    delta = made.start(made.draw(parameters, [None] * N, STEPS), x, run_info(N))
    status = made.step(0, delta, x, u[0], np.zeros((N, 0))).status
    assert status.tolist() == [0, int(Status.OUT_OF_RANGE), 0, 0, 0]


def test_a_unit_with_its_own_start_keeps_it(tmp_path):
    """Variables that are computed by the initialisation cannot be set: x(0) is that of the unit."""
    made = plant(TS, STEPS, fmu=(build(tmp_path, 2, own_start=True),), **GIVEN)
    assert made.has_own_start
    parameters, x, _ = drawn()
    delta = made.start(made.draw(parameters, [None] * N, STEPS), x, run_info(N))
    assert made.first_state(delta, x).tolist() == [[0.2, 0.1]] * N
    assert dict(made.facts())["states"] == "h1, h2 (x(0) is that of the FMU)"


@pytest.mark.parametrize("version", [2, 3])
def test_the_clock_of_the_unit_is_that_of_the_run(version, tmp_path):
    """A unit with internal steps of 0.1 s is at 0.2 s after a step of 0.25 s, without an error of its own."""
    file = build(tmp_path, version, step=0.1)
    message = r"the first sample fails .*t = 0.25 s the clock of the FMU is at 0.2 s; `time.step` must be a multiple"
    with pytest.raises(DesignError, match=message):
        plant(0.25, STEPS, fmu=(file,), **GIVEN)
    free, made = (plant(0.1, STEPS, fmu=(each,), **GIVEN) for each in (build(tmp_path / "free", version), file))
    np.testing.assert_allclose(trajectory(made), trajectory(free), rtol=0, atol=1e-15)
    multiple = trajectory(plant(0.3, STEPS, fmu=(file,), **GIVEN))
    assert np.abs(multiple - trajectory(plant(0.3, STEPS, fmu=(tmp_path / "free" / file.name,), **GIVEN))).max() < 1e-8


def test_the_internal_step_of_a_description_is_read(tmp_path):
    """Before any step: FMI 3 has the attribute fixedInternalStepSize."""
    file = build(tmp_path, 3, step=0.1, says_step=True)
    for Ts in (0.25, 0.05):
        with pytest.raises(
            DesignError, match=r"internal step 0.1 s .*`time.step`, 0.\d5 s, must be a multiple"
        ) as caught:
            plant(Ts, STEPS, fmu=(file,), **GIVEN)
        assert caught.value.parameter == "fmu"
    plant(0.7, STEPS, fmu=(file,), **GIVEN)


def test_a_clock_that_goes_wrong_later_ends_the_run(tmp_path):
    """Naive form: the times k Ts of the configuration, whatever the unit says."""
    made = plant(TS, STEPS, fmu=(build(tmp_path, 3),), **GIVEN)
    parameters, x, u = drawn()
    runs = run_info(N)
    delta = made.start(made.draw(parameters, [None] * N, STEPS), x, runs)
    fmu = delta.objects.made[1].fmu
    whole = fmu.doStep
    fmu.doStep = lambda t, h: whole(t, h / 2)
    assert made.step(0, delta, x, u[0], np.zeros((N, 0))).status.tolist() == [0, int(Status.CRASHED), 0, 0, 0]
    assert "the clock of the FMU is at 2.5 s" in runs.journal.failures[1].message


def test_variables_may_have_other_names_in_the_file(unit):
    """Names of tools have dots; those of a configuration are identifiers."""
    names = {**GIVEN, "inputs": ["flow"], "variables": {"flow": "pump"}}
    made = plant(TS, STEPS, fmu=(unit,), **names)
    np.testing.assert_array_equal(trajectory(made), trajectory(plant(TS, STEPS, fmu=(unit,), **GIVEN)))


@pytest.mark.parametrize(
    ("keys", "key", "message"),
    [
        ({"states": ["h1", "h3"]}, "states", "'h3' is not a known variable of the FMU; did you mean 'h2'"),
        ({"inputs": ["level"]}, "inputs", r"level is a variable of causality output \(not input\)"),
        ({"parameters": {"pump": 1.0}}, "parameters", "causality input"),
        ({"states": 2}, "states", "must be names of variables"),
        ({"x0": [-1.0, 0.1]}, "fmu", "the first sample fails .*status 3"),
        ({"fmu": ()}, "fmu", r"must be one file \(got 0\)"),
    ],
)
def test_mistakes_are_reported_at_their_key(unit, keys, key, message):
    """Each message names what does not fit."""
    with pytest.raises(DesignError, match=message) as caught:
        plant(TS, STEPS, **{"fmu": (unit,), **GIVEN, **keys})
    assert caught.value.parameter == key


def test_units_that_cannot_have_an_instance_per_run_are_refused(tmp_path):
    """As are files that are no unit."""
    with pytest.raises(DesignError, match="one instance per process"):
        plant(TS, STEPS, fmu=(build(tmp_path, 2, once=True),), **GIVEN)
    other = tmp_path / "other.fmu"
    other.write_bytes(b"no archive")
    with pytest.raises(DesignError, match=r"other\.fmu is no FMU"):
        plant(TS, STEPS, fmu=(other,), **GIVEN)


def test_a_configuration_with_a_unit(tmp_path):
    """The numbers do not depend on processes and blocks; the content of the file counts in the hash."""
    build(tmp_path, 2)
    (tmp_path / "unit.yaml").write_text(CONFIGURATION)
    tables = []
    for jobs, block in ((1, 6), (2, 1)):
        config = load_config(tmp_path / "unit.yaml", overrides=[f"execution.block={block}"])
        results = run(config, directory=tmp_path / f"{jobs}", jobs=jobs, engine="joblib")
        tables.append(results.trials.frame)
    assert len(tables[0]) == 12
    assert set(tables[0]["status"]) == {"ok"}
    assert tables[0].equals(tables[1])


@pytest.mark.long
def test_extracted_files_are_removed_at_the_end_of_a_process(tmp_path):
    """The library of a unit is extracted once per process, of workers as well."""
    build(tmp_path / "unit", 2)
    (tmp_path / "unit" / "unit.yaml").write_text(CONFIGURATION)
    (tmp_path / "temporary").mkdir()
    file = str(tmp_path / "unit" / "unit.yaml")
    options = ["-j", "2", "--engine", "joblib", "-o", str(tmp_path / "out")]
    command = [sys.executable, "-m", "rmpc_bench", "run", file, *options]
    found = subprocess.run(command, env={**os.environ, "TMPDIR": str(tmp_path / "temporary")}, capture_output=True)
    assert found.returncode == 0, found.stderr
    assert [*(tmp_path / "temporary").rglob("*.so")] == []


def test_results_have_a_copy_of_the_unit_and_their_archive_needs_consent(tmp_path, monkeypatch):
    """The original is gone.  Nothing of the unit runs without consent, and nothing at all with NO_CODE."""
    build(tmp_path / "unit", 2)
    (tmp_path / "unit" / "unit.yaml").write_text(CONFIGURATION.replace("paper: tests\n", ""))
    out, archive = tmp_path / "out", tmp_path / "unit.zip"
    ran(tmp_path / "unit" / "unit.yaml", out)
    shutil.rmtree(tmp_path / "unit")
    (copied,) = out.glob("code/*/tanks2.fmu")
    done = cli("pack", out, "-o", archive)
    assert done.exit_code == 0 and f"code  {copied.relative_to(out)} (sha " in done.stderr, done.output
    assert sum(name.endswith(".fmu") for name in packed.contents(archive)) == 1
    refused = cli("verify", archive, "-j", 1)
    assert refused.exit_code == 2 and "tanks2.fmu (sha" in refused.stderr
    found = cli("verify", archive, "-j", 1, "--allow-code", archive)
    assert found.exit_code == 0 and "reproduced" in found.stdout, found.output
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "1")
    for command in (("verify", archive, "--allow-code", archive), ("pack", out, "-o", tmp_path / "x.zip")):
        refused = cli(*command)
        assert refused.exit_code == 2 and "files with code are not loaded, because RMPC" in refused.stderr
    loaded.cache_clear()
    with pytest.raises(DesignError, match="RMPC_BENCH_NO_CODE=1"):
        loaded(str(copied))
