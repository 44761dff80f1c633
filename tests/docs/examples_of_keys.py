"""One example of every top-level key, for docs/reference.md; a test checks each against the schema."""

from __future__ import annotations

EXAMPLES: dict[str, str] = {
    "version": "version: 1",
    "name": "name: fig7",
    "paper": "paper: zenere2018",
    "title": "title: MSE of the load angle over 200 perturbed servomechanisms (Fig. 7)",
    "summary": "summary: The medians are 0.114 and 0.103 rad^2; R-MPC is 11 % below S-MPC.",
    "extends": "extends: fig7.yaml",
    "seed": "seed: 20180418",
    "runs": "runs: 200",
    "stop": "stop: {resolve: 2%, min_runs: 100, max_runs: 2000}        # or {decide: claims, max_runs: 3200}",
    "tune": "tune: {budget: 16, runs: 40, metric: mse, statistic: mean}        # ranges are in the methods",
    "time": "time: {step: 0.1, duration: 20}        # or {steps: 1500}",
    "plugins": "plugins: [my_filter.py]",
    "requires": "requires: [filterpy, do-mpc]",
    "plant": """plant:
  kind: servo
  perturb: {R: 1 + eps_min, J_l: 1 + eps_jl}
  bounds: {x.0: [-10, 10]}""",
    "uncertainty": """uncertainty:
  eps_min: +-10%
  eps_max: {dist: normal, std: 5%, truncate: 3}
  eps_jl: {dist: choice, values: [-0.8, 0, 0.8]}
  scale: 1                                      # 2 doubles the spread of all of them""",
    "noise": """noise:
  process: none
  measurement: {sum: [{gaussian: {std: 0.01}}, {uniform: {radius: 0.02}}]}""",
    "initial": "initial: {x: [60, -45], x_hat: 0, P: 100}",
    "reference": "reference: {kind: constant, value: pi/2}",
    "input": "input: {kind: prbs, low: -1, high: 1, hold: 0.5}",
    "methods": """methods:
  S-MPC: {estimator: {kind: kalman}}
  R-MPC: {estimator: {kind: robust-kalman, c: 0.1}, label: "R-MPC, $c=${c}$"}""",
    "model": "model: {kind: servo-linear, noise: {process: 1.0, measurement: 1.0}}",
    "estimator": "estimator: {kind: robust-kalman, c: 0.1}",
    "controller": "controller: {kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1, limits: {u: [-220, 220]}}",
    "sweep": """sweep:
  grid: {controller.Hp: [10, 15], controller.Hu: [3, 8]}
  exclude: [{controller.Hp: 15, controller.Hu: 8}]""",
    "metrics": "metrics: [mse, {kind: input_power, name: power_3_10, from: 3, to: 10}]",
    "evaluate": "evaluate: [runs, moments]",
    "record": "record: {runs: 20, signals: [y, u, x_hat]}",
    "calibration": "calibration: {levels: [50%, 90%, 95%], verdict: 90%, margin: 10%, from: 50}        # or true",
    "statistics": "statistics: {primary: mse, baseline: S-MPC, confidence: 95%, relevant: 1%}",
    "claims": """claims:
  - says: R-MPC is more accurate than S-MPC
    source: Section 4.3, Fig. 7
    check: mean(mse[R-MPC]) < mean(mse[S-MPC])
    finding: confirmed""",
    "figures": "figures: [boxplot, {kind: signals, signals: [y, u], runs: 3}]",
    "report": "report: {order: [R-MPC, S-MPC], metrics: [mse], width: 252pt, style: paper}",
    "execution": "execution: {workers: 2, timeout: {run: 60 s}, max_failures: 0}",
    "smoke": "smoke: {runs: 4, steps: 20}",
}
