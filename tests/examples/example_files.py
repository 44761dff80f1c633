"""The files below configs/examples, as Python modules and as configurations."""

import importlib.util
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "configs" / "examples"


def module_of(name):
    """Execute FOLDER/name.py."""
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def recursion(estimator, model, measurements, inputs, x0, P0):
    """Estimates of a batch estimator of one run."""
    state, found = estimator.init(1), []
    for k, y in enumerate(measurements):
        state, answer = estimator.correct(k, state, y[None])
        found.append(answer.x_hat[0])
        state = estimator.predict(k, state, inputs[k][None])
    return found
