"""Interface laws: the same objects at every scale."""

from multiscale.laws.area import AreaLaw
from multiscale.laws.base import InterfaceLaw, NormalLaw, Response
from multiscale.laws.convex_decreasing import ConvexDecreasing
from multiscale.laws.damaged import Damaged
from multiscale.laws.exponential import Exponential
from multiscale.laws.frictional import Frictional

__all__ = [
    "AreaLaw",
    "ConvexDecreasing",
    "Damaged",
    "Exponential",
    "Frictional",
    "InterfaceLaw",
    "NormalLaw",
    "Response",
]
