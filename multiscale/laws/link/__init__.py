"""Link laws: bars, cables and struts by their axial strain, beams by their modes."""

from multiscale.laws.link.axial import Bar, Cable, Strut
from multiscale.laws.link.beam import Beam
from multiscale.laws.link.link_law import LinkLaw, LinkResponse

__all__ = ["Bar", "Beam", "Cable", "LinkLaw", "LinkResponse", "Strut"]
