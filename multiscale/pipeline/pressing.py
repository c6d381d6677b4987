"""Pressures of interfaces of bodies, estimated from the resultants of bolts and loads."""

from collections.abc import Iterable, Sequence
from math import pi, radians, sqrt, tan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from multiscale.fe.faces import face_of

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = ["SPREAD", "Face", "highest_pressure"]

SPREAD = tan(radians(30.0))
"""Slope of the cone in which a force spreads from the face that it presses."""

BENDING = 6.0
"""Pressure at the edge by a moment, over the moment per area and width, of a rectangle."""


class Face(NamedTuple):
    """Area, m², centroid, m, shape (3,), and mean outward normal, shape (3,), of a boundary."""

    area: float
    centroid: np.ndarray
    normal: np.ndarray

    @classmethod
    def at(cls, meshes: "Sequence[Mesh]", place: tuple[int, str]) -> "Face":
        """Measure a boundary of one of several meshes, which its number and name give."""
        mesh = meshes[place[0]]
        surface = face_of(mesh, place[1])
        x, normals = surface.position[surface.facets], surface.normals
        areas = np.linalg.norm(normals, axis=1)
        mean = normals.sum(axis=0) / areas.sum()
        return cls(float(areas.sum()), areas @ x.mean(axis=1) / areas.sum(), mean)


def highest_pressure(interface: Face, forces: Iterable[tuple[np.ndarray, Face]]) -> float:
    r"""Estimate the largest pressure by forces on faces, each in its cone, and their moments, Pa.

    .. math:: p = \sum_k \frac{|F_k| + 6 |r_k \times F_k| / w}{\min(A, A_k)}

    has the area A and the width w of the interface, the arm r of the face from it, and the area
    of the cone below the face at the height of the interface.
    """
    width, total = sqrt(interface.area), 0.0
    for force, face in forces:
        arm = face.centroid - interface.centroid
        moment = float(np.linalg.norm(np.cross(arm, force)))
        cone = pi * (sqrt(face.area / pi) + SPREAD * float(np.linalg.norm(arm))) ** 2
        pressing = float(np.linalg.norm(force)) + BENDING * moment / width
        total += pressing / min(interface.area, cone)
    return total
