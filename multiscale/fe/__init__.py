"""Finite elements on scikit-fem meshes: elasticity, faces, boxes, mortar, named meshes."""
