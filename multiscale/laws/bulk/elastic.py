"""Isotropic elasticity at small strain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from multiscale.laws.bulk.bulk_law import BulkLaw, BulkResponse
from multiscale.laws.bulk.moduli import check_moduli, lame_parameters

__all__ = ["Elastic", "GradedElastic"]


@dataclass(frozen=True)
class Elastic(BulkLaw):
    r"""Hooke's law, linear in the displacement gradient.

    Parameters
    ----------
    youngs_modulus : float, Young's modulus :math:`E > 0`, Pa
    poissons_ratio : float, Poisson's ratio :math:`-1 < \nu < 1/2`, dimensionless

    Raises
    ------
    CaseError
        If a modulus is outside its range.

    Notes
    -----
    With :math:`\varepsilon = \mathrm{sym}(F - I)`, :math:`\mu = E/(2(1+\nu))` and
    :math:`\lambda = E\nu/((1+\nu)(1-2\nu))`,

    .. math:: P_s = 2\mu\,\varepsilon, \qquad U(J) = \tfrac{\lambda}{2}(J-1)^2,
        \qquad J - 1 = \mathrm{tr}\,\varepsilon .    \tag{1}

    Examples
    --------
    >>> import numpy as np
    >>> from multiscale.laws.bulk import respond_bulk
    >>> F = np.diag([1.0 + 1e-3, 1.0 - 3e-4, 1.0 - 3e-4])  # uniaxial stress
    >>> stress = respond_bulk(Elastic(200e9, 0.3), F, np.empty(0)).stress
    >>> bool(np.allclose(stress, np.diag([200e6, 0.0, 0.0]), atol=1.0))
    True
    """

    youngs_modulus: float
    poissons_ratio: float
    finite_strain = False

    def __post_init__(self) -> None:
        check_moduli(self.youngs_modulus, self.poissons_ratio)

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Evaluate P_s of (1)."""
        _, mu = lame_parameters(self.youngs_modulus, self.poissons_ratio)
        points = gradient.shape[2:]
        eye = np.eye(3).reshape(3, 3, *(1,) * len(points))
        stress = mu * (gradient + gradient.swapaxes(0, 1) - 2.0 * eye)
        tangent = np.zeros((3, 3, *gradient.shape))
        for i in range(3):
            for j in range(3):
                tangent[i, j, i, j] += mu
                tangent[i, j, j, i] += mu
        return BulkResponse(stress, tangent, state)

    def respond_volume(self, dilatation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return U' and U'' of (1), Pa."""
        lame, _ = lame_parameters(self.youngs_modulus, self.poissons_ratio)
        return lame * (dilatation - 1.0), np.full_like(dilatation, lame)


@dataclass(frozen=True, eq=False)
class GradedElastic:
    r"""Hooke's law with moduli that differ from layer to layer or element to element of a cell.

    This is a field and no law of a point: the cell meshed with it knows the place.

    Parameters
    ----------
    youngs_modulus, poissons_ratio : float or ndarray
        Pa and 1: one number, one of each layer from the base up or one of each element.

    Raises
    ------
    CaseError
        If a modulus is outside its range.
    """

    youngs_modulus: float | np.ndarray
    poissons_ratio: float | np.ndarray
    n_state: ClassVar[int] = 0
    finite_strain: ClassVar[bool] = False
    flows: ClassVar[bool] = False
    rate_dependent: ClassVar[bool] = False
    history: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        check_moduli(self.youngs_modulus, self.poissons_ratio)
