"""Linear elastic layers: cells, compliance by wavelength, contact, stiffness of the mesh."""
