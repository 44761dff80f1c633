"""The system of scipy-signal.yaml: a mass with a spring and a damper, as a system of scipy.signal.

Plant   m s'' = u - k s - d s' with the place s [m], force u [N], mass m [kg], stiffness k [N/m], damping d [N s/m].
"""

from scipy import signal


def oscillator(m=1.0, k=4.0, d=0.2):
    """Return the continuous system with the states place and speed; the arguments are the parameters of the plant."""
    return signal.StateSpace([[0, 1], [-k / m, -d / m]], [[0], [1 / m]], [[1, 0]], [[0]])
