"""Plates equivalent to periodic cells of links: averages over the cell, tension only included."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from multiscale.convergence import Status
from multiscale.errors import CaseError, ConvergenceError
from multiscale.macro.links.link_system import LinkSystem

STRAINS = (
    *("extension x", "extension y", "shear in the plane"),
    *("curvature x", "curvature y", "twist"),
    *("transverse shear x", "transverse shear y"),
)
"""Strains of a plate, in their order."""

MATCH = 1e-6  # distance, over a period, up to which nodes on opposite edges are the same
SOFT = 1e-12  # stiffness against a strain, over the largest of its kind, that counts as none
FLOOR = 1e-6  # stiffness of a slack link in the tangent, over its elastic stiffness
REST = 1e-13  # stiffness of a periodic motion, over the largest, that counts as none
TOLERANCE, MOST = 1e-12, 100  # residual of a cell over its tensions; Newton steps and halvings


class PlateResponse(NamedTuple):
    """Response of cells to strains of the plate, shapes (points, ...)."""

    resultant: np.ndarray  # (points, 8): N/m of membrane and shear forces, N of moments
    tangent: np.ndarray  # (points, 8, 8)
    slack: np.ndarray  # (points, links), whether a link carries no force that it cannot carry
    relaxed: np.ndarray  # (points, m), periodic motion, from which near strains are solved


@dataclass(frozen=True, eq=False)
class PlateCell:
    r"""Periodic cell of links of a plate in the plane z = 0; see :func:`plate_cell`.

    Attributes
    ----------
    strain : ndarray, shape (links, 8), elongation :math:`B_E` by unit strains of the plate
    motion : ndarray, shape (links, m), elongation :math:`B_v` by periodic motions of the nodes
    area : float, of the cell, m²
    elastic, prestress : ndarray, shape (links,), stiffness k, N/m, and tension :math:`\tau^0`, N
    bounds : ndarray, shape (2, links), admissible tensions, N

    Notes
    -----
    The plate has the strains E: extensions, curvatures and transverse shear, in the order of
    :data:`STRAINS`, with the displacement :math:`u_\alpha + z \theta_\alpha` of its sections. The
    cell adds the periodic motion :math:`v` of least energy, without a mean displacement and
    rotation of the sections. With the tensions of (14) and (15) of the source,

    .. math::
        \tau = P(\tau^0 + k (B_E E + B_v v)), \quad B_v^T \tau = 0, \qquad
        R = \frac1A B_E^T \tau,    \tag{1}

    where P is the projection on the admissible tensions, the resultants R are averages of the link
    forces over the area A of the cell, as (1) to (3) of the source average over an element: the
    membrane forces are :math:`\frac1A \sum_l \tau_l L_l\, d_l \otimes d_l`. Taut,

    .. math:: C = \frac1A \big(K_{EE} - K_{Ev} K_{vv}^{-1} K_{vE}\big).    \tag{2}
    """

    strain: np.ndarray
    motion: np.ndarray
    area: float
    elastic: np.ndarray
    prestress: np.ndarray
    bounds: np.ndarray

    @property
    def stiffness(self) -> np.ndarray:
        """Stiffness (2) of the taut plate, shape (8, 8): N/m, N and N m."""
        return np.asarray(self._condense(self.elastic[None])[0])

    def respond(self, strain: np.ndarray, relaxed: np.ndarray | None = None) -> PlateResponse:
        """Solve (1) by Newton's method for strains of shape (points, 8), each cell damped apart."""
        if relaxed is None:
            relaxed = np.zeros((len(strain), self.motion.shape[1]))
        k, fixed = self.elastic, self.prestress + strain @ (self.elastic[:, None] * self.strain).T
        by_motion = k[:, None] * self.motion
        for _ in range(MOST):
            elastic = fixed + relaxed @ by_motion.T
            tension = np.clip(elastic, *self.bounds)
            slack = tension != elastic
            residual = tension @ self.motion
            largest = np.abs(elastic).max(axis=1)
            if np.all(np.abs(residual).max(axis=1) <= TOLERANCE * largest):
                resultant = tension @ self.strain / self.area
                tangent = self._condense(np.where(slack, FLOOR, 1.0) * k)
                return PlateResponse(resultant, tangent, slack, relaxed)
            # Newton step, halved in every cell until its energy falls
            step = self._solve(np.where(slack, FLOOR, 1.0) * k, -residual[..., None])[..., 0]
            slope, share = np.sum(residual * step, axis=1), np.ones(len(step))
            before = self._energy(tension, elastic)
            for _ in range(MOST):
                trial = fixed + (relaxed + share[:, None] * step) @ by_motion.T
                energy = self._energy(np.clip(trial, *self.bounds), trial)
                rises = energy > before + 1e-4 * share * slope + TOLERANCE * np.abs(before)
                if not rises.any():
                    break
                share = np.where(rises, 0.5 * share, share)
            relaxed = relaxed + share[:, None] * step
        raise ConvergenceError(f"a cell of links did not converge: {Status.MAX_ITERATIONS.value}")

    def elastic_tension(self, strain: np.ndarray, relaxed: np.ndarray) -> np.ndarray:
        """Tension without slack of the links, (points, links), N; the argument of P in (1)."""
        stretch = strain @ self.strain.T + relaxed @ self.motion.T
        return np.asarray(self.prestress + self.elastic * stretch)

    def _energy(self, tension: np.ndarray, elastic: np.ndarray) -> np.ndarray:
        """Energy of the links, J; its derivative by the elongation is the tension."""
        return np.asarray((tension * (elastic - 0.5 * tension)) @ (1.0 / self.elastic))

    def _condense(self, stiffness: np.ndarray) -> np.ndarray:
        """Evaluate (2) for stiffnesses of the links of shape (points, links)."""
        weighted = stiffness[..., None] * self.strain
        mixed = self.motion.T @ weighted
        relaxed = self._solve(stiffness, mixed)
        condensed = self.strain.T @ weighted - mixed.transpose(0, 2, 1) @ relaxed
        return np.asarray(condensed / self.area)

    def _solve(self, stiffness: np.ndarray, right: np.ndarray) -> np.ndarray:
        K = self.motion.T @ (stiffness[..., None] * self.motion)
        return np.linalg.solve(K, right)


def plate_cell(system: LinkSystem, periods: tuple[float, float]) -> PlateCell:
    """Build the cell of a plate from the links of a single period.

    Parameters
    ----------
    system : LinkSystem
        Links of a cell, with their prestress; supports and loads do not count. Links on opposite
        edges belong to both cells that meet there, and count in both.
    periods : tuple of float, edges of the cell along x and y, m

    Raises
    ------
    CaseError
        If nodes on opposite edges do not match, a link is a beam or has a fixed length, the nodes
        lie in a plane, or a strain of the plate meets no stiffness.

    Examples
    --------
    >>> from multiscale.macro import tensegrity_grid
    >>> cell = plate_cell(tensegrity_grid(1), (1.0, 1.0))
    >>> cell.stiffness[:2, :2].round(-4)  # N/m
    array([[28790000.,  2830000.],
           [ 2830000., 28790000.]])
    """
    if system.n_components != 3 or not np.all(np.isfinite(system.stiffness)):
        raise CaseError(
            "the links of a cell of a plate are extensible bars, cables and struts; give them a "
            "finite rigidity, and no beams"
        )
    node, height = _same_nodes(system, periods)
    if not np.ptp(height) > 0.0:
        raise CaseError(
            f"all nodes of the cell lie at z = {height[0]:g} m, and without a height it has no "
            f"bending stiffness; give it two layers"
        )
    # elongation by displacements of all nodes, with those that repeat a node merged into it
    n, links, count = system.n_nodes, np.arange(system.n_links), height.size
    elongate = np.zeros((system.n_links, n, 3))
    elongate[links, system.ends[:, 1]] = system.direction
    elongate[links, system.ends[:, 0]] = -system.direction
    merge = np.kron(np.eye(count)[node], np.eye(3))
    # no mean displacement, and no mean rotation of the sections
    mean = np.kron(np.ones(count), np.eye(3))
    rotation = np.kron(height - height.mean(), np.eye(3)[:2])
    flat = elongate.reshape(system.n_links, 3 * n)
    motion = flat @ merge @ null_space(np.vstack([mean, rotation]))
    # motions without stiffness stay at rest
    stiffness, modes = np.linalg.eigh(motion.T @ (system.stiffness[:, None] * motion))
    modes = modes[:, stiffness > REST * stiffness.max(initial=0.0)]
    cell = PlateCell(
        flat @ _unit_strains(system.position).reshape(3 * n, 8),
        motion @ modes,
        periods[0] * periods[1],
        system.stiffness,
        system.prestress,
        system.bounds,
    )
    _refuse_soft(cell.stiffness)
    return cell


def _same_nodes(system: LinkSystem, periods: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of every node within the cell, and the heights of these, m."""
    period, low = np.array(periods), system.position[:, :2].min(axis=0)
    plan = (system.position[:, :2] - low) / period  # in periods
    if np.any(plan > 1.0 + MATCH):
        at = int(np.argmax(plan.max(axis=1)))
        raise CaseError(
            f"node {at} of the cell is {plan[at].max():.4g} periods from its edge; give the "
            f"links of one period, or longer periods"
        )
    inside = np.where(plan > 1.0 - MATCH, plan - 1.0, plan)
    key = np.column_stack([inside, system.position[:, 2] / period.max()])
    _, first, node = np.unique(
        np.round(key / MATCH).astype(int), axis=0, return_index=True, return_inverse=True
    )
    node = node.ravel()
    for axis, name in enumerate("xy"):
        lower, upper = (
            set(node[on]) for on in (plan[:, axis] < MATCH, plan[:, axis] > 1.0 - MATCH)
        )
        if lower != upper:
            raise CaseError(
                f"the cell is not periodic along {name}: {len(lower)} nodes at its lower edge and "
                f"{len(upper)} one period of {period[axis]:g} m further do not match; give both "
                f"edges the same nodes"
            )
    return node, system.position[first, 2]


def _unit_strains(position: np.ndarray) -> np.ndarray:
    """Displacements of nodes by unit strains of the plate, shape (nodes, 3, 8), m."""
    x, y, z = position.T
    u = np.zeros((len(position), 3, 8))
    u[:, 0, 0], u[:, 1, 1] = x, y
    u[:, 0, 2], u[:, 1, 2] = 0.5 * y, 0.5 * x
    u[:, 0, 3], u[:, 2, 3] = z * x, -0.5 * x**2
    u[:, 1, 4], u[:, 2, 4] = z * y, -0.5 * y**2
    u[:, 0, 5], u[:, 1, 5], u[:, 2, 5] = 0.5 * z * y, 0.5 * z * x, -0.5 * x * y
    u[:, 2, 6], u[:, 2, 7] = x, y
    return u


def _refuse_soft(stiffness: np.ndarray) -> None:
    diagonal = stiffness.diagonal()
    for kind in (slice(0, 3), slice(3, 6), slice(6, 8)):
        soft = np.flatnonzero(
            diagonal[kind] <= SOFT * max(diagonal[kind].max(), SOFT * diagonal.max())
        )
        if soft.size:
            raise CaseError(
                f"the cell is a mechanism: {STRAINS[kind][soft[0]]} of its plate has no "
                f"stiffness; brace the cell by further links"
            )
