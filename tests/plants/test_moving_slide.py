"""The parallel robot as a plant: its twin, another integrator, energy, symmetry, and what ends a run."""

import numba
import numpy as np
import pytest
from conftest import ALL, ROUND
from models import moving_slide_twin as twin
from scipy.integrate import quad_vec, solve_ivp

from rmpc_bench.models import moving_slide_kernel
from rmpc_bench.models.moving_slide import CORNERS
from rmpc_bench.plants import moving_slide
from rmpc_bench.plants.moving_slide import MovingSlide, design
from rmpc_bench.types import DesignError, Plant, Status

SIZES = np.array([0.08, 0.08, 0.3, 0.3, 0.3, 1.0])
SINGULAR = np.arccos(0.08 / 0.30)
"""Angle in the middle at which all arms are tangent to the circle of the platform's corners."""


def moved(plant, x, u, steps=1, w=None, **changed):
    """States (runs, steps + 1, nx) with the torques (runs, steps, nu), and the last statuses."""
    parameters = {name: np.full(len(x), changed.get(name, value)) for name, value in plant.nominal.items()}
    delta, states = plant.draw(parameters, [], steps), [x]
    for k in range(steps):
        motion = plant.step(k, delta, states[-1], u[:, k], np.zeros_like(x) if w is None else w)
        states.append(motion.x)
    return np.stack(states, axis=1), motion.status


def start(rng, runs=8):
    """States all over the workspace, and torques of 0.3 N m."""
    return rng.uniform(-1.0, 1.0, (runs, 6)) * SIZES, 0.3 * rng.standard_normal((runs, 1, 4))


def test_what_it_offers():
    """Oracle: the base class; the kernel is compiled and the shape checks do not wrap it."""
    plant = design(0.01)
    assert isinstance(plant, Plant) and plant.has_singular_poses
    assert (plant.nx, plant.nu, plant.ny, plant.nw, plant.nv) == (6, 4, 3, 6, 3)
    assert (plant.y_unit, plant.u_unit, plant.units["y.2"], plant.units["x.3"]) == ("", "N m", "rad", "m/s")
    assert isinstance(moving_slide_kernel.slide_step_kernel, numba.core.registry.CPUDispatcher)
    assert hasattr(design, "__wrapped__") == ALL


@pytest.mark.parametrize("keys", [{}, {"substeps": 3, "mass": 0.4, "a": 0.33, "d_sl": 3.0}])
def test_the_kernel_equals_its_plain_twin(rng, keys):
    """Oracle: the twin, one run at a time; 1e-12 of velocities of a few rad/s."""
    plant, (x, u) = design(0.05, **keys), start(rng)
    p = twin.robot(**{name: value for name, value in keys.items() if name != "substeps"})
    states, status = moved(plant, x, u)
    np.testing.assert_array_equal(status, np.zeros(len(x)))
    for i in range(len(x)):
        expected = twin.step(p, x[i], u[i, 0], 0.05, plant.substeps)
        np.testing.assert_allclose(states[i, 1], expected, rtol=0.0, atol=1e-12)


def reference(p, x, u, Ts):
    """State after a sample by DOP853 with the tightest tolerances."""
    return solve_ivp(lambda t, z: twin.slope(p, z, u), (0.0, Ts), x, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def test_it_follows_another_integrator(rng):
    """Oracle: DOP853; two steps in 0.01 s leave 1e-9 of the velocity, and 1e-11 m where the platform is quick."""
    x, u = start(rng, runs=4)
    states, _ = moved(design(0.01), x, u)
    off = np.abs([states[i, 1] - reference(twin.robot(), x[i], u[i, 0], 0.01) for i in range(len(x))])
    assert off[:, :2].max() < 1e-11 and off.max() < 1e-9


def test_its_error_is_of_fourth_order(rng):
    """Oracle: DOP853 over 0.1 s; twice the substeps, a sixteenth of the error, within a third."""
    x, u = start(rng, runs=3)
    exact = np.array([reference(twin.robot(), x[i], u[i, 0], 0.1) for i in range(len(x))])
    errors = [np.abs(moved(design(0.1, substeps=n), x, u)[0][:, 1] - exact).max() for n in (2, 4, 8)]
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 16.0, rtol=0.33)


def test_energy_of_free_motion_is_kept(rng):
    """Oracle: nothing is damped, nothing drives; 0.4 s in steps that leave rounding alone."""
    p, (x, u) = twin.robot(d_rot=0.0, d_sl=0.0), start(rng, runs=4)
    states, _ = moved(design(0.002, d_rot=0.0, d_sl=0.0), 0.3 * x, np.tile(0.0 * u, (1, 200, 1)), 200)
    for run in states:
        np.testing.assert_allclose(twin.energy(p, run[-1]), twin.energy(p, run[0]), rtol=1e-11)


def test_work_of_the_torques_becomes_kinetic_energy(rng):
    """Oracle: a held torque does tau times the angle that its arm turns by, sample after sample."""
    p, (x, _) = twin.robot(d_rot=0.0, d_sl=0.0), start(rng, runs=3)
    u = 0.1 * rng.standard_normal((3, 50, 4))
    states, _ = moved(design(0.01, d_rot=0.0, d_sl=0.0, substeps=5), 0.3 * x, u, 50)
    for run, torques in zip(states, u, strict=True):
        theta = np.array([twin.angles(p, state[:3])[0] for state in run])
        turned = np.remainder(np.diff(theta, axis=0) + np.pi, 2 * np.pi) - np.pi
        gained = twin.energy(p, run[-1]) - twin.energy(p, run[0])
        np.testing.assert_allclose((torques * turned).sum(), gained, atol=1e-11)  # J, of about 0.1 J


def test_damping_takes_what_is_lost(rng):
    """Oracle: as above, less the integral of the power of the dampers along the path of DOP853."""
    p, (x, u) = twin.robot(), start(rng, runs=2)
    states, _ = moved(design(0.1, substeps=50), x, u)
    for i, run in enumerate(states):
        path = solve_ivp(
            lambda t, z, i=i: twin.slope(p, z, u[i, 0]), (0.0, 0.1), x[i], "DOP853",
            rtol=1e-12, atol=1e-13, dense_output=True,
        ).sol  # fmt: skip
        lost = quad_vec(lambda t, path=path: twin.lost(p, path(t)), 0.0, 0.1, epsabs=1e-11)[0]
        theta = [twin.angles(p, state[:3])[0] for state in run]
        gained = twin.energy(p, run[1]) - twin.energy(p, run[0])
        np.testing.assert_allclose(u[i, 0] @ (theta[1] - theta[0]) - lost, gained, atol=1e-9)  # of the dense output


def test_a_quarter_turn_permutes_the_arms(rng):
    """Oracle: symmetry; the robot turned by 90 degrees is itself with arm 2 for arm 1, and its mirror likewise."""
    plant, (x, u) = design(0.02), start(rng)
    R = np.kron(np.eye(2), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    ahead = moved(plant, x, u)[0][:, 1]
    np.testing.assert_allclose(moved(plant, x @ R.T, np.roll(u, 1, axis=2))[0][:, 1], ahead @ R.T, atol=1e-14)
    mirror = np.kron(np.eye(2), np.diag([-1.0, 1.0, -1.0]))
    swapped = -u[:, :, [1, 0, 3, 2]]
    np.testing.assert_allclose(moved(plant, x @ mirror, swapped)[0][:, 1], ahead @ mirror, atol=1e-14)


def test_process_noise_is_added_at_the_end(rng):
    """Oracle: the step without it."""
    plant, (x, u), w = design(0.01), start(rng), 1e-3 * rng.standard_normal((8, 6))
    np.testing.assert_array_equal(moved(plant, x, u, w=w)[0][:, 1], moved(plant, x, u)[0][:, 1] + w)
    delta, v = plant.draw({name: np.ones(8) for name in plant.nominal}, [], 1), rng.standard_normal((8, 3))
    np.testing.assert_array_equal(plant.output(0, delta, x, v), x[:, :3] + v)


@pytest.mark.parametrize("psi", [0.0, 0.5, -1.2, SINGULAR - 1e-3, SINGULAR, -SINGULAR, SINGULAR + 1e-9])
def test_the_smallest_singular_value_in_the_middle(psi):
    """Oracle: by hand; there the columns of J are orthogonal, and the third has four entries (d p)/l^2, also 0."""
    turn, l2 = 0.08 * (0.08 - 0.30 * np.cos(psi)), 0.30**2 + 0.08**2 - 2 * 0.30 * 0.08 * np.cos(psi)
    sigma = design(0.01).manipulability(np.array([[0.0, 0.0, psi]]))
    np.testing.assert_allclose(sigma, [abs(2 * turn / l2)], rtol=1e-12, atol=1e-15)


def test_the_smallest_singular_value_anywhere(rng):
    """Oracle: numpy.linalg.svd of the twin's J; poses with two equal values among them."""
    y = rng.uniform(-1.0, 1.0, (200, 3)) * [0.15, 0.15, 1.5]
    y[:10, :2] = 0.0
    expected = [np.linalg.svd(twin.matrices(twin.robot(), np.append(each, np.zeros(3)))[2])[1][2] for each in y]
    np.testing.assert_allclose(design(0.01).manipulability(y), expected, rtol=1e-12, atol=1e-14)


def test_what_the_kernel_has_a_copy_of():
    """Oracle: the numbers that Python has; compiled code cannot read a Status or an array of another module."""
    assert moving_slide_kernel.LEAST_SIGMA == moving_slide.LEAST_SIGMA
    for name in ("OK", "DIVERGED", "OUT_OF_RANGE", "SINGULAR"):
        assert getattr(moving_slide_kernel, name) == Status[name]
    np.testing.assert_array_equal(np.transpose([moving_slide_kernel.SIGN_X, moving_slide_kernel.SIGN_Y]), CORNERS)


def test_what_ends_a_run():
    """Oracle: a pose for each reason, at rest; the singular value is 0.02 at 0.036 rad from where it is 0."""
    poses = np.zeros((8, 6))
    poses[1, 2], poses[2, 2], poses[3, 2] = SINGULAR, SINGULAR - 0.035, SINGULAR - 0.038
    poses[4, :2], poses[5, 0] = 0.21, 0.23  # arms of 0.014 m and of 0.501 m
    poses[6, 3], poses[7, 0] = 150.0, np.nan
    _, status = moved(design(0.01), poses, np.zeros((8, 1, 4)))
    expected = ["ok", "singular", "singular", "ok", "out-of-range", "out-of-range", "diverged", "diverged"]
    assert [Status(each).word for each in status] == expected


@pytest.mark.parametrize(
    ("name", "bad", "good"),
    [("mass", 0.0, 1.5), ("I_arm", -0.1, 0.05), ("a", np.nan, 0.31), ("d_rot", -1e-9, 0.0), ("d_sl", np.inf, 0.0)],
)
def test_a_parameter_without_meaning_ends_its_run(name, bad, good):
    """Oracle: the status of that run alone; the others are what they are alone."""
    plant, x, u = design(0.01), np.full((3, 6), 0.01), np.full((3, 4), 0.1)
    parameters = {each: np.full(3, value) for each, value in plant.nominal.items()}
    parameters[name] = np.array([good, bad, plant.nominal[name]])
    motion = plant.step(0, plant.draw(parameters, [], 1), x, u, np.zeros((3, 6)))
    assert [Status(each).word for each in motion.status] == ["ok", "out-of-range", "ok"]
    alone = design(0.01, **{name: good})
    np.testing.assert_array_equal(motion.x[:1], moved(alone, x[:1], u[:1, None])[0][:, 1])
    assert not np.array_equal(motion.x[0], motion.x[2])


def test_a_reference_out_of_reach():
    """Oracle: by hand; |r - A_i| of the arm that is named, at the first sample beyond, in seconds."""
    plant, r = design(0.01), np.zeros((500, 3))
    assert plant.unreachable(r) is None
    r[342:, 0] = 0.23  # A_2 = (-0.3, 0.3) is (0.45, -0.22) away from its corner
    assert "at 3.42 s arm 2 would be 0.5009 m long; its range is 0.05 to 0.5 m" in str(plant.unreachable(r))
    assert "its range is 0.05 to 0.45 m" in str(design(0.01, arm=0.45).unreachable(r))
    r[100:, :2] = 0.20  # A_1 is 0.028 m from the corner
    assert "at 1 s arm 1 would be 0.02828 m long" in str(plant.unreachable(r))


def test_a_reference_through_a_singular_pose():
    """Oracle: the angle acos(b/a); what comes first is told, and an arm before a pose that it cannot have."""
    plant, r = design(0.01), np.zeros((500, 3))
    r[200:, 2] = np.deg2rad(74.53)
    message = str(plant.unreachable(r))
    assert message.startswith("at 2 s the pose (0, 0, 1.301) is singular") and "below 0.02" in message
    r[300:, 0] = 0.5
    assert str(plant.unreachable(r)) == message
    r[100:, :2] = 0.22  # a corner on a base joint: no length, and no J
    assert "at 1 s arm 1 would be 0 m long" in str(plant.unreachable(r))


def test_a_slide_needs_room():
    """The shortest arm must be shorter than the longest."""
    with pytest.raises(DesignError, match="must be below the length of an arm, 0.5 m") as caught:
        design(0.01, l_min=0.5)
    assert caught.value.parameter == "l_min"


def test_its_picture():
    """Oracle: the corners of the base, and arms that end where the platform's corners are."""
    plan, path = design(0.01).plots()
    lines = {line.label: line for line in plan.lines}
    robot, base = lines["the robot at 0 s"], lines["base joints"]
    np.testing.assert_array_equal(np.abs([base.x, base.y]), np.full((2, 4), 0.30))
    assert base.dots and base.notes == ("$A_1$", "$A_2$", "$A_3$", "$A_4$") and plan.equal and path.equal
    assert np.isnan(robot.x).sum() == 4 and len(robot.x) == 17
    ends, corners = np.arange(1, 12, 3), np.arange(12, 16)
    np.testing.assert_array_equal(robot.x[ends], robot.x[corners])
    np.testing.assert_allclose(np.hypot(np.diff(robot.x[12:]), np.diff(robot.y[12:])), 0.16, **ROUND)
    centre = (robot.x[corners].mean(), robot.y[corners].mean())
    np.testing.assert_allclose(centre, (lines["path of the centre"].x[0], lines["path of the centre"].y[0]), atol=1e-15)
    assert path.lines[1].notes == tuple("012345678")


def test_warming_up_changes_nothing(rng):
    """Oracle: a step of a plant that has not been warmed up."""
    warm, (x, u) = design(0.01), start(rng)
    warm.warm_up()
    np.testing.assert_array_equal(moved(warm, x, u)[0], moved(MovingSlide(0.01, warm.nominal, 2), x, u)[0])
