"""A small uncertain linear system to be estimated, as YAML text; it lies in a file of its own for others to take."""

from small_experiment import write

PLANT = (
    "{kind: uncertain-linear, A: [[0.9, 0.2], [0, 0.7]], Bw: [[1], [0.5]], C: [[1, 0]], Dv: 1, "
    "H_A: [[0], [0.1]], G_x: [[1, 0]], uncertainty: {law: uniform, low: -1, high: 1}}"
)
MODEL = "{from: plant, W: 1, V: 1}"
INITIAL = "{x: {gaussian: {mean: [1, 0], cov: 1}}, x_hat: [1, 0], P: 1}"
METHODS = (
    "{KF: {estimator: {kind: kalman-predictor}}, ERP: {estimator: {kind: enhanced-robust, rule: state, gamma: 5}}}"
)
KEYS = {
    "name": "estimation",
    "runs": "6",
    "time": "{steps: 12}",
    "uncertainty": None,
    "plant": PLANT,
    "model": MODEL,
    "noise": "same",
    "initial": INITIAL,
    "reference": None,
    "controller": None,
    "methods": METHODS,
    "metrics": "[estimation_mse]",
    "figures": "[]",
}
TAKEN = dict.fromkeys(("model", "noise", "initial"))
"""Keys that leave these sections to the file that the plant comes from."""


def write_estimation(directory, *, file="estimation.yaml", **keys):
    """Write the experiment with some top-level keys replaced or added; None leaves a key out."""
    return write(directory, file=file, **(KEYS | keys))


def write_taking(directory, plant, *, file="taking.yaml", **keys):
    """Write an experiment that takes plant, model, noise and start from elsewhere."""
    return write_estimation(directory, file=file, **(TAKEN | {"plant": plant} | keys))
