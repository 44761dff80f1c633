"""State estimators: one paper's filter per file, the file's name is the kind.

How to add one whose gains do not depend on the data (most filters of this bench):

1. ``estimators/my_filter.py`` with a function ``design(model, n_steps, *, x0, P0, ...)``.  ``model`` is what the
   estimator believes, ``x0`` and ``P0`` its start; every further keyword is a key of the YAML, validated by its
   annotation.  Return a `GainScheduleFilter`, for instance through `riccati_schedule`, which asks only for what your
   filter does to the covariance P of the prediction error before it is used:

   >>> import numpy as np
   >>> from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, riccati_schedule
   >>> from rmpc_bench.models.linear import LinearModel
   >>> from rmpc_bench.numerics.kl_ball import Inflation
   >>> def design(model, n_steps, *, x0, P0, factor: float) -> GainScheduleFilter:
   ...     return riccati_schedule(model, n_steps, x0, P0, lambda k, P: Inflation(factor * P, 0.0))
   >>> model = LinearModel(A=[[1.0]], B=[[1.0]], C=[[1.0]], Q_w=[[0.0]], R_v=[[1.0]])
   >>> my_filter = design(model, 2, x0=np.zeros(1), P0=np.eye(1), factor=1.0)
   >>> state = my_filter.init(n_runs=3)
   >>> state, estimate = my_filter.correct(0, state, np.full((3, 1), 2.0))
   >>> estimate.x_hat.ravel().tolist()
   [1.0, 1.0, 1.0]

2. One line in ``registry.py``: ``"my-filter": "rmpc_bench.estimators.my_filter:design",``.
3. ``tests/estimators/test_my_filter.py``: the limit in which it becomes a known filter.

A filter that depends on the data is a frozen dataclass, a subclass of `types.Estimator` with ``init``, ``correct`` and
``predict``, and a NamedTuple as its state.
"""
