"""A user's program with ten mistakes, one per line with the mark; test_types.py checks it with mypy."""

import rmpc_bench
from rmpc_bench import Estimator, LinearModel, compare, estimator, figure, load_config, load_results, replay, run


class Half(Estimator):
    """Estimator that lacks two methods."""

    def init(self, n_runs: int) -> int:
        """Start."""
        return n_runs


linear = LinearModel([[0.9]], [[1.0]], [[1.0]], 0.1, 0.2)
config = load_config("servo.yaml", runs="4")  # wrong
results = run(config, jobs="all")  # wrong
run(config, only=3)  # wrong
run(config, progress="bar")  # wrong
compare(results, metric=["mse"]).to_frame()  # wrong
figure("results/servo", "boxplot")  # wrong
print(load_results("results/servo").trails)  # wrong
replay("results/servo", "34", "R-MPC")  # wrong
half = Half()  # wrong
print(estimator("kalman", linear, n_steps=5, x0=0.0, P0=1.0).corect)  # wrong
print(rmpc_bench.NUMERICS + 1, linear.nx + 1)
