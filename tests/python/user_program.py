"""A user's program with every public name; test_types.py checks it with mypy, and no line is executed."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

import rmpc_bench
from rmpc_bench import (
    NUMERICS,
    Controller,
    Estimator,
    Experiment,
    Figure,
    LinearModel,
    Method,
    Metric,
    Plant,
    Results,
    Scenario,
    SolverError,
    Status,
    Trials,
    compare,
    compare_improvements,
    compare_results,
    controller,
    drivers,
    estimator,
    figure,
    filter_data,
    import_runs,
    judge,
    load_config,
    load_results,
    load_trials,
    merge,
    model,
    pack,
    plant,
    publish,
    ranks,
    register,
    replay,
    requirements,
    run,
    run_one,
    simulate,
    single_run,
    summarise,
    tuning,
    verify,
)


@single_run
class Observer:
    """Observer with a constant gain."""

    def __init__(self, gain: float = 0.4) -> None:
        self.gain = gain

    def update(self, y: float, u_previous: float) -> float:
        """Return the estimate."""
        if y > 1e6:
            raise SolverError("too large")
        return self.gain * y


class Mine(Estimator):
    """Estimator of a block of runs."""

    def init(self, n_runs: int) -> int:
        """Start."""
        return n_runs

    def correct(self, k: int, state: int, y: rmpc_bench.types.Array) -> tuple[int, rmpc_bench.types.Estimate]:
        """Use y(k)."""
        ok = np.full(state, Status.OK)
        return state, rmpc_bench.types.Estimate(y, None, None, ok, {})

    def predict(self, k: int, state: int, u: rmpc_bench.types.Array) -> int:
        """Go to k+1."""
        return state


def designs() -> Method:
    """Design a filter and a law, and filter one sample."""
    linear = LinearModel([[0.9]], [[1.0]], [[1.0]], 0.1, 0.2)
    other = model("linear", n_steps=5, A=[[0.9]], C=[[1.0]])
    made: Estimator = estimator("kalman", linear, n_steps=5, x0=0.0, P0=1.0)
    law: Controller = controller("mpc", other, Hp=5, Hu=2, Q=1.0, R=0.1)
    state, estimate = made.correct(0, made.init(1), np.array([[1.0]]))
    made.predict(0, state, estimate.x_hat)
    return Method("KF", made, law)


def experiment(file: Path) -> Results:
    """Run a configuration."""
    register("estimator", "observer", Observer)
    register("estimator", "mine", Mine)
    config = load_config(file, overrides={"runs": 4}, smoke=True)
    found = run(config, jobs="auto", only=["KF"], progress=lambda done, total, text: print(done, total, text))
    return run(str(file), jobs=-1, only="KF", progress=True, directory=found.directory)


def read(directory: Path) -> Mapping[str, str]:
    """Read results, compare and draw."""
    results, trials = load_results(directory), load_trials(directory)
    table: Trials = results.trials
    print(summarise(trials).to_markdown(), drivers(table), requirements(table), ranks(results), tuning(results))
    print(compare(results, metric="mse").to_frame(), compare_results(results, results).equal)
    print(compare_improvements(results, results, "KF"), [each.finding for each in judge(results)])
    figure(results, "boxplot", metric="mse").save(directory / "mse.svg")
    again = replay(directory, 2, "KF")
    print(import_runs(directory / "runs.csv", settings={"seed": 1}, columns={"method": "Filter"}).comparison.frame)
    publish(results)
    pack(directory, directory / "a.zip")
    return {"replay": again.status, "verify": str(verify(directory / "a.zip")), "merge": str(merge(directory))}


def alone(directory: Path) -> float:
    """Simulate one run, and filter recorded data."""
    one = run_one({"extends": "servo.yaml", "runs": 4}, "KF", run=2)
    kalman = estimator("kalman", LinearModel([[0.9]], [[1.0]], [[1.0]], 0.1, 0.2), x0=0.0, P0=1.0)
    found = filter_data(kalman, one.y, one.u)
    one.to_frame().to_csv(directory / "one.csv")
    found.to_frame().to_csv(directory / "filtered.csv")
    print(load_results(directory).comparison.to_latex(), summarise(str(directory)).to_frame())
    return float(abs(found.x_hat - one.x_hat).max()) + float(one.P[0, 0, 0]) * (one.status == "ok")


def block(given: Experiment, scenario: Scenario, system: Plant, metric: Metric, picture: Figure) -> object:
    """Simulate a block."""
    draws = scenario.draw(system, range(3), given.n_steps)
    r = scenario.reference.sample(given.n_steps + 2)
    record, status = simulate(plant("servo-linear", Ts=0.1), designs(), draws, r, given.n_steps)
    return metric.evaluate(record), status, picture.metric_keys, NUMERICS
