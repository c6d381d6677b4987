"""Compressible neo-Hookean rubber."""

from dataclasses import dataclass

import numpy as np

from multiscale.laws.bulk.bulk_law import (
    BulkLaw,
    BulkResponse,
    cofactor,
    cofactor_derivative,
    logarithmic_volume,
)
from multiscale.laws.bulk.moduli import check_moduli, lame_parameters

__all__ = ["NeoHookean"]


@dataclass(frozen=True)
class NeoHookean(BulkLaw):
    r"""Neo-Hookean elasticity, which is Hooke's law at small strain.

    Parameters
    ----------
    youngs_modulus : float, Young's modulus :math:`E > 0` of the undeformed body, Pa
    poissons_ratio : float
        Poisson's ratio :math:`-1 < \nu < 1/2` of the undeformed body, dimensionless.

    Raises
    ------
    CaseError
        If a modulus is outside its range.

    Notes
    -----
    With Lamé's parameters as in :class:`~multiscale.laws.bulk.Elastic` and :math:`J = \det F`,

    .. math:: P = \mu (F - F^{-T}) + \lambda \ln J\, F^{-T},    \tag{1}

    where the last term is :math:`U'(J)\,\partial J/\partial F` with
    :math:`U = \tfrac{\lambda}{2}\ln^2 J`.

    References
    ----------
    .. [1] J. Bonet and R. D. Wood, Nonlinear Continuum Mechanics for Finite Element Analysis,
       2nd ed., Cambridge University Press, 2008: the compressible neo-Hookean material.
    """

    youngs_modulus: float
    poissons_ratio: float

    def __post_init__(self) -> None:
        check_moduli(self.youngs_modulus, self.poissons_ratio)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus, Pa."""
        return float(lame_parameters(self.youngs_modulus, self.poissons_ratio)[1])

    @property
    def volume_modulus(self) -> float:
        """Factor of the volume energy, Pa: Lamé's first parameter."""
        return float(lame_parameters(self.youngs_modulus, self.poissons_ratio)[0])

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Evaluate mu (F - F^-T), Pa."""
        mu = self.shear_modulus
        cof = cofactor(gradient)
        J = np.sum(gradient[0] * cof[0], axis=0)
        inverse = cof / J  # F^-T
        # d(F^-T) = d(cof)/J - F^-T (F^-T : dF)
        change = cofactor_derivative(gradient) / J - inverse[:, :, None, None] * inverse
        tangent = -mu * change
        for i in range(3):
            for j in range(3):
                tangent[i, j, i, j] += mu
        return BulkResponse(mu * (gradient - inverse), tangent, state)

    def respond_volume(self, dilatation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return U' and U'' of the logarithmic volume energy, Pa."""
        return logarithmic_volume(self.volume_modulus, dilatation)
