"""Anisotropic elasticity at small strain, for solids with cavities and cracks."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.bulk_law import BulkLaw, BulkResponse
from multiscale.laws.bulk.moduli import VOIGT

__all__ = ["AnisotropicElastic"]

VOIGT_ROW = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
"""Row of the 6 x 6 stiffness for each pair of axes (Voigt notation)."""

SYMMETRY_TOLERANCE = 1e-6
"""Largest allowed difference to the transpose, relative to the largest stiffness."""

LEAST_STIFFNESS = 1e-9
"""Smallest allowed eigenvalue of the stiffness, relative to the largest entry."""


@dataclass(frozen=True, eq=False)
class AnisotropicElastic(BulkLaw):
    r"""Hooke's law with a full tensor, linear in the displacement gradient.

    Parameters
    ----------
    stiffness : ndarray, shape (6, 6)
        Stiffness :math:`C`, Pa, for xx, yy, zz, yz, xz, xy with shear angles.

    Raises
    ------
    CaseError
        If the stiffness is not symmetric and positive definite.

    Notes
    -----
    With :math:`\varepsilon = \mathrm{sym}(F - I)`,

    .. math:: P_s = (C - \lambda\, 1 \otimes 1) : \varepsilon, \qquad
        U(J) = \tfrac{\lambda}{2}(J-1)^2, \qquad J - 1 = \mathrm{tr}\,\varepsilon,    \tag{1}

    where :math:`\lambda` is the mean of :math:`C_{12}, C_{13}, C_{23}`, so that an isotropic
    tensor gives :class:`Elastic`, bounded by 0 and by :math:`1 / (1 : C^{-1} : 1)`, up to which the
    first part is positive semidefinite.

    Examples
    --------
    >>> law = AnisotropicElastic(np.diag([2e9, 1e9, 1e9, 4e8, 4e8, 4e8]))
    >>> F = np.diag([1.0 + 1e-3, 1.0, 1.0])
    >>> float(law.respond_shape(F, np.empty(0)).stress[0, 0].round())
    2000000.0
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
        one = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        return min(max(mean, 0.0), 1.0 / float(one @ np.linalg.solve(C, one)))

    def turned(self, axes: np.ndarray) -> "AnisotropicElastic":
        """Return the law of the solid whose own axes are the columns of a rotation, (3, 3)."""
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
