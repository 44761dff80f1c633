"""What a model without uncertainty looks like as an uncertain system."""

import numpy as np
from conftest import random_model, random_psd
from estimators.uncertain_oracles import random_uncertain

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_linear import design_systems
from rmpc_bench.models.uncertain_system import CHANNELS


def test_a_plain_model_is_a_system_without_uncertainty(rng):
    """Oracle: the noises of the system are those of the model, and all H and G are zero."""
    joint = random_psd(rng, 5)
    m = random_model(rng, 3, 1, 2)
    model = LinearModel(m.A, m.B, m.C, joint[:3, :3], joint[3:, 3:], S_wv=joint[:3, 3:], f0=np.ones(3))
    systems = design_systems(model, 4)
    assert len(systems) == 5 and all(now is systems[0] for now in systems)
    now = systems[0]
    assert now.nominal is model
    full = np.block([[now.W, now.S], [now.S.T, now.V]])
    enters = np.block([[now.m.Bw, now.m.Bv], [now.m.Dw, now.m.Dv]])
    np.testing.assert_array_equal(enters @ full @ enters.T, joint)
    assert not any(getattr(now.m, name).any() for names in CHANNELS.values() for name in names)


def test_an_uncertain_model_is_itself_with_its_uncertainty_scaled(rng):
    """Oracle: the system; time varying or not."""
    for varying in (False, True):
        model = random_uncertain(rng, 4, varying=varying)
        systems = design_systems(model, 4, 0.5)
        assert len(systems) == 5 and (systems[3] is systems[0]) != varying
        for k, now in enumerate(systems):
            m = model.system.at(k)
            np.testing.assert_array_equal(now.nominal.Q_w, model.at(k).Q_w)
            np.testing.assert_array_equal(now.m.H_A, 0.5 * m.H_A)
            np.testing.assert_array_equal(now.m.H_Dv, 0.5 * m.H_Dv)
            np.testing.assert_array_equal(now.m.G_x, m.G_x)
            np.testing.assert_array_equal(now.m.Dw, m.Dw)
