"""Contact area of random rough surfaces in two theories, which bracket the computed areas.

B. N. J. Persson, J. Chem. Phys. 115 (2001) 3840-3861, doi:10.1063/1.1388626, and
A. W. Bush, R. D. Gibson and T. R. Thomas, Wear 35 (1975) 87-111.
"""

import numpy as np
from numpy import pi, sqrt
from scipy.special import erf

SLOPE_PERSSON = sqrt(8.0 / pi)
r"""Initial slope of :math:`A/A_0` against :math:`p/(E^* h'_{rms})`: a lower limit."""

SLOPE_BUSH_GIBSON_THOMAS = sqrt(2.0 * pi)
r"""The same slope in the theory of separate summits: an upper limit."""


def contact_fraction(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Contact fraction after Persson, :math:`\mathrm{erf}(\sqrt 2\, p/(E^* h'_{rms}))`."""
    return np.asarray(erf(sqrt(2.0) * np.asarray(relative_pressure)))
