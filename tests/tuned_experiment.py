"""A scalar system whose measurement noise the Kalman filter does not know, as YAML text with a section `tune`."""

from small_experiment import cli

STD = 3.0
"""Standard deviation of the measurement noise; the design model of the file says 1."""
KEYS = {
    "version": "1",
    "name": "tuned",
    "seed": "3",
    "runs": "8",
    "time": "{steps: 30}",
    "plant": "{kind: uncertain-linear, A: 0.9, B: 1, C: 1, Bw: 1, Dv: 1}",
    "model": "{kind: linear, A: 0.9, B: 1, C: 1, P_w: 1, P_v: 1}",
    "noise": "{process: {gaussian: {std: 1}}, measurement: {gaussian: {std: 3}}}",
    "initial": "{x: 0, x_hat: 0, P: 1}",
    "methods": "{KF: {estimator: {kind: kalman}}, KFR: {estimator: {kind: kalman}, tune: {model.P_v: [0.01, 1000]}}}",
    "metrics": "[estimation_mse]",
    "figures": "[]",
    "tune": "{budget: 6, runs: 5}",
}


def text(**keys):
    """YAML text with some top-level keys replaced or added; None leaves a key out."""
    lines = KEYS | {name: str(value) for name, value in keys.items() if value is not None}
    return "".join(f"{name}: {value}\n" for name, value in lines.items() if keys.get(name, "") is not None)


def write(directory, *, file="tuned.yaml", **keys):
    """Write the text into a file and return its path."""
    path = directory / file
    path.write_text(text(**keys), encoding="utf-8")
    return path


def run(path, directory, *options):
    """Call `rmpc-bench run` into a directory and return its result; anything but exit 0 fails the test."""
    result = cli("run", path, "-o", directory, "--progress", "none", "--no-report", *options)
    assert result.exit_code == 0, result.output
    return result


def record(directory):
    """Return the bytes of tuning.json."""
    return (directory / "tuning.json").read_bytes()
