r"""Bodies that crack in bands of elements, by a sequence of linear solves.

Each element bears a fraction of its first stiffness, which falls tooth by tooth of its softening
law. In every event the load is scaled so that the most critical element reaches the strength of
its tooth; it goes on to its next tooth, and the structure is solved again [1]_. No step can fail to
converge, and load and displacement may both fall.

References
----------
.. [1] J. G. Rots and S. Invernizzi, Int. J. Numer. Anal. Meth. Geomech. 28 (2004) 83-100,
   doi:10.1002/nag.328.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import spsolve

from multiscale.errors import CaseError
from multiscale.fe.elasticity import elastic_matrix
from multiscale.laws.bulk import Elastic, respond_bulk
from multiscale.laws.softening import LAST_STRESS, SawTeeth, Softening
from multiscale.macro.continuum.body import Body, fixed_motion, load_vector
from multiscale.schema import CRACK_BAND

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["follow_crack_band"]

SHAPES = ("MeshQuad1", "MeshHex1")


def follow_crack_band(
    body: Body, law: Softening, *, teeth: int = 20, stop: float = 0.005, max_events: int = 5000
) -> "xr.Dataset":
    """Pull a body until it has lost its strength.

    Parameters
    ----------
    body : Body
        Isotropic, of quadrilaterals (plane strain) or hexahedra; its tractions at the time one are
        the load at the factor one, its supports are at rest.
    law : Softening
    teeth : int, parts into which the law of an element is cut
    stop : float, load over the largest one at which the search ends, dimensionless
    max_events : int

    Returns
    -------
    Dataset
        Follows ``CRACK_BAND``; ``converged`` is 0 if ``max_events`` came first.

    Raises
    ------
    CaseError
        If the mesh is of triangles or tetrahedra, whose bands have no width, supports move, or
        nothing loads the body in tension.
    """
    if type(body.mesh).__name__ not in SHAPES or not isinstance(body.law, Elastic):
        raise CaseError(
            f"a crack band needs an isotropic body of quadrilaterals or hexahedra, got "
            f"{type(body.mesh).__name__} and {type(body.law).__name__}"
        )
    if not 2.0 * LAST_STRESS <= stop < 1.0 or teeth < 2:
        raise CaseError(
            f"stop must lie from {2.0 * LAST_STRESS:g} to 1 and teeth count from 2, got {stop:g} "
            f"and {teeth}"
        )
    fixed, motion = fixed_motion(body, 1.0)
    if np.any(motion):
        raise CaseError("the supports of a body with a crack band must be at rest; load its faces")
    force = load_vector(body, 1.0)
    free = np.setdiff1d(np.arange(force.size), fixed)
    n = body.mesh.t.shape[1]
    corner = body.mesh.p[:, body.mesh.t]  # (d, corners, elements)
    width, tooth = np.full(n, np.nan), np.zeros(n, dtype=int)
    share, strength = np.ones(n), np.full(n, law.strength)
    rows: list[tuple[float, float]] = [(0.0, 0.0)]
    largest, q, factor, done = 0.0, 0.0, 0.0, False
    cut: dict[float, SawTeeth] = {}
    modulus = body.law.youngs_modulus
    if body.mesh.dim() == 2:  # plane strain
        modulus /= 1.0 - body.law.poissons_ratio**2
    for _ in range(max_events):
        u = np.zeros(force.size)
        K = csr_array(elastic_matrix(body.basis, body.law, share))
        u[free] = spsolve(K[free][:, free].tocsc(), force[free])
        tension, normal = _tension(body, u)
        ratio = share * tension / strength
        worst = int(np.argmax(ratio))
        if not ratio[worst] > 0.0:
            raise CaseError("no element of the body is in tension; reverse the load")
        factor = float(1.0 / ratio[worst])
        q = factor * float(force @ u)
        rows.append((factor, q))
        largest = max(largest, factor)
        if done := factor < stop * largest:
            break
        if not tooth[worst]:  # the band lies across the first tension
            width[worst] = round(float(np.ptp(normal[:, worst] @ corner[:, :, worst])), 12)
        wide = float(width[worst])
        if wide not in cut:
            cut[wide] = law.teeth(modulus, np.array(wide), teeth)
        tooth[worst] += 1
        share[worst] = cut[wide].share[tooth[worst]]
        strength[worst] = cut[wide].strength[tooth[worst]]
    factors, moved = np.array(rows).T
    steps = 0.5 * (factors[:-1] * moved[1:] - factors[1:] * moved[:-1])
    return CRACK_BAND.build(
        {
            "factor": factors,
            "work_displacement": moved,
            "dissipation": np.append(0.0, np.cumsum(steps)),
            "stiffness_share": share,
            "band_width": width,
            "converged": int(done),
        }
    )


def _tension(body: Body, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest principal stress of the sound material, (elements,), Pa, and its direction."""
    basis, d = body.basis, body.mesh.dim()
    slopes = np.stack([np.asarray(shape[0].grad) for shape in basis.basis])
    weight = basis.dx / basis.dx.sum(axis=1, keepdims=True)
    local = u.reshape(-1, d)[basis.element_dofs]  # (nodes, elements, d)
    gradient = np.zeros((3, 3, weight.shape[0]))
    gradient[:d, :d] = np.einsum("aei,ajep,ep->ije", local, slopes, weight)
    at = np.eye(3)[:, :, None] + gradient
    stress = respond_bulk(body.law, at, np.zeros((0, at.shape[2]))).stress
    value, vector = np.linalg.eigh(stress[:d, :d].transpose(2, 0, 1))
    return value[:, -1], vector[:, :, -1].T
