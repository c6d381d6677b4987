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
    """Law of a link: its elastic tension within a range, N, (1); (15) of the source."""

    lower: ClassVar[float] = -np.inf
    upper: ClassVar[float] = np.inf

    rigidity: float  # axial, N; infinite for a link of fixed length

    def __post_init__(self) -> None:
        require("rigidity", self.rigidity, "(0, inf]", "N")

    def respond(self, strain: np.ndarray) -> LinkResponse:
        """Evaluate (1) for a strain relative to the relaxed length; refused if inextensible."""
        if not np.isfinite(self.rigidity):
            raise CaseError("the tension of an inextensible link is a reaction, not a response")
        # tau = min(max(EA eps, lower), upper), EA slack = |tau - EA eps| (1)
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
    """Prismatic elastic beam in space."""

    # rigidities: torsion GJ, N m²; bending EI about the local axes y and z, N m²; shear kappa GA, N
    # (infinite for an Euler-Bernoulli beam); ``up`` and the axis span the plane of the local z
    # axis, with the global x axis in its place for beams along it
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
        # elongation e, twist t, and in both planes the rotations p_1, p_2 of the ends against the
        # chord (J. S. Przemieniecki, Theory of Matrix Structural Analysis, McGraw-Hill, 1968):
        #     2 W = EA/L e² + GJ/L t² + sum EI/L [(p_1 - p_2)² + 3 (p_1 + p_2)² / (1 + Phi)],
        #     Phi = 12 EI / (kappa GA L²)  (1)
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
