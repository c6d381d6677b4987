"""Elasticity at small strain: isotropic, graded, and anisotropic for cavities and cracks."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.bulk_law import VOIGT, BulkLaw, BulkResponse, IsotropicLaw, check_moduli

VOIGT_ROW = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
"""Row of the 6 x 6 stiffness for each pair of axes (Voigt notation)."""

SYMMETRY_TOLERANCE = 1e-6
"""Largest allowed difference to the transpose, relative to the largest stiffness."""

LEAST_STIFFNESS = 1e-9
"""Smallest allowed eigenvalue of the stiffness, relative to the largest entry."""


@dataclass(frozen=True)
class Elastic(IsotropicLaw):
    r"""Hooke's law, linear in the displacement gradient.

    Parameters
    ----------
    youngs_modulus : float, Young's modulus :math:`E > 0`, Pa
    poissons_ratio : float, Poisson's ratio :math:`-1 < \nu < 1/2`, dimensionless

    Notes
    -----
    With :math:`\varepsilon = \mathrm{sym}(F - I)`, :math:`\mu = E/(2(1+\nu))` and
    :math:`\lambda = E\nu/((1+\nu)(1-2\nu))`,

    .. math:: P_s = 2\mu\,\varepsilon, \qquad U(J) = \tfrac{\lambda}{2}(J-1)^2,
        \qquad J - 1 = \mathrm{tr}\,\varepsilon .    \tag{1}
    """

    finite_strain = False

    @property
    def tensor(self) -> np.ndarray:
        """Stiffness with four indices, shape (3, 3, 3, 3), Pa."""
        pairs = np.einsum("ij,kl->ijkl", np.eye(3), np.eye(3))
        shear = pairs.transpose(0, 2, 1, 3) + pairs.transpose(0, 2, 3, 1)
        return np.asarray(self.volume_modulus * pairs + self.shear_modulus * shear)

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Evaluate P_s of (1)."""
        mu, points = self.shear_modulus, gradient.shape[2:]
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
        lame = self.volume_modulus
        return lame * (dilatation - 1.0), np.full_like(dilatation, lame)


@dataclass(frozen=True, eq=False)
class GradedElastic:
    """Field of Hooke's law in a cell meshed with it.

    Parameters
    ----------
    youngs_modulus, poissons_ratio : float or ndarray
        Pa and 1: a number, a value per layer from the base up, or a value per element.
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


@dataclass(frozen=True, eq=False)
class AnisotropicElastic(BulkLaw):
    r"""Hooke's law with a full tensor, linear in the displacement gradient.

    Parameters
    ----------
    stiffness : ndarray, shape (6, 6)
        Stiffness :math:`C`, Pa, symmetric and positive definite, for xx, yy, zz, yz, xz, xy with
        shear angles.

    Notes
    -----
    With :math:`\varepsilon = \mathrm{sym}(F - I)`,

    .. math:: P_s = (C - \lambda\, 1 \otimes 1) : \varepsilon, \qquad
        U(J) = \tfrac{\lambda}{2}(J-1)^2, \qquad J - 1 = \mathrm{tr}\,\varepsilon,    \tag{1}

    where :math:`\lambda` is the mean of :math:`C_{12}, C_{13}, C_{23}`, so that an isotropic
    tensor gives :class:`Elastic`, bounded by 0 and by :math:`1 / (1 : C^{-1} : 1)`, up to which the
    first part is positive semidefinite.
    """

    stiffness: np.ndarray
    finite_strain = False

    def __post_init__(self) -> None:
        C = np.array(self.stiffness, dtype=float)
        if C.shape != (6, 6) or not np.all(np.isfinite(C)):
            raise CaseError(f"an elastic tensor is 6 x 6 and finite (Pa), got shape {C.shape}")
        size = float(np.abs(C).max())
        if np.abs(C - C.T).max() > SYMMETRY_TOLERANCE * size:
            raise CaseError("an elastic tensor is symmetric (Pa); pass the mean with its transpose")
        C = 0.5 * (C + C.T)
        if not np.linalg.eigvalsh(C)[0] > LEAST_STIFFNESS * size:
            raise CaseError(
                "the elastic tensor has a strain without stiffness: the solid is cut through, "
                "D = 1, and carries no load; remove the body or give it a stiffness"
            )
        object.__setattr__(self, "stiffness", C)

    @cached_property
    def tensor(self) -> np.ndarray:
        """Stiffness with four indices, shape (3, 3, 3, 3), Pa."""
        return np.asarray(self.stiffness[VOIGT_ROW[:, :, None, None], VOIGT_ROW])

    @cached_property
    def lame(self) -> float:
        """Modulus of the volume change in (1), Pa."""
        C = self.stiffness
        mean = float(C[0, 1] + C[0, 2] + C[1, 2]) / 3.0
        unit = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        return min(max(mean, 0.0), 1.0 / float(unit @ np.linalg.solve(C, unit)))

    def turned(self, axes: np.ndarray) -> "AnisotropicElastic":
        """Return the law of the solid turned by a rotation, (3, 3): its axes are the columns."""
        Q = np.asarray(axes, dtype=float)
        tensor = np.einsum("ia,jb,kc,ld,abcd->ijkl", Q, Q, Q, Q, self.tensor, optimize=True)
        i, j = np.transpose(VOIGT)
        return AnisotropicElastic(tensor[i[:, None], j[:, None], i, j])

    def scaled(self, factor: float) -> "AnisotropicElastic":
        """Return the law with the stiffness multiplied by a factor, dimensionless."""
        return AnisotropicElastic(factor * self.stiffness)

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Evaluate P_s of (1)."""
        points = gradient.shape[2:]
        eye = np.eye(3)
        shape = self.tensor - self.lame * eye[:, :, None, None] * eye
        strain = gradient - eye.reshape(3, 3, *(1,) * len(points))
        stress = np.tensordot(shape, strain, axes=2)
        tangent = np.broadcast_to(
            shape.reshape(3, 3, 3, 3, *(1,) * len(points)), (3, 3, 3, 3, *points)
        )
        return BulkResponse(stress, tangent.copy(), state)

    def respond_volume(self, dilatation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return U' and U'' of (1), Pa."""
        return self.lame * (dilatation - 1.0), np.full_like(dilatation, self.lame)
