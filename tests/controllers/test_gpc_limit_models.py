"""Limits of gpc with models of every kind: operating points, estimated means, trajectories, signals, units."""

import numpy as np
import pytest
from conftest import random_model
from controllers.gpc_limit_cases import KEYS, NP
from controllers.gpc_twin import Varying, commands

from rmpc_bench.controllers.gpc import design
from rmpc_bench.controllers.limits import Limits, SoftLimit
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.models.linearised import design as linearise
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.operating_point import At
from rmpc_bench.models.state_dependent import Pair, StateDependentModel
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.types import Estimate, Estimator, OperatingPoint, OptimisedStep, PlantInfo

CLOSE = {"rtol": 0.0, "atol": 1e-9}
STEPS = 8


class EstimatesMean(Estimator):
    """An estimator that estimates the mean of the process noise."""

    estimates_mean = True


def stable(rng):
    """A model of three states."""
    m = random_model(rng, 3, 2, 2)
    return LinearModel(0.8 * m.A / np.abs(np.linalg.eigvals(m.A)).max(), m.B, m.C, m.Q_w, m.R_v)


def shifted(pairs, by):
    """Pairs of limits, moved."""
    return [(low + each, high + each) for (low, high), each in zip(pairs, by, strict=True)]


@pytest.mark.parametrize("tuning", [{}, {"tuning": LpNoise(Ne2=3, kp=1e-3)}], ids=["constant", "tuned"])
@pytest.mark.parametrize("enforce", ["clip", "qp"])
def test_limits_are_those_of_the_inputs_and_signals_themselves(tuning, enforce, rng):
    """Oracle: the model of the deviations from an operating point, with limits that are moved by it."""
    m, u, z = stable(rng), [(-0.4, 0.5), (-0.3, 0.3)], [(-0.2, 0.3)]
    point = OperatingPoint(*(3.0 * rng.standard_normal(n) for n in (3, 2, 2)))
    there = LinearisedModel(m.A, m.B, m.C, m.Q_w, m.R_v, point=point)
    x, y, r = rng.standard_normal((5, STEPS, 3)), rng.standard_normal((5, STEPS, 2)), np.ones((STEPS + NP + 1, 2))
    found = []
    for model, by_x, by_u, by_y in ((m, 0.0, 0.0, 0.0), (there, point.x, point.u, point.y)):
        moved = by_u + np.zeros(2), by_x + np.zeros(3), by_y + np.zeros(2)
        soft = {"x.1": SoftLimit(shifted(z, moved[1][1:2]), 0.1), "y.0": SoftLimit(shifted(z, moved[2][:1]), 0.1)}
        limits = Limits(u=shifted(u, moved[0]), du=(-0.3, 0.4), enforce=enforce)
        controller = design(model, STEPS, **KEYS, **tuning, limits=limits, soft=soft if enforce == "qp" else None)
        low, high = controller.input_limits
        np.testing.assert_allclose([low, high], np.array(limits.u).T, **CLOSE)
        found.append((by_u, commands(controller, x + by_x, y + by_y, r + by_y)))
    for here, moved in zip(found[0][1], found[1][1], strict=True):
        np.testing.assert_allclose(here.u + point.u, moved.u, **CLOSE)
        assert enforce == "clip" or here.info["qp"].tolist() == moved.info["qp"].tolist()
    if enforce == "qp":
        assert {OptimisedStep.SOLVED, OptimisedStep.SOFTENED} & {
            int(c) for each in found[0][1] for c in each.info["qp"]
        }


@pytest.mark.parametrize("varies", [False, True])
def test_an_estimated_mean_is_part_of_the_predictions(varies, rng):
    """Oracle: the model that has this mean as its constant part."""
    m, mean = stable(rng), 0.1 * rng.standard_normal(3)
    known = LinearModel(m.A, m.B, m.C, m.Q_w, m.R_v, f0=mean)
    keys = {**KEYS, "limits": Limits(u=(-0.3, 0.3), enforce="qp"), "soft": {"y.1": SoftLimit((-0.2, 0.2), 0.1)}}
    x, r = rng.standard_normal((9, 3)), np.ones((NP + 1, 2))
    models = [Varying([each] * STEPS) if varies else each for each in (m, known)]
    steps = None if varies else STEPS
    ours, theirs = design(models[0], steps, EstimatesMean(), **keys), design(models[1], steps, **keys)
    info = {"w_mean": np.tile(mean, (9, 1))}
    estimate = Estimate(x, None, None, np.zeros(9, dtype=np.int8), info)
    u, expected = (each.control(0, each.init(9), np.zeros((9, 2)), estimate, r)[1] for each in (ours, theirs))
    np.testing.assert_allclose(u.u, expected.u, **CLOSE)
    assert u.info["qp"].tolist() == expected.info["qp"].tolist()
    assert len(set(u.info["qp"])) > 1


def oscillator(x, u, p):
    """A linear equation with a constant part."""
    return [x[1], u[0] - 0.3 * x[1] - 0.5 * x[0] + 0.2]


def moved_output(x, p):
    """A linear output with a constant part."""
    return [x[0] + 0.5 * x[1] + 0.7]


@pytest.mark.parametrize("signal", ["x.1", "y.0", "b", "y1", "own"])
def test_a_linear_equation_on_a_trajectory_is_the_linear_model(signal, rng):
    """Oracle: the constant model at 0; the predictions on a trajectory have the outputs as states."""
    plant = ode_plant(0.3, STEPS, ode=oscillator, output=moved_output, states=["a", "b"], inputs=["f"], outputs=["y1"])
    noise, found = DesignNoise(process=1e-6, measurement=4e-6), []
    of = [0.5, -1.0] if signal == "own" else None
    x, r = rng.standard_normal((7, STEPS, 2)), rng.standard_normal((STEPS + 6, 1))
    for at in ("trajectory", At(x=0.0, u=0.0)):
        model = linearise(0.3, plant, noise=noise, at=at)
        soft = {signal: SoftLimit((-0.4, 0.6), 0.05, of=of, steps=4)}
        limits = Limits(u=(-1.0, 1.0), enforce="qp")
        info = PlantInfo.of(plant)
        controller = design(model, STEPS, plant_info=info, Np=5, Q_yw=1.0, Q_u=0.2, limits=limits, soft=soft)
        found.append(commands(controller, x, np.zeros((7, STEPS, 1)), r))
    for ours, expected in zip(*found, strict=True):
        np.testing.assert_allclose(ours.u, expected.u, rtol=1e-6, atol=1e-8)  # of the differences of `linearise`
        assert ours.info["qp"].tolist() == expected.info["qp"].tolist()
    assert OptimisedStep.SOFTENED in np.array([each.info["qp"] for each in found[0]])


class Named(StateDependentModel):
    """A model of constant matrices that names a signal."""

    largest = 1e6

    def __init__(self, m):
        self.m, self.nx, self.nu, self.ny, self.C, self.Q_w, self.R_v = m, m.nx, m.nu, m.ny, m.C, m.Q_w, m.R_v
        self.extra_signals = m.extra_signals

    def at_state(self, x):
        """The same pair everywhere."""
        return Pair(*(np.tile(matrix, (len(x), 1, 1)) for matrix in (self.m.A, self.m.B)))


def test_a_signal_that_the_model_names_is_that_of_its_rows(rng):
    """Oracle: the same rows given with `of`; the constant and the state-dependent law agree."""
    m, Z = stable(rng), rng.standard_normal((2, 3))
    m = LinearModel(m.A, m.B, m.C, m.Q_w, m.R_v, extra_signals={"twist": Z})
    x, r, found = rng.standard_normal((9, STEPS, 3)), np.ones((STEPS + NP + 1, 2)), []
    for model in (m, Named(m)):
        for name, of in (("twist", None), ("own", Z.tolist())):
            soft = {name: SoftLimit([(-0.2, 0.2), (-0.1, 0.3)], 0.1, of=of)}
            controller = design(model, STEPS, **KEYS, limits=Limits(enforce="qp"), soft=soft)
            found.append([each.u for each in commands(controller, x, np.zeros((9, STEPS, 2)), r)])
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[2], found[3])
    np.testing.assert_allclose(found[0], found[2], **CLOSE)
    free = commands(design(m, STEPS, **KEYS), x, np.zeros((9, STEPS, 2)), r)
    assert np.abs(np.array([each.u for each in free]) - found[0]).max() > 1e-2


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_units_do_not_matter(size, rng):
    """Oracle: the same problem in other units of inputs, states and cost; the solver has absolute tolerances."""
    m = stable(rng)
    small = LinearModel(m.A, size * m.B, m.C, m.Q_w, m.R_v)
    x, r = rng.standard_normal((40, 3)), np.ones((NP + 1, 2))
    found = []
    for model, unit, Q, factor in ((m, 1.0, 1.0, 1.0), (small, 1.0 / size, 1e-4, 1e-8)):
        keys = {"Np": NP, "Q_yw": Q, "Q_u": 0.3 * Q / unit}
        limits = Limits(u=(-0.4 * unit, 0.5 * unit), du=(-0.3 * unit, 0.3 * unit), enforce="qp")
        soft = {"x.1": SoftLimit((-0.3, 0.3), 0.05 * factor, quadratic=0.1 * factor)}
        for each in (model, Named(model)):
            controller = design(each, STEPS, **keys, limits=limits, soft=soft)
            state = controller.init(40)
            estimate = Estimate(x, None, None, np.zeros(40, dtype=np.int8), {})
            found.append(controller.control(0, state, np.zeros((40, 2)), estimate, r)[1].u / unit)
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], **CLOSE)
