"""Kernel of the internal forces and tangents of elements: sums over their quadrature points."""

import numpy as np

from multiscale.numerics.compiled import compiled

__all__ = ["integrate"]


@compiled
def integrate(G, w, stress, tangent, slope, curvature):  # type: ignore[no-untyped-def]
    """Element tangents and forces from stress, tangent and derivative of the volume."""
    n_elements, n_points, n_nodes, d = G.shape
    blocks = np.zeros((n_elements, n_nodes * d, n_nodes * d))
    force = np.zeros((n_elements, n_nodes * d))
    half = np.empty((n_nodes * d, d, d))
    swell = np.empty(n_nodes * d)
    for e in range(n_elements):
        swell[:] = 0.0
        for q in range(n_points):
            weight = w[e, q]
            for a in range(n_nodes):
                for i in range(d):
                    row = a * d + i
                    for j in range(d):
                        force[e, row] += weight * G[e, q, a, j] * stress[e, q, i, j]
                        swell[row] += weight * G[e, q, a, j] * slope[e, q, i, j]
                    for k in range(d):
                        for m in range(d):
                            total = 0.0
                            for j in range(d):
                                total += G[e, q, a, j] * tangent[e, q, i, j, k, m]
                            half[row, k, m] = weight * total
            for row in range(n_nodes * d):
                for b in range(n_nodes):
                    for k in range(d):
                        total = 0.0
                        for m in range(d):
                            total += half[row, k, m] * G[e, q, b, m]
                        blocks[e, row, b * d + k] += total
        for row in range(n_nodes * d):
            for column in range(n_nodes * d):
                blocks[e, row, column] += curvature[e] * swell[row] * swell[column]
    return blocks, force
