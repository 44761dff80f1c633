"""The picture of the friction against (20) and (21) as printed."""

import math

import numpy as np
import pytest

from rmpc_bench.plants import servo
from rmpc_bench.plants.servo import friction_profile, friction_profiles

TABLE_2 = {"load": (0.5, 10.0, 0.5), "motor": (0.1, 2.0, 0.5)}


def printed(w, a0, a1, a2):
    """Return the torque of (20) with the sign function of the paper, which is 0 at rest."""
    sgn = int(w > 0) - int(w < 0)
    return a0 * sgn + a1 * math.exp(-a2 * abs(w)) * sgn


def test_profiles_of_both_bodies():
    """Slipping: the printed formula with a gap at 0; at rest: the interval between its limits."""
    panels = friction_profiles(servo.design(0.1).nominal)
    assert [panel.title for panel in panels] == ["load: sticks up to 10.5 N m", "motor: sticks up to 2.1 N m"]
    for alpha, panel in zip(TABLE_2.values(), panels, strict=True):
        slipping, at_rest = panel.lines
        moving = slipping.x != 0.0
        assert slipping.y[moving] == pytest.approx([printed(w, *alpha) for w in slipping.x[moving]], rel=1e-14)
        limit = alpha[0] + alpha[1]
        assert slipping.y[~moving] == pytest.approx([-limit, math.nan, limit], nan_ok=True)
        assert (list(at_rest.x), list(at_rest.y)) == ([0, 0], [-limit, limit])
        assert (np.diff(slipping.x) >= 0).all() and moving.sum() > 100


@pytest.mark.parametrize("alpha", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (1.0, 2.0, 0.0)])
def test_profile_without_a_decay(alpha):
    """Coulomb friction alone, or none."""
    slipping, _ = friction_profile("body", "b", alpha).lines
    assert np.isfinite(slipping.x).all() and slipping.x[-1] == 1.0
    assert np.nanmax(slipping.y) == alpha[0] + alpha[1]
