"""Link laws: bars, cables and struts by their axial strain, beams by their modes."""

from multiscale.laws.link.axial import Bar, Cable, Strut
from multiscale.laws.link.base import LinkLaw, LinkResponse
from multiscale.laws.link.beam import Beam

__all__ = ["Bar", "Beam", "Cable", "LinkLaw", "LinkResponse", "Strut"]
