r"""Contact area of random rough surfaces in two theories, which bracket the computed areas.

References
----------
.. [1] B. N. J. Persson, J. Chem. Phys. 115 (2001) 3840-3861, doi:10.1063/1.1388626.
.. [2] A. W. Bush, R. D. Gibson and T. R. Thomas, Wear 35 (1975) 87-111.
"""

import numpy as np
from numpy import pi, sqrt
from scipy.special import erf

__all__ = ["SLOPE_BUSH_GIBSON_THOMAS", "SLOPE_PERSSON", "contact_fraction"]

SLOPE_PERSSON = sqrt(8.0 / pi)
r"""Initial slope of :math:`A/A_0` against :math:`p/(E^* h'_{rms})`: a lower limit."""

SLOPE_BUSH_GIBSON_THOMAS = sqrt(2.0 * pi)
r"""The same slope in the theory of separate summits: an upper limit."""


def contact_fraction(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Real over nominal contact area after Persson.

    Parameters
    ----------
    relative_pressure : ndarray, :math:`p/(E^* h'_{rms})`, dimensionless

    Returns
    -------
    ndarray, :math:`A/A_0 = \mathrm{erf}(\sqrt 2\, p/(E^* h'_{rms}))`, dimensionless
    """
    return np.asarray(erf(sqrt(2.0) * np.asarray(relative_pressure)))
