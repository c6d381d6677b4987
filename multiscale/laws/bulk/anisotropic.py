"""Anisotropic elasticity at small strain: what cavities and cracks leave of a solid."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.bulk_law import BulkLaw, BulkResponse

__all__ = ["AnisotropicElastic"]

PLACE = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
"""Row of the 6 x 6 stiffness for each pair of axes."""

SYMMETRIC = 1e-6
"""Largest difference to the transpose, relative to the largest stiffness."""

SOFT = 1e-9
"""Share of the largest stiffness below which there is none."""


@dataclass(frozen=True, eq=False)
class AnisotropicElastic(BulkLaw):
    r"""Hooke's law with a full tensor, linear in the displacement gradient.

    Parameters
    ----------
    stiffness : ndarray, shape (6, 6)
        :math:`C`, Pa, for xx, yy, zz, yz, xz, xy with shear angles: the order of
        ``RVE_STIFFNESS``.

    Raises
    ------
    CaseError
        If it is not symmetric, or there is a strain against which it has no stiffness.

    Notes
    -----
    With :math:`\varepsilon = \mathrm{sym}(F - I)`,

    .. math:: P_s = (C - \lambda\, 1 \otimes 1) : \varepsilon, \qquad
        U(J) = \tfrac{\lambda}{2}(J-1)^2, \qquad J - 1 = \mathrm{tr}\,\varepsilon,    \tag{1}

    where :math:`\lambda` is the mean of :math:`C_{12}, C_{13}, C_{23}`, so that an isotropic
    tensor gives :class:`Elastic`; but at least 0 and at most what leaves the first part positive,
    :math:`1 / (1 : C^{-1} : 1)`.

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
        if np.abs(C - C.T).max() > SYMMETRIC * size:
            raise CaseError("an elastic tensor is symmetric (Pa); pass the mean with its transpose")
        C = 0.5 * (C + C.T)
        if not np.linalg.eigvalsh(C)[0] > SOFT * size:
            raise CaseError(
                "the elastic tensor has a strain without stiffness: the solid is cut through, "
                "D = 1, and carries no load; leave the body out or give it a stiffness"
            )
        object.__setattr__(self, "stiffness", C)

    @cached_property
    def tensor(self) -> np.ndarray:
        """C with four indices, shape (3, 3, 3, 3), Pa."""
        return np.asarray(self.stiffness[PLACE[:, :, None, None], PLACE])

    @cached_property
    def lame(self) -> float:
        """The modulus of the volume in (1), Pa."""
        C = self.stiffness
        mean = float(C[0, 1] + C[0, 2] + C[1, 2]) / 3.0
        one = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        return min(max(mean, 0.0), 1.0 / float(one @ np.linalg.solve(C, one)))

    def scaled(self, factor: float) -> "AnisotropicElastic":
        """Return the same law, a factor as stiff."""
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
        """U' and U'' of (1)."""
        return self.lame * (dilatation - 1.0), np.full_like(dilatation, self.lame)
