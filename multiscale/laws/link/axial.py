"""Bars, cables and struts."""

from dataclasses import dataclass

from multiscale.laws.link.link_law import LinkLaw

__all__ = ["Bar", "Cable", "Strut"]


@dataclass(frozen=True)
class Bar(LinkLaw):
    """Link that carries tension and compression.

    Examples
    --------
    >>> import numpy as np
    >>> Bar(rigidity=8e7).respond(np.array([-1e-5, 1e-5])).tension
    array([-800.,  800.])
    """


@dataclass(frozen=True)
class Cable(LinkLaw):
    """Link that carries tension only; inextensible if its rigidity is infinite.

    Examples
    --------
    >>> import numpy as np
    >>> Cable(rigidity=4e6).respond(np.array([-1e-4, 1e-4])).tension
    array([  0., 400.])
    """

    lower = 0.0


@dataclass(frozen=True)
class Strut(LinkLaw):
    """Link that carries compression only.

    Examples
    --------
    >>> import numpy as np
    >>> Strut(rigidity=4e6).respond(np.array([-1e-4, 1e-4])).tension
    array([-400.,    0.])
    """

    upper = 0.0
