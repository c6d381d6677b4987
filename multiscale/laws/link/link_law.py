"""Laws of bars, cables and struts: linear elasticity within a range of admissible tensions."""

from abc import ABC
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from multiscale.errors import CaseError

__all__ = ["Bar", "Cable", "LinkLaw", "LinkResponse", "Strut"]


@dataclass(frozen=True)
class LinkResponse:
    r"""Response of a link law to a strain.

    Attributes
    ----------
    tension : ndarray, shape (...), tension :math:`\tau`, N, compression negative
    tangent : ndarray, shape (...)
        Derivative :math:`\mathrm{d}\tau / \mathrm{d}\varepsilon`, N; zero for slack links.
    slack : ndarray, shape (...)
        Slack over the relaxed length, dimensionless, never negative; zero for links that carry
        force.
    """

    tension: np.ndarray
    tangent: np.ndarray
    slack: np.ndarray


@dataclass(frozen=True)
class LinkLaw(ABC):
    r"""Maps the axial strain of a link to its tension, pointwise.

    Parameters
    ----------
    rigidity : float, axial rigidity :math:`EA > 0`, N; infinite for a link of fixed length

    Attributes
    ----------
    lower, upper : float, range of admissible tensions, N

    Raises
    ------
    CaseError
        If the rigidity is not positive.

    Notes
    -----
    With the elastic tension :math:`t = EA\,\varepsilon`, the range
    :math:`[\tau^-, \tau^+]` and the slack :math:`\lambda`,

    .. math::
        \tau = \min(\max(t, \tau^-), \tau^+), \qquad EA\,\lambda = |\tau - t|,    \tag{1}

    which for a cable, :math:`[0, \infty)`, is the law (15) of the source. The range is a
    convex set; therefore (1) is the gradient of a convex energy.
    """

    lower: ClassVar[float] = -np.inf
    upper: ClassVar[float] = np.inf

    rigidity: float

    def __post_init__(self) -> None:
        if not self.rigidity > 0.0:
            raise CaseError(f"rigidity must be positive (N), got {self.rigidity}")

    def respond(self, strain: np.ndarray) -> LinkResponse:
        """Evaluate (1) for a strain relative to the relaxed length, shape (...), dimensionless.

        Raises
        ------
        CaseError
            If the link is inextensible, because its tension does not follow from its strain.
        """
        if not np.isfinite(self.rigidity):
            raise CaseError("the tension of an inextensible link is a reaction, not a response")
        elastic = self.rigidity * np.asarray(strain, dtype=float)
        tension = np.clip(elastic, self.lower, self.upper)  # (1)
        carries = (elastic >= self.lower) & (elastic <= self.upper)
        return LinkResponse(
            tension,
            np.where(carries, self.rigidity, 0.0),
            np.abs(tension - elastic) / self.rigidity,
        )


@dataclass(frozen=True)
class Bar(LinkLaw):
    """Link that carries tension and compression.

    Examples
    --------
    >>> Bar(rigidity=8e7).respond(np.array([-1e-5, 1e-5])).tension
    array([-800.,  800.])
    """


@dataclass(frozen=True)
class Cable(LinkLaw):
    """Link that carries tension only; inextensible if its rigidity is infinite.

    Examples
    --------
    >>> Cable(rigidity=4e6).respond(np.array([-1e-4, 1e-4])).tension
    array([  0., 400.])
    """

    lower = 0.0


@dataclass(frozen=True)
class Strut(LinkLaw):
    """Link that carries compression only.

    Examples
    --------
    >>> Strut(rigidity=4e6).respond(np.array([-1e-4, 1e-4])).tension
    array([-400.,    0.])
    """

    upper = 0.0
