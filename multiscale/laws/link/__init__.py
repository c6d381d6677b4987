"""Link laws: axial laws of bars, cables and struts, and modes of beams."""

from multiscale.laws.link.axial import Bar, Cable, Strut
from multiscale.laws.link.beam import Beam
from multiscale.laws.link.link_law import LinkLaw, LinkResponse

__all__ = ["Bar", "Beam", "Cable", "LinkLaw", "LinkResponse", "Strut"]
