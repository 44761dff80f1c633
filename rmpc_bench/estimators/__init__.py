"""State estimators: one method per file; the name of the file is the kind.

How to add a filter whose gains do not depend on the data:

1. ``estimators/my_filter.py`` with a function ``design(model, n_steps, *, x0, P0, ...)``.  ``model`` is the design
   model, ``x0`` and ``P0`` are mean and covariance of the initial state.  Every further keyword is a key of the YAML
   and is validated by its annotation.  Return a `GainScheduleFilter`.  The function `riccati_schedule` creates one
   from a function that modifies the root of the covariance of the prediction error before it is used:

   >>> import numpy as np
   >>> from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, riccati_schedule
   >>> from rmpc_bench.models.linear import LinearModel
   >>> from rmpc_bench.numerics.divergence import Inflation
   >>> def design(model, n_steps, *, x0, P0, factor: float) -> GainScheduleFilter:
   ...     return riccati_schedule(model, n_steps, x0, P0, lambda k, root: Inflation(factor**0.5 * root, 0.0))
   >>> model = LinearModel(A=[[1.0]], B=[[1.0]], C=[[1.0]], Q_w=[[0.0]], R_v=[[1.0]])
   >>> my_filter = design(model, 2, x0=np.zeros(1), P0=np.eye(1), factor=1.0)
   >>> state = my_filter.init(n_runs=3)
   >>> state, estimate = my_filter.correct(0, state, np.full((3, 1), 2.0))
   >>> estimate.x_hat.ravel().round(9).tolist()
   [1.0, 1.0, 1.0]

2. One line in ``registry.py``: ``"my-filter": "rmpc_bench.estimators.my_filter:design",``.
3. ``tests/estimators/test_my_filter.py``: the limit in which it becomes a known filter.

A filter that depends on the data is a frozen dataclass, a subclass of `types.Estimator` with ``init``, ``correct`` and
``predict``, and a NamedTuple as its state.
"""
