"""Link laws: axial laws of bars, cables and struts, and modes of beams."""

from abc import ABC
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from multiscale.errors import CaseError, require


@dataclass(frozen=True)
class LinkResponse:
    """Response of a link law to a strain."""

    tension: np.ndarray  # N, compression negative
    tangent: np.ndarray  # derivative of the tension by the strain, N; zero for slack links
    slack: np.ndarray  # over the relaxed length, never negative; zero for links that carry force


@dataclass(frozen=True)
class LinkLaw(ABC):
    r"""Law of the tension of a link by its axial strain.

    With the elastic tension :math:`t = EA\,\varepsilon`, the range :math:`[\tau^-, \tau^+]` of
    admissible tensions, ``lower`` to ``upper``, N, and the slack :math:`\lambda`,

    .. math::
        \tau = \min(\max(t, \tau^-), \tau^+), \qquad EA\,\lambda = |\tau - t|,    \tag{1}

    which for a cable, :math:`[0, \infty)`, is the law (15) of the source; the gradient of a convex
    energy.
    """

    lower: ClassVar[float] = -np.inf
    upper: ClassVar[float] = np.inf

    rigidity: float  # axial, N; infinite for a link of fixed length

    def __post_init__(self) -> None:
        require("rigidity", self.rigidity, "(0, inf]", "N")

    def respond(self, strain: np.ndarray) -> LinkResponse:
        """Evaluate (1) for a strain relative to the relaxed length; refused if inextensible."""
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
    """Link that carries tension and compression."""


@dataclass(frozen=True)
class Cable(LinkLaw):
    """Link that carries tension only; inextensible if its rigidity is infinite."""

    lower = 0.0


@dataclass(frozen=True)
class Strut(LinkLaw):
    """Link that carries compression only."""

    upper = 0.0


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

    Notes
    -----
    The six modes are the elongation, the twist :math:`\vartheta`, and in both planes, with the
    rotations :math:`\varphi_1, \varphi_2` of the ends against the chord, the symmetric bending
    :math:`\varphi_1 - \varphi_2` and the antisymmetric bending :math:`\varphi_1 + \varphi_2`:

    .. math::
        2 W = \frac{EA}{L} e^2 + \frac{GJ}{L} \vartheta^2 + \sum \frac{EI}{L}
        \Big[ (\varphi_1 - \varphi_2)^2 + \frac{3 (\varphi_1 + \varphi_2)^2}{1 + \Phi} \Big],
        \qquad \Phi = \frac{12 EI}{\kappa G A L^2}.    \tag{1}

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
            limits = "(0, inf)" if name.startswith("bending") else "(0, inf]"
            require(f"{name} of a beam", getattr(self, name), limits)
        if not np.any(self.up):
            raise CaseError("up of a beam must not be zero; give the direction of its third axis")

    def mode_stiffness(self, length: np.ndarray) -> np.ndarray:
        """Stiffness of the six modes (1) of beams of lengths, m: N/m, then N m, shape (6, ...)."""
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
