"""Other libraries on the bench; a library itself is imported when its adapter is used.

The files of a library begin with its name.  The first of them has the public names.

=====================  ===============  ==============================================================
library                file             public names
=====================  ===============  ==============================================================
CasADi                 casadi           `step_function`, `output_function`; casadi_plant: kind `casadi`
python-control         control          `system`; kind `control`; control_gains: `control-lqe`, `control-lqr`
do-mpc                 do_mpc           `do_mpc_controller`, `do_mpc_estimator`, `do_mpc_model`
ppopt and others       explicit_mpc     `explicit_controller`
filterpy               filterpy         `filterpy_estimator`
fmpy                   fmu              kind `fmu`
Gymnasium              gymnasium        `env`; kind `env`
scipy.signal           scipy_signal     kind `scipy`
Stone Soup             stonesoup        `stonesoup_estimator`
xarray                 xarray           `dataset`, `traces`
=====================  ===============  ==============================================================
"""
