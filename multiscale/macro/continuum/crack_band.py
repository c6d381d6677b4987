r"""Bodies that crack in bands of elements, by a sequence of linear solves [1]_.

With the factors of an earlier stiffness :math:`K_0 = K + M`, where the loss M since then couples
the unknowns A of cracked elements, and the columns :math:`Z = K_0^{-1} I_A`,

.. math:: (1 - Z_A M)\, u_A = (K_0^{-1} f)_A, \qquad u = K_0^{-1} f + Z M u_A.    \tag{1}

.. [1] J. G. Rots and S. Invernizzi, Int. J. Numer. Anal. Meth. Geomech. 28 (2004) 83-100,
   doi:10.1002/nag.328.
"""

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import CaseError
from multiscale.fe.elasticity import elastic_matrix
from multiscale.laws.bulk import AnisotropicElastic, Elastic, respond_bulk
from multiscale.laws.bulk.bulk_law import youngs_modulus_along
from multiscale.laws.softening import LAST_STRESS, Softening
from multiscale.macro.continuum.body import Body, fixed_motion, load_vector
from multiscale.numerics.factorisation import factorise
from multiscale.schema import CRACK_BAND, Dataset

SHAPES = ("MeshQuad1", "MeshHex1")

ROUNDING = 1e-9  # tension over the largest stress up to which it is zero
MOST_UNKNOWNS = 600  # unknowns of cracked elements above which the stiffness is factorised again


def follow_crack_band(
    body: Body,
    law: Softening,
    *,
    load: np.ndarray | None = None,
    teeth: int = 20,
    stop: float = 0.005,
    max_events: int = 5000,
) -> Dataset:
    """Pull a body until it has lost its strength.

    Parameters
    ----------
    body : Body
        Elastic, of quadrilaterals (plane strain, isotropic) or hexahedra; its supports are at rest.
    load : ndarray, shape (d nodes,), optional
        Nodal forces at the factor 1, N; of the tractions at the time 1 if not given.
    teeth : int, number of teeth of the law of an element
    stop : float, load over the largest load at which the path ends, dimensionless

    Returns
    -------
    Dataset, follows ``CRACK_BAND``; ``converged`` is 0 if ``max_events`` came first
    """
    kinds = Elastic if body.mesh.dim() == 2 else Elastic | AnisotropicElastic
    if type(body.mesh).__name__ not in SHAPES or not isinstance(body.law, kinds):
        raise CaseError(
            f"a crack band needs an elastic body of quadrilaterals or hexahedra, got "
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

    # sound body
    force = load_vector(body, 1.0) if load is None else load
    weakened = _Weakened(body, body.law, np.setdiff1d(np.arange(force.size), fixed), force)
    n, plane = body.mesh.t.shape[1], body.mesh.dim() == 2
    corner = body.mesh.p[:, body.mesh.t]  # (d, corners, elements)
    width, tooth = np.full(n, np.nan), np.zeros(n, dtype=int)
    share, strength = np.ones(n), np.full(n, law.strength)
    rows: list[tuple[float, float]] = [(0.0, 0.0)]
    largest, done = 0.0, False
    band: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for _ in range(max_events):
        # load at which the most critical element reaches its strength
        u = weakened.solve()
        worst, ratio, normal = weakened.find_worst(u, share / strength)
        if not ratio > 0.0:
            raise CaseError("no element of the body is in tension; reverse the load")
        factor = 1.0 / ratio
        rows.append((factor, factor * float(force @ u)))
        largest = max(largest, factor)
        if done := factor < stop * largest:
            break
        # next tooth of this element; its band lies across the first tension
        if worst not in band:
            width[worst] = np.ptp(normal @ corner[:, :, worst])
            modulus = _modulus(body.law, normal, plane=plane)
            band[worst] = law.teeth(modulus, float(width[worst]), teeth)
        tooth[worst] += 1
        share[worst], strength[worst] = (teeth_of[tooth[worst]] for teeth_of in band[worst])
        weakened.weaken(worst, float(share[worst]))
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


def _modulus(law: Elastic | AnisotropicElastic, normal: np.ndarray, *, plane: bool) -> float:
    """Young's modulus along a tension, Pa; in plane strain without contraction out of the plane."""
    if isinstance(law, Elastic):
        return law.youngs_modulus / (1.0 - law.poissons_ratio**2 if plane else 1.0)
    return float(youngs_modulus_along(law.stiffness, normal))


class _Weakened:
    """Stiffness of a body with elements that weaken in turn, by (1)."""

    def __init__(
        self, body: Body, law: Elastic | AnisotropicElastic, free: np.ndarray, force: np.ndarray
    ) -> None:
        self.body, self.law, self.free, self.force = body, law, free, force
        self.share = np.ones(body.mesh.t.shape[1])
        basis, d = body.basis, body.mesh.dim()
        weight = basis.dx / basis.dx.sum(axis=1, keepdims=True)
        self._slopes = np.stack(
            [np.einsum("jep,ep->je", np.asarray(shape[0].grad), weight) for shape in basis.basis]
        )
        self._place = np.full(force.size, -1)  # of an unknown among the free unknowns
        self._place[free] = np.arange(free.size)
        self._unknowns = (d * basis.element_dofs[:, None] + np.arange(d)[:, None]).reshape(
            -1, self.share.size
        )
        self._factorise()

    def _factorise(self) -> None:
        K = elastic_matrix(self.body.basis, self.law, self.share)
        self._apply = factorise(csr_array(K[self.free][:, self.free]), name="the cracked body")
        self._first = self._apply(self.force[self.free])
        self._cracked = np.zeros(0, dtype=int)
        self._columns, self._loss = np.zeros((self.free.size, 0)), np.zeros((0, 0))
        self._matrices: dict[int, np.ndarray] = {}

    def weaken(self, element: int, share: float) -> None:
        """Reduce the stiffness of an element to a share."""
        lost, self.share[element] = self.share[element] - share, share
        unknowns = self._unknowns[:, element]
        free = self._place[unknowns] >= 0
        at = self._place[unknowns[free]]

        # columns Z of an element that cracks for the first time
        if element not in self._matrices:
            if self._cracked.size > MOST_UNKNOWNS:
                self._factorise()
                return
            new = np.setdiff1d(at, self._cracked)
            unit = np.zeros((self.free.size, new.size))
            unit[new, np.arange(new.size)] = 1.0
            self._cracked = np.append(self._cracked, new)
            self._columns = np.hstack([self._columns, self._apply(unit)])
            self._loss = np.pad(self._loss, (0, new.size))
            K = elastic_matrix(self.body.basis.with_elements(np.array([element])), self.law)
            rows = unknowns[free]
            self._matrices[element] = K[rows][:, rows].toarray()

        # its loss in M
        order = np.argsort(self._cracked)
        rows = order[np.searchsorted(self._cracked, at, sorter=order)]
        self._loss[np.ix_(rows, rows)] += lost * self._matrices[element]

    def solve(self) -> np.ndarray:
        """Displacement of all unknowns under the load, m."""
        u = np.zeros(self.force.size)
        coupled = np.eye(self._cracked.size) - self._columns[self._cracked] @ self._loss
        cracked = np.linalg.solve(coupled, self._first[self._cracked])
        u[self.free] = self._first + self._columns @ (self._loss @ cracked)  # (1)
        return u

    def find_worst(self, u: np.ndarray, weight: np.ndarray) -> tuple[int, float, np.ndarray]:
        """Element of the largest stress times ``weight``, 1/Pa, this product, and its direction."""
        d = self.body.mesh.dim()
        local = u.reshape(-1, d)[self.body.basis.element_dofs]  # (nodes, elements, d)
        gradient = np.zeros((3, 3, self.share.size))
        gradient[:d, :d] = np.einsum("aei,aje->ije", local, self._slopes)
        at = np.eye(3)[:, :, None] + gradient
        response = respond_bulk(self.law, at, np.zeros((0, at.shape[2])))
        stress = response.stress[:d, :d].transpose(2, 0, 1)
        least = weight * np.diagonal(stress, axis1=1, axis2=2).max(axis=1)
        most = weight * np.linalg.norm(stress, axis=(1, 2))  # both bound the principal stress
        near = np.flatnonzero(most >= max(0.0, least.max()))
        value, vector = np.linalg.eigh(stress[near])
        pulled = value[:, -1] > ROUNDING * np.abs(stress).max()
        ratio = np.where(pulled, weight[near] * value[:, -1], 0.0)
        k = int(np.argmax(ratio))
        return int(near[k]), float(ratio[k]), vector[k, :, -1]
