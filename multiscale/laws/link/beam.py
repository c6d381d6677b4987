"""Straight beams with six unknowns at each end."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.link.link_law import LinkLaw

__all__ = ["Beam"]


@dataclass(frozen=True)
class Beam(LinkLaw):
    r"""Prismatic elastic beam in space.

    Parameters
    ----------
    rigidity : float, axial rigidity :math:`EA`, N
    torsion : float, torsional rigidity :math:`GJ`, N m²
    bending_y, bending_z : float
        Bending rigidities :math:`EI_y` and :math:`EI_z` about the second and third local axis,
        N m².
    shear_y, shear_z : float, default infinite
        Shear rigidities :math:`\kappa GA` along the second and third local axis, N; infinite for
        an Euler-Bernoulli beam.
    up : tuple of float, default (0, 0, 1)
        Vector that, with the axis of the beam, spans the plane of the third local axis, which
        points towards it. For beams along this vector the global x axis is used.

    Raises
    ------
    CaseError
        If a rigidity is not positive.

    Notes
    -----
    The six deformations without rigid motion are the elongation, the twist :math:`\vartheta`,
    and in both planes, with the rotations :math:`\varphi_1, \varphi_2` of the ends against the
    chord, the symmetric bending :math:`\varphi_1 - \varphi_2` and the antisymmetric bending
    :math:`\varphi_1 + \varphi_2`. They are uncoupled:

    .. math::
        2 W = \frac{EA}{L} e^2 + \frac{GJ}{L} \vartheta^2 + \sum \frac{EI}{L}
        \Big[ (\varphi_1 - \varphi_2)^2 + \frac{3 (\varphi_1 + \varphi_2)^2}{1 + \Phi} \Big],
        \qquad \Phi = \frac{12 EI}{\kappa G A L^2}.    \tag{1}

    References
    ----------
    .. [1] J. S. Przemieniecki, Theory of Matrix Structural Analysis, McGraw-Hill, 1968.
    """

    torsion: float
    bending_y: float
    bending_z: float
    shear_y: float = np.inf
    shear_z: float = np.inf
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("torsion", "bending_y", "bending_z", "shear_y", "shear_z"):
            if not getattr(self, name) > 0.0:
                raise CaseError(f"{name} of a beam must be positive, got {getattr(self, name)}")
        if not np.any(self.up):
            raise CaseError("up of a beam must not be zero; give the direction of its third axis")

    def mode_stiffness(self, length: np.ndarray) -> np.ndarray:
        """Return the stiffness of the six modes (1) of beams.

        Parameters
        ----------
        length : ndarray, shape (...), length of the beams, m

        Returns
        -------
        ndarray, shape (6, ...)
            Stiffness of elongation (N/m), twist, symmetric and antisymmetric bending about the
            second local axis, and bending about the third axis (N m).
        """
        L = np.asarray(length, dtype=float)
        shear = 12.0 / L**2
        slender_y = 1.0 + shear * self.bending_y / self.shear_z
        slender_z = 1.0 + shear * self.bending_z / self.shear_y
        modes = [
            np.broadcast_to(self.rigidity, L.shape),
            np.broadcast_to(self.torsion, L.shape),
            np.broadcast_to(self.bending_y, L.shape),
            3.0 * self.bending_y / slender_y,
            np.broadcast_to(self.bending_z, L.shape),
            3.0 * self.bending_z / slender_z,
        ]
        return np.asarray(np.stack(modes) / L)  # (1)
