"""Cells of flat layers: roughness as gap, compliance by wavelength."""
