"""Trials as data sets of xarray: equal to the table, also after they are saved as netCDF."""

import numpy as np
import pytest

xarray = pytest.importorskip("xarray")

import rmpc_bench  # noqa: E402
from rmpc_bench.adapters.xarray import dataset, traces  # noqa: E402
from rmpc_bench.publishing.table_files import write_traces  # noqa: E402

CONFIG = """\
version: 1
name: sets
runs: 4
time: {step: 0.1, duration: 1}
uncertainty: {eps: +-20%}
plant: {ode: lag.py:rhs, states: {level: m}, inputs: [q], parameters: {a: 1},
  perturb: {a: 1 + eps}, bounds: {level: [-1, HIGH]}}
model: {kind: linear, A: 0.9, B: [[0.1]], C: [[1]], P_w: 1e-4, P_v: 1e-3}
noise: {process: {gaussian: {std: 0.05}}, measurement: {gaussian: {std: 0.03}}}
reference: {kind: constant, value: 0.3}
controller: {kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 1}
methods:
  Kalman: {estimator: {kind: kalman}}
  robust: {estimator: {kind: robust-kalman, c: 0.1}, label: "robust, $c$"}
metrics: [mse, {kind: settling_time, band: 0.3}]
record: {runs: 2, signals: [y, u]}
"""


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Return a function that runs the configuration with further keys."""

    def run(more="", high="0.28", law=""):
        directory = tmp_path_factory.mktemp("sets")
        (directory / "lag.py").write_text("def rhs(x, u, p):\n    return [-p.a * x[0] + u[0]]\n")
        path = directory / "sets.yaml"
        text = CONFIG.replace("HIGH", high) + more
        if law:
            (directory / "law.py").write_text(law)
            text = text.replace("{kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 1}", "{file: law.py:Law}")
        path.write_text(text)
        return rmpc_bench.run(rmpc_bench.load_config(path), directory=directory / "out", engine="serial")

    return run


def rows(data, trials):
    """Return a data set as the table of trials."""
    names = [*trials.paths, "method", "run"]
    frame = data[["status", *(info.name for info in trials.metrics)]].to_dataframe().reset_index()
    frame = frame[[*names, "status", *(info.name for info in trials.metrics)]]
    return frame[frame["status"] != ""]


def same(frame, trials):
    """Whether a table is that of the trials, whatever the order of its rows."""
    expected = trials.frame[frame.columns]
    for path in trials.paths:
        expected = expected.assign(**{path: expected[path].astype(float)})
    keys = [*trials.paths, "method", "run"]
    a, b = (each.sort_values(keys).reset_index(drop=True) for each in (frame, expected))
    assert [*a.columns] == [*b.columns]
    for name in a.columns:
        np.testing.assert_array_equal(a[name].to_numpy(), b[name].to_numpy(), err_msg=name)


def test_a_table_and_back(stored, tmp_path):
    """Failed runs, inf and units included; netCDF is written by SciPy."""
    results = stored()
    trials, data = results.trials, dataset(results)
    assert {"ok", "out-of-range"} <= set(trials.frame["status"])
    assert np.isinf(trials.frame["settling_time"]).any()
    assert data["mse"].dims == ("method", "run")
    assert data["mse"].attrs == {"units": "m^2", "long_name": "MSE", "better": "lower"}
    assert data["label"].dims == ("method",)
    assert data["label"].values.tolist() == ["Kalman", "robust, $c$"]
    same(rows(data, trials), trials)
    np.testing.assert_array_equal(data["eps"], trials.uncertainty["eps"])
    assert data["eps"].dims == ("run",)
    data.to_netcdf(tmp_path / "trials.nc", engine="scipy")
    loaded = xarray.load_dataset(tmp_path / "trials.nc", engine="scipy")
    assert loaded.equals(data)
    same(rows(loaded, trials), trials)


def test_a_directory_of_results(stored):
    results = stored()
    assert dataset(results.directory).identical(dataset(results))
    assert traces(str(results.directory)).identical(traces(results))


def test_a_grid_has_a_dimension_per_path(stored):
    """And a zip has the dimension `point`."""
    more = "sweep: {grid: {controller.Hp: [5, 7], controller.R: [1, 2]}}\n"
    trials = stored(more, "5").trials
    data = dataset(trials)
    assert data["mse"].sizes == {"controller.Hp": 2, "controller.R": 2, "method": 2, "run": 4}
    same(rows(data, trials), trials)
    point = trials.points[2]
    chosen = data["mse"].sel({**{path: float(value) for path, value in point.point.items()}, "method": "robust"})
    np.testing.assert_array_equal(chosen, point.column("mse", "robust"))
    trials = stored("sweep: {zip: {controller.Hp: [5, 7], controller.R: [1, 2]}}\n", "5").trials
    data = dataset(trials)
    assert data["mse"].sizes == {"point": 2, "method": 2, "run": 4}
    np.testing.assert_array_equal(data["controller.R"], [1.0, 2.0])
    np.testing.assert_array_equal(data["mse"].sel({"point": trials.points[1].title, "method": "Kalman"}),
                                  trials.points[1].column("mse", "Kalman"))  # fmt: skip
    with pytest.raises(ValueError, match="one of its points"):
        traces(trials)
    assert traces(trials.points[0])["y"].sizes["run"] == 2


def test_recorded_runs(stored, tmp_path):
    """Oracle: the recorded runs; u has no value at the last sample."""
    trials = stored(high="5").trials
    data = traces(trials)
    assert data["u"].dims == ("method", "run", "time", "u_component")
    for name, trace in trials.traces.items():
        np.testing.assert_array_equal(data["y"].sel({"method": name}), trace.signals["y"])
        np.testing.assert_array_equal(data["u"].sel({"method": name})[:, :-1], trace.signals["u"])
    assert np.isnan(data["u"][:, :, -1]).all()
    np.testing.assert_allclose(data["time"], 0.1 * np.arange(11))
    assert data["y"].attrs == {"units": "m"}
    data.to_netcdf(tmp_path / "traces.nc", engine="scipy")
    assert xarray.load_dataset(tmp_path / "traces.nc", engine="scipy").equals(data)


LAW = """\
from rmpc_bench import single_run


@single_run
class Law:
    def control(self, r, k):
        if k == 4:
            raise ValueError("no input")
        return 0.5 * r
"""


@pytest.mark.parametrize("failing", ["controller of the user", "built-in bounds"])
def test_a_failed_run_ends_with_its_failure(stored, failing):
    """Oracle: the replay of the run, which ends there.  Without it y would stay as it is to the last sample."""
    more, high = ("", "0.2") if failing == "built-in bounds" else ("", "5")
    results = stored(more, high, law=LAW if failing != "built-in bounds" else "")
    data, status = traces(results), results.trials.frame.set_index(["method", "run"])["status"]
    ends = set()
    for method in results.trials.methods:
        for run in data["run"].values.tolist():
            cell = data.sel({"method": method, "run": run})
            assert cell["status"] == status[method, run]
            again = rmpc_bench.replay(results.directory, run, method)
            assert again.status == status[method, run]
            for name in ("y", "u"):
                shown = again.signals[name]
                np.testing.assert_array_equal(cell[name].values[: len(shown)], shown)
                assert np.isnan(cell[name].values[len(shown) :]).all()
            ends.add(len(again.signals["y"]))
    assert min(ends) < 11
    assert failing == "built-in bounds" or ends == {5}
    write_traces(results.trials, results.directory / "traces.npz")
    with np.load(results.directory / "traces.npz") as file:
        np.testing.assert_array_equal(file["Kalman/y"], data["y"].sel({"method": "Kalman"}))
        np.testing.assert_array_equal(results.traces["Kalman"].signals["y"], file["Kalman/y"])
