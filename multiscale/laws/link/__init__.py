"""Link laws: axial laws of bars, cables and struts, and modes of beams."""

from multiscale.laws.link.beam import Beam
from multiscale.laws.link.link_law import Bar, Cable, LinkLaw, LinkResponse, Strut

__all__ = ["Bar", "Beam", "Cable", "LinkLaw", "LinkResponse", "Strut"]
