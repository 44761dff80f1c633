"""The set-membership filter: the paper's system, containment of the true state, limits and a scan by brute force."""

import numpy as np
import pytest
from conftest import EXACT, random_model, random_psd
from estimators.mixed_systems import (
    P0,
    START,
    N,
    estimates,
    in_ellipsoid,
    paper_model,
    random_mixed,
    simulated,
    volume_and_trace,
)

from rmpc_bench.estimators.mixed import design as mixed
from rmpc_bench.estimators.set_membership import IntersectionFilter, design
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.types import DesignError, Status

INTERSECTION = {"update": "maksarov-norton", "inflate": False}
UPDATES = pytest.mark.parametrize(
    "update", [{"inflate": False}, INTERSECTION, INTERSECTION | {"criterion": "volume"}], ids=["linear", "trace", "det"]
)
SIZES = pytest.mark.parametrize(("nx", "ny"), [(1, 1), (2, 1), (3, 2), (2, 3)])


def test_volume_and_trace_on_the_papers_system():
    """Oracle: an independent implementation, mixed-noise.md section 1; Table I has 1869.2 and 111.258."""
    ours = design(paper_model(), N, **START)
    volume, trace = volume_and_trace(ours.M)
    assert (round(volume, 1), round(trace, 2)) == (1879.0, 110.98)
    assert ours.P is None and ours.sets.level == 0.95


def test_volume_and_trace_without_stochastic_noise():
    """Oracle: mixed-noise.md section 1, by this filter and by `mixed` with P = 0."""
    quiet = {"P_w": 0.0, "P_v": 0.0}
    for ours in (
        design(paper_model(), N, **START, inflate=False),
        mixed(paper_model(**quiet), N, **(START | {"P0": 0.0 * P0})),
        design(paper_model(**quiet), N, **(START | {"P0": 0.0 * P0})),
    ):
        volume, trace = volume_and_trace(ours.M)
        assert (round(volume, 2), round(trace, 3)) == (295.44, 44.318)


@UPDATES
@SIZES
def test_the_state_stays_inside(update, nx, ny, rng):
    """Oracle: the definition, in 400 runs of noise that obeys its bounds, inside and on them."""
    model = random_mixed(rng, nx, ny, w_mean=0.5, v_mean=-0.5)
    M0 = random_psd(rng, nx)
    ours = design(model, 6, x0=np.ones(nx), P0=np.eye(nx), M0=M0, **update)
    for surface in (False, True):
        start = 1.0 + in_ellipsoid(rng, M0, 400, surface)
        x, y = simulated(rng, model, 400, 6, start, stochastic=False, surface=surface)
        for k, each in enumerate(estimates(ours, y)):
            error = each.x_hat - x[:, k]
            M = np.broadcast_to(each.M, (400, nx, nx))
            distance = np.einsum("ri,rij,rj->r", error, np.linalg.inv(M), error)
            assert (each.status == Status.OK).all() and each.P is None
            assert distance.max() <= 1.0 + 1e-7  # inverses of sets that the data have made thin


@pytest.mark.parametrize("criterion", ["trace", "volume"])
def test_the_intersection_is_the_best_of_a_scan(criterion, rng):
    """Oracle: (1 - lam) M^-1 + lam C' M_v^-1 C with its full square, at 1000 values of lam, along a whole run."""
    model = random_mixed(rng, 2, 1)
    ours = design(model, 6, x0=np.zeros(2), P0=np.eye(2), M0=np.eye(2), criterion=criterion, **INTERSECTION)
    _, y = simulated(rng, model, 5, 6, in_ellipsoid(rng, np.eye(2), 5), stochastic=False)
    state, size = ours.init(5), np.trace if criterion == "trace" else np.linalg.det
    for k in range(7):
        C, inv_v = model.at(k).C, np.linalg.inv(model.M_v(k))
        after, each = ours.correct(k, state, y[:, k])
        for i in range(5):
            best, e = np.inf, y[i, k] - C @ state.x[i]
            for lam in np.linspace(0.0, 0.9995, 1000):
                X = np.linalg.inv((1 - lam) * np.linalg.inv(state.M[i]) + lam * C.T @ inv_v @ C)
                b = lam * C.T @ inv_v @ e
                best = min(best, size((1 - lam * e @ inv_v @ e + b @ X @ b) * X))
            np.testing.assert_allclose(size(each.M[i]), best, rtol=1e-4)  # 1/1000 beside a minimum
            assert size(each.M[i]) <= best * (1 + 1e-9)  # inverses
        state = ours.predict(k, after, np.zeros((5, 1)))


def test_a_surprise_shrinks_the_set():
    """Oracle: by hand; of two measurements the less likely one leaves fewer states, which linear gains do not see."""
    model = mixed_model(0, A=1.0, C=1.0, M_v=1.0)
    ours = design(model, 0, x0=np.zeros(1), P0=np.eye(1), M0=np.eye(1), **INTERSECTION)
    sizes = ours.correct(0, ours.init(4), np.array([[0.0], [1.0], [1.5], [1.99]]))[1].M[:, 0, 0]
    assert (np.diff(sizes) < 0).all() and sizes[-1] < 0.02
    np.testing.assert_allclose(sizes[2], 0.4375, rtol=1e-11)  # lam = 1/2: 1 - 1.5^2 / 4; MARGIN


def test_sets_without_a_common_state(rng):
    """Oracle: by hand; |y| > 1 + 1 cannot be, the others do not notice, and the set stays the predicted one."""
    model = mixed_model(3, A=0.5, C=1.0, M_w=1.0, M_v=1.0)
    ours = design(model, 3, x0=np.zeros(1), P0=np.eye(1), M0=np.eye(1), **INTERSECTION)
    state, each = ours.correct(0, ours.init(4), np.array([[0.5], [2.1], [-1.9], [-2.001]]))
    np.testing.assert_array_equal(each.status, [Status.OK, Status.EMPTY_SET, Status.OK, Status.EMPTY_SET])
    assert Status.EMPTY_SET == 4 and Status.EMPTY_SET.word == "empty-set"
    np.testing.assert_array_equal(each.x_hat[[1, 3]], 0.0)
    np.testing.assert_array_equal(each.M[[1, 3]], 1.0)
    alone = ours.correct(0, ours.init(1), np.array([[0.5]]))[1]
    np.testing.assert_array_equal(alone.M, each.M[:1])


def test_a_measurement_without_information_leaves_the_prediction(rng):
    """Oracle: (16) and (18) written out."""
    model = random_mixed(rng, 2, 1, M_v=1e12)
    ours = design(model, 6, x0=np.ones(2), P0=np.eye(2), M0=np.eye(2), **INTERSECTION)
    x, M = np.ones(2), np.eye(2)
    for k, each in enumerate(estimates(ours, rng.standard_normal((3, 7, 1)))):
        np.testing.assert_allclose(each.x_hat, np.tile(x, (3, 1)), atol=1e-12)
        np.testing.assert_allclose(each.M, np.tile(M, (3, 1, 1)), rtol=1e-11)  # seven periods of rounding
        moved = model.at(k).A @ M @ model.at(k).A.T
        p = np.sqrt(np.trace(moved) / np.trace(model.M_w(k)))
        x, M = model.at(k).A @ x, (1 + 1 / p) * moved + (1 + p) * model.M_w(k)


def test_y0_is_left_out_on_request(rng):
    """Oracle: the start itself, whatever y(0); y(1) counts."""
    ours = design(paper_model(), N, **START, **INTERSECTION)
    y = np.zeros((2, 2, 1))
    y[1, 0] = 1e6
    first, second = estimates(ours, y)
    np.testing.assert_allclose(first.M[1], START["M0"], **EXACT)
    np.testing.assert_array_equal(second.M[0], second.M[1])
    assert (first.status == Status.OK).all()


def test_a_model_without_sets_needs_inflation(rng):
    """Oracle: with a level it is the filter for ellipsoids of the covariances; without one there is no noise at all."""
    plain = random_model(rng, 2, 1, 1)
    start = {"x0": np.zeros(2), "P0": np.eye(2), "M0": np.zeros((2, 2))}
    c2, c1 = 5.991464547107983, 3.841458820694124
    bounded = mixed_model(9, A=plain.A, C=plain.C, M_w=c2 * plain.Q_w, M_v=c1 * plain.R_v)
    theirs = design(bounded, 9, x0=np.zeros(2), P0=np.eye(2), M0=c2 * np.eye(2), inflate=False)
    np.testing.assert_allclose(design(plain, 9, **start).M, theirs.M, rtol=1e-9)  # digits of the quantiles
    with pytest.raises(DesignError, match="singular at k = 0"):
        design(plain, 9, **start, inflate=False)


def test_what_the_updates_do_not_take():
    """Oracle: the parameter to blame, or the k."""
    start = {"x0": np.zeros(2), "P0": np.eye(2), "M0": np.eye(2)}
    with pytest.raises(DesignError, match="other criteria need") as caught:
        design(paper_model(), N, **start, criterion="volume")
    assert caught.value.parameter == "criterion"
    flat = mixed_model(3, A=[0.5, 0.5], C=1.0, M_w=1.0, M_v=[1.0, 0.0])
    design(flat, 3, **start, inflate=False)
    with pytest.raises(DesignError, match="M_v is singular at k = 0"):
        design(flat, 3, **start, **INTERSECTION)


def test_the_design_says_what_a_controller_asks():
    """Oracle: the agreement; `sets` there, P and M None where they are not shared by all runs."""
    ours = design(paper_model(), N, **START, update="maksarov-norton")
    assert isinstance(ours, IntersectionFilter)
    assert ours.P is None and ours.M is None
    np.testing.assert_array_equal(ours.sets.process(0), design(paper_model(), N, **START).sets.process(0))
