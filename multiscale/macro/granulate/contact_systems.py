r"""All contacts of a step at once, where sweeps fail: interior points, or the assembled problem."""

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array, diags_array, triu

from multiscale.errors import MultiscaleError
from multiscale.fe.elasticity import sum_blocks
from multiscale.macro.granulate.contacts import Contacts, Velocities, relative_velocity
from multiscale.nonsmooth import solve_lcp
from multiscale.nonsmooth.friction import approximate_friction
from multiscale.nonsmooth.lcp_methods import longest_positive
from multiscale.numerics.factorisation import prepare_cholesky

CENTRE, INTERIOR_STEPS = 1e-5, 40
"""Complementarity at the start of the interior points, relative to the closing velocities, and the
limit of their steps."""

Direction = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def solve_interior(
    motion: Velocities, contacts: Contacts, scale: float, target: float
) -> np.ndarray:
    """Return impulses without friction, N s, by interior points with the velocities as unknowns."""
    normal, mass = contacts.normal, contacts.mass
    C, rho = contacts.compliance / mass, mass / (1.0 + contacts.compliance)
    H, inverse = _transfer(normal[:, None], contacts.ends, motion.mobility)
    free = relative_velocity(contacts, motion.velocity)
    b = np.sum(free * normal, axis=1) + contacts.bias - C * contacts.anchor[:, 0]
    H, M = csr_array(H[inverse > 0.0]), 1.0 / inverse[inverse > 0.0]
    transposed = csr_array(H.T)

    # Mehrotra's steps towards M (v - v*) = H r, g = H^T v + b + C (r - r-), r_i g_i = c (1) without
    # impulses and openings: M + H diag(k) H^T, k = r / (g + C r), with three unknowns a grain
    # v is the change of velocity by the impulses
    r = np.maximum(contacts.impulse[:, 0], np.sqrt(CENTRE * mass) * scale)
    v = (H @ r) / M
    g = np.maximum(transposed @ v + b + C * r, np.sqrt(CENTRE / mass) * scale)
    best, smallest, factorise = r, np.inf, None
    for _ in range(INTERIOR_STEPS):
        u = transposed @ ((H @ r) / M) + b + C * r
        error = float(np.sqrt(np.sum((r - np.maximum(0.0, r - rho * u)) ** 2 / rho)))
        if error < smallest:
            best, smallest = r, error
        if error <= 0.9 * target:
            break
        stiffness = r / (g + C * r)
        matrix = csr_array(triu(H @ diags_array(stiffness) @ transposed + diags_array(M)))
        matrix.sort_indices()
        factorise = factorise or prepare_cholesky(matrix.indptr, matrix.indices)
        try:
            solve = factorise(matrix.data, False)
        except MultiscaleError:  # stiffnesses beyond the range of numbers
            break
        newton = _direction(solve, (r, g, C), H, (M * v - H @ r, transposed @ v + b + C * r - g))
        # predictor and corrector
        mean = float(r @ g) / r.size
        _, dr, dg = newton(-r * g)
        length = min(1.0, longest_positive(r, dr), longest_positive(g, dg))
        ahead = float((r + length * dr) @ (g + length * dg)) / r.size
        dv, dr, dg = newton((ahead / mean) ** 3 * mean - r * g - dr * dg)
        length = min(1.0, 0.99 * min(longest_positive(r, dr), longest_positive(g, dg)))
        r, g, v = r + length * dr, g + length * dg, v + length * dv
    return np.asarray(best[:, None])


def _direction(
    solve: Callable[[np.ndarray], np.ndarray],
    point: tuple[np.ndarray, np.ndarray, np.ndarray],
    transfer: csr_array,
    defects: tuple[np.ndarray, np.ndarray],
) -> Direction:
    """Return the function from products r dg + g dr to the changes of v, r and g by (1)."""
    (r, g, C), (balance, opening) = point, defects
    spread = g + C * r

    def newton(product: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        dv = solve(transfer @ ((product - r * opening) / spread) - balance)
        dr = (product - r * (transfer.T @ dv + opening)) / spread
        return dv, dr, (product - g * dr) / r

    return newton


def solve_assembled(motion: Velocities, contacts: Contacts, tolerance: float) -> np.ndarray:
    """Return impulses, N s, of the assembled problem, with or without convergence."""
    # velocities and compliances in the frames of the contacts
    normal, u = contacts.normal, relative_velocity(contacts, motion.velocity)
    frames = normal[:, None]
    compliance = (contacts.compliance / contacts.mass)[:, None]  # 1/kg
    if contacts.coulomb is not None:
        across, friction, give = contacts.coulomb.T
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
        first /= np.linalg.norm(first, axis=1)[:, None]
        # (contacts, 3, 3), right-handed: rows normal and tangents
        frames = np.stack([normal, first, np.cross(normal, first)], axis=1)
        compliance = np.column_stack([compliance[:, 0], give / across, give / across])

    def local(vector: np.ndarray) -> np.ndarray:
        return vector if vector.shape[1] == 1 else np.einsum("cab,cb->ca", frames, vector)

    # operator H^T M^-1 H with compliance, and velocities without impulses
    transfer, inverse = _transfer(frames, contacts.ends, motion.mobility)
    operator = csr_array(
        transfer.T @ diags_array(inverse) @ transfer + diags_array(compliance.ravel())
    )
    free = np.einsum("cab,cb->ca", frames, u)
    free[:, 0] += contacts.bias
    free -= compliance * local(contacts.anchor)
    q, start = free.ravel(), local(contacts.impulse).ravel()
    if contacts.coulomb is None:
        return solve_lcp(operator, q, tolerance=tolerance, start=start).value[:, None]
    solution, _ = approximate_friction(operator, q, friction, tolerance=tolerance, start=start)
    return np.asarray(np.einsum("cab,ca->cb", frames, solution.value.reshape(-1, 3)))


def _transfer(
    frames: np.ndarray, ends: np.ndarray, mobility: np.ndarray
) -> tuple[csr_array, np.ndarray]:
    """Return H, from contact impulses to momenta of bodies, and inverse masses, 1/kg."""
    m, c, _ = frames.shape
    transfer, place = csr_array((6 * len(mobility), c * m)), np.arange(c * m).reshape(m, c)
    if mobility.shape[1] == 1:  # without rotation
        mobility = mobility * [1.0, 0.0, 0.0]
    spin = np.cross(frames[:, :1], frames)  # n x axis, by axis
    for side, sign in ((0, 1.0), (1, -1.0)):
        body = ends[:, side]
        across = np.where(mobility[body, 1] > 0.0, 1.0, 0.0)
        axes = frames.copy()
        axes[:, 1:] *= across[:, None, None]
        for block, first, factor in ((axes, 0, sign), (-spin, 3, 1.0)):
            at = 6 * body[:, None] + first + np.arange(3)
            values = factor * block.transpose(0, 2, 1)
            transfer = transfer + sum_blocks(values, at, place, transfer.shape)
    return csr_array(transfer), np.repeat(mobility[:, [0, 2]], 3, axis=1).ravel()
