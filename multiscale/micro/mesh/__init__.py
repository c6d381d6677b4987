"""Cells on scikit-fem meshes: any element, any geometry below a named contact face."""
