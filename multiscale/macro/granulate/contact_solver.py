r"""Gauss-Seidel on the contacts of grains, with a Delassus operator that is never assembled."""

from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.fe.elements import sum_blocks
from multiscale.macro.granulate.contacts import Contacts
from multiscale.macro.granulate.model import Solver
from multiscale.nonsmooth import solve_friction, solve_lcp
from multiscale.numerics.compiled import compiled

SWEEPS_PER_CHECK = 10
"""Number of sweeps between two evaluations of the error."""


class Velocities(NamedTuple):
    """Velocities of grains and then of walls; fewer columns if grains do not rotate."""

    # columns 0-2 velocity, 4-6 radius times spin, m/s, shape (bodies, 8) or (bodies, 4)
    velocity: np.ndarray
    # inverse mass along the normal and across it, squared radius over inertia, 1/kg,
    # shape (bodies, 3) or (bodies, 1)
    mobility: np.ndarray
    # strain rate of a periodic cell along each axis, 1/s, and inverse root of its inertia,
    # 1/(kg m2)^.5, zero for a prescribed rate, shape (2, 3); None if the cell is rigid
    strain: np.ndarray | None


def solve_velocities(solver: Solver, motion: Velocities, contacts: Contacts) -> tuple[int, float]:
    r"""Solve the contacts of a step in place; return the sweeps and the relative error."""
    arguments = _arguments(contacts, motion)
    scale = _closing_size(*arguments)
    if scale == 0.0:
        contacts.impulse[:] = 0.0
        return 0, 0.0
    free = motion._replace(velocity=motion.velocity.copy())
    _apply_impulses(*arguments)
    target = solver.tolerance * scale
    done, error = _relax(*arguments, target, solver.max_iterations, SWEEPS_PER_CHECK)
    count = len(contacts.ends)
    if error <= target or motion.strain is not None or count > solver.most_assembled:
        return done, error / scale
    # sweeps stall where heavy grains lie on light grains, and in wedges
    impulse = _solve_assembled(free, contacts, 0.1 * solver.tolerance)
    solved = contacts._replace(impulse=impulse)
    _apply_impulses(*_arguments(solved, free))
    new = _natural_map_error(*_arguments(solved, free))
    if new < error:
        motion.velocity[:], contacts.impulse[:], error = free.velocity, solved.impulse, new
    return done, error / scale


def _arguments(contacts: Contacts, motion: Velocities) -> tuple[Any, ...]:
    """Return the arguments of the kernels; optional arrays are separate arguments."""
    # code for an argument that is None is not compiled
    return contacts._replace(coulomb=None), contacts.coulomb, motion[:2], motion.strain


def _solve_assembled(motion: Velocities, contacts: Contacts, tolerance: float) -> np.ndarray:
    """Return impulses, N s, of the assembled problem, with or without convergence."""
    # velocities and masses in the frames of the contacts
    velocity, normal, (i, j) = motion.velocity, contacts.normal, contacts.ends.T
    frames, masses, u = normal[:, None], contacts.mass[:, None], velocity[i, :3] - velocity[j, :3]
    if contacts.coulomb is not None:
        across, friction = contacts.coulomb.T
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
        first /= np.linalg.norm(first, axis=1)[:, None]
        # (contacts, 3, 3), right-handed: rows normal and tangents
        frames = np.stack([normal, first, np.cross(normal, first)], axis=1)
        masses = np.column_stack([contacts.mass, across, across])
        u = u - np.cross(velocity[i, 4:7] + velocity[j, 4:7], normal)

    def local(vector: np.ndarray) -> np.ndarray:
        return vector if vector.shape[1] == 1 else np.einsum("cab,cb->ca", frames, vector)

    # operator H^T M^-1 H with compliance, and velocities without impulses
    transfer, inverse = _transfer(frames, contacts.ends, motion.mobility)
    compliance = contacts.compliance[:, None] / masses  # 1/kg
    operator = csr_array(
        transfer.T @ diags_array(inverse) @ transfer + diags_array(compliance.ravel())
    )
    free = np.einsum("cab,cb->ca", frames, u)
    free[:, 0] += contacts.bias
    free -= compliance * local(contacts.anchor)
    q, start = free.ravel(), local(contacts.impulse).ravel()
    if contacts.coulomb is None:
        return solve_lcp(operator, q, tolerance=tolerance, start=start).value[:, None]
    solution = solve_friction(operator, q, friction, tolerance=tolerance, start=start)
    return np.asarray(np.einsum("cab,ca->cb", frames, solution.value.reshape(-1, 3)))


def _transfer(
    frames: np.ndarray, ends: np.ndarray, mobility: np.ndarray
) -> tuple[csr_array, np.ndarray]:
    r"""Return H, from contact impulses to momenta of bodies, and the inverse masses, 1/kg.

    The unknowns of a body are its velocity and radius times spin. A loaded wall moves only along
    its normal, so that its entries in the tangential columns are zero.
    """
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


@compiled(inline="always", fastmath=True)
def _relative_velocity(c, i, j, nx, ny, nz, velocity, coulomb, strain, branch):  # type: ignore[no-untyped-def]
    """Return u at the contact, body i minus body j, with the strain of the cell."""
    wx, wy, wz = 0.0, 0.0, 0.0
    if coulomb is not None:  # without friction, u is the velocity of the centres
        wx = velocity[i, 4] + velocity[j, 4]
        wy = velocity[i, 5] + velocity[j, 5]
        wz = velocity[i, 6] + velocity[j, 6]
    ux = velocity[i, 0] - velocity[j, 0] - (wy * nz - wz * ny)
    uy = velocity[i, 1] - velocity[j, 1] - (wz * nx - wx * nz)
    uz = velocity[i, 2] - velocity[j, 2] - (wx * ny - wy * nx)
    if strain is not None:
        ux += strain[0, 0] * branch[c, 0]
        uy += strain[0, 1] * branch[c, 1]
        uz += strain[0, 2] * branch[c, 2]
    return ux, uy, uz


@compiled(inline="always", fastmath=True)
def _strain_cell(c, dx, dy, dz, strain, branch):  # type: ignore[no-untyped-def]
    """Add the effect of an impulse d to the strain rates; it is equal along the free axes."""
    moment = strain[1, 0] * branch[c, 0] * dx + strain[1, 1] * branch[c, 1] * dy
    moment += strain[1, 2] * branch[c, 2] * dz
    strain[0, 0] += strain[1, 0] * moment
    strain[0, 1] += strain[1, 1] * moment
    strain[0, 2] += strain[1, 2] * moment


@compiled(inline="always", fastmath=True)
def _impulse_vector(c, impulse, coulomb):  # type: ignore[no-untyped-def]
    """Return an impulse in global axes, or (normal component, 0, 0) without friction."""
    if coulomb is None:
        x, y, z = impulse[c, 0], 0.0, 0.0
    else:
        x, y, z = impulse[c, 0], impulse[c, 1], impulse[c, 2]
    return x, y, z


@compiled(inline="always", fastmath=True)
def _normal_component(x, y, z, nx, ny, nz, coulomb):  # type: ignore[no-untyped-def]
    """Return the normal component of an impulse given by :func:`_impulse_vector`."""
    return x * nx + y * ny + z * nz if coulomb is not None else x


@compiled(fastmath=True)
def _apply_normal_impulse(i, j, nx, ny, nz, dn, velocity, mobility):  # type: ignore[no-untyped-def]
    """Add the effect of an impulse dn along the normal to the velocities."""
    along = mobility[i, 0] * dn
    velocity[i, 0] += along * nx
    velocity[i, 1] += along * ny
    velocity[i, 2] += along * nz
    along = mobility[j, 0] * dn
    velocity[j, 0] -= along * nx
    velocity[j, 1] -= along * ny
    velocity[j, 2] -= along * nz


@compiled(fastmath=True)
def _apply_impulse(i, j, nx, ny, nz, dx, dy, dz, dn, velocity, mobility):  # type: ignore[no-untyped-def]
    """Add the effect of an impulse d with the normal component dn to the velocities."""
    tx, ty, tz = ny * dz - nz * dy, nz * dx - nx * dz, nx * dy - ny * dx
    across, turn = mobility[i, 1], mobility[i, 2]  # i is a grain: same mass along and across
    velocity[i, 0] += across * dx
    velocity[i, 1] += across * dy
    velocity[i, 2] += across * dz
    velocity[i, 4] -= turn * tx
    velocity[i, 5] -= turn * ty
    velocity[i, 6] -= turn * tz
    across, turn = mobility[j, 1], mobility[j, 2]
    along = (mobility[j, 0] - across) * dn
    velocity[j, 0] -= across * dx + along * nx
    velocity[j, 1] -= across * dy + along * ny
    velocity[j, 2] -= across * dz + along * nz
    velocity[j, 4] -= turn * tx
    velocity[j, 5] -= turn * ty
    velocity[j, 6] -= turn * tz


@compiled(fastmath=True)
def _sweep(contacts, coulomb, motion, strain):  # type: ignore[no-untyped-def]
    r"""Solve the contacts in their order, each exactly while the others are fixed.

    The local W is diagonal, so that the normal impulse comes first and bounds the tangential one:

        r_N = max(0, (r_N + a anchor_N - m_N (u_N + b)) / (1 + a)),                      (1)
        r_T = projection of (r_T + a anchor_T - m_T u_T) / (1 + a) on the disc mu r_N.   (2)
    """
    velocity, mobility = motion
    ends, normals, branch = contacts.ends, contacts.normal, contacts.branch
    biases, masses, compliances = contacts.bias, contacts.mass, contacts.compliance
    impulse, anchor = contacts.impulse, contacts.anchor
    # the loop is inside: a function per contact would count references to the arrays each time
    for c in range(ends.shape[0]):
        i, j = ends[c, 0], ends[c, 1]
        nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
        mass, a, friction = 0.0, compliances[c], 0.0
        if coulomb is not None:
            mass, friction = coulomb[c, 0], coulomb[c, 1]
        ux, uy, uz = _relative_velocity(c, i, j, nx, ny, nz, velocity, coulomb, strain, branch)
        u = ux * nx + uy * ny + uz * nz
        rx, ry, rz = _impulse_vector(c, impulse, coulomb)
        ax, ay, az = _impulse_vector(c, anchor, coulomb)
        old = _normal_component(rx, ry, rz, nx, ny, nz, coulomb)
        anchored = _normal_component(ax, ay, az, nx, ny, nz, coulomb)
        give = 1.0 / (1.0 + a)
        normal = max(0.0, (old + a * anchored - (u + biases[c]) * masses[c]) * give)  # (1)
        if coulomb is None:
            moves = normal != old
            if moves:
                impulse[c, 0] = normal
                dn = normal - old
                dx, dy, dz = dn * nx, dn * ny, dn * nz
                _apply_normal_impulse(i, j, nx, ny, nz, dn, velocity, mobility)
        else:
            tx = (rx - old * nx + a * (ax - anchored * nx) - (ux - u * nx) * mass) * give
            ty = (ry - old * ny + a * (ay - anchored * ny) - (uy - u * ny) * mass) * give
            tz = (rz - old * nz + a * (az - anchored * nz) - (uz - u * nz) * mass) * give
            square, bound = tx * tx + ty * ty + tz * tz, friction * normal
            if square > bound * bound:  # (2)
                shrink = bound / np.sqrt(square)
                tx, ty, tz = tx * shrink, ty * shrink, tz * shrink
            dx, dy, dz = normal * nx + tx - rx, normal * ny + ty - ry, normal * nz + tz - rz
            moves = dx != 0.0 or dy != 0.0 or dz != 0.0
            if moves:
                impulse[c, 0], impulse[c, 1], impulse[c, 2] = rx + dx, ry + dy, rz + dz
                _apply_impulse(i, j, nx, ny, nz, dx, dy, dz, normal - old, velocity, mobility)
        if strain is not None and moves:
            _strain_cell(c, dx, dy, dz, strain, branch)


@compiled(fastmath=True)
def _apply_impulses(contacts, coulomb, motion, strain):  # type: ignore[no-untyped-def]
    """Add M^-1 H r to the velocities in place."""
    velocity, mobility = motion
    ends, normals, branch = contacts.ends, contacts.normal, contacts.branch
    impulse = contacts.impulse
    for c in range(ends.shape[0]):
        i, j, nx, ny, nz = ends[c, 0], ends[c, 1], normals[c, 0], normals[c, 1], normals[c, 2]
        x, y, z = _impulse_vector(c, impulse, coulomb)
        normal = _normal_component(x, y, z, nx, ny, nz, coulomb)
        if coulomb is None:
            x, y, z = normal * nx, normal * ny, normal * nz
            _apply_normal_impulse(i, j, nx, ny, nz, normal, velocity, mobility)
        else:
            _apply_impulse(i, j, nx, ny, nz, x, y, z, normal, velocity, mobility)
        if strain is not None:
            _strain_cell(c, x, y, z, strain, branch)


@compiled(fastmath=True)
def _closing_size(contacts, coulomb, motion, strain):  # type: ignore[no-untyped-def]
    """Return the norm of u + b n over the closing contacts, weighted by their masses, sqrt(J)."""
    velocity, _ = motion
    ends, normals, branch = contacts.ends, contacts.normal, contacts.branch
    biases, masses = contacts.bias, contacts.mass
    total = 0.0
    for c in range(ends.shape[0]):
        nx, ny, nz, b = normals[c, 0], normals[c, 1], normals[c, 2], biases[c]
        i, j = ends[c, 0], ends[c, 1]
        ux, uy, uz = _relative_velocity(c, i, j, nx, ny, nz, velocity, coulomb, strain, branch)
        ux, uy, uz = ux + b * nx, uy + b * ny, uz + b * nz
        if ux * nx + uy * ny + uz * nz < 0.0:
            total += (ux * ux + uy * uy + uz * uz) * masses[c]
    return np.sqrt(total)


@compiled(fastmath=True)
def _natural_map_error(contacts, coulomb, motion, strain):  # type: ignore[no-untyped-def]
    r"""Return the natural-map error of Coulomb's law, weighted by the masses, sqrt(J).

    In De Saxce's form, with the step rho of each contact and the compliance in u:

        F = r - P_K(r - rho (u + b n + mu |u_T| n)),    sqrt(sum |F|^2 / rho).       (3)
    """
    velocity, _ = motion
    ends, normals, branch = contacts.ends, contacts.normal, contacts.branch
    biases, masses, compliances = contacts.bias, contacts.mass, contacts.compliance
    impulse, anchor = contacts.impulse, contacts.anchor
    total = 0.0
    for c in range(ends.shape[0]):
        nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
        a, mu = compliances[c], 0.0
        if coulomb is not None:
            mu = coulomb[c, 1]
        rho = masses[c] / (1.0 + a)
        i, j = ends[c, 0], ends[c, 1]
        ux, uy, uz = _relative_velocity(c, i, j, nx, ny, nz, velocity, coulomb, strain, branch)
        u = ux * nx + uy * ny + uz * nz
        rx, ry, rz = _impulse_vector(c, impulse, coulomb)
        old = _normal_component(rx, ry, rz, nx, ny, nz, coulomb)
        rx, ry, rz = rx - old * nx, ry - old * ny, rz - old * nz
        ux, uy, uz = ux - u * nx, uy - u * ny, uz - u * nz
        if a > 0.0:
            ax, ay, az = _impulse_vector(c, anchor, coulomb)
            anchored = _normal_component(ax, ay, az, nx, ny, nz, coulomb)
            u += a * (old - anchored) / masses[c]
            if coulomb is not None:
                spring = a / coulomb[c, 0]
                ux += spring * (rx - ax + anchored * nx)
                uy += spring * (ry - ay + anchored * ny)
                uz += spring * (rz - az + anchored * nz)
        if coulomb is None:
            total += (old - max(0.0, old - rho * (u + biases[c]))) ** 2 / rho
            continue
        slip = np.sqrt(ux * ux + uy * uy + uz * uz)
        height = old - rho * (u + biases[c] + mu * slip)
        tx, ty, tz = rx - rho * ux, ry - rho * uy, rz - rho * uz
        length = np.sqrt(tx * tx + ty * ty + tz * tz)
        shrink = 1.0
        if mu * length <= -height:
            height, shrink = 0.0, 0.0
        elif length > mu * height:
            height = (height + mu * length) / (1.0 + mu * mu)
            shrink = mu * height / length
        fx, fy, fz = rx - shrink * tx, ry - shrink * ty, rz - shrink * tz
        total += ((old - height) ** 2 + fx * fx + fy * fy + fz * fz) / rho
    return np.sqrt(total)


@compiled(fastmath=True)
def _relax(contacts, coulomb, motion, strain, target, sweeps, burst):  # type: ignore[no-untyped-def]
    r"""Sweep until (3) is below the target; return the sweeps made and the error.

    Each sweep, from r to G(r), gives the gradient of a nonlinear conjugate gradient method in the
    norm of the masses of the contacts,

        g = G(r) - r,   beta = |g|^2 / |g'|^2,   p = g + beta p',   r = r + p,           (4)

    with p' = 0 if beta exceeds 1. The velocities, linear in r, are extrapolated with the same
    weights. The last of ``burst`` sweeps is not extrapolated, so that r lies in the cones.

    References
    ----------
    .. [1] M. Silcowitz-Hansen, S. Niebe and K. Erleben, Vis. Comput. 26 (2010) 893-901,
       doi:10.1007/s00371-010-0502-6. Algorithm 2.
    """
    velocity, _ = motion
    impulse, mass = contacts.impulse, contacts.mass
    error = _natural_map_error(contacts, coulomb, motion, strain)
    before, direction = np.empty_like(impulse), np.zeros_like(impulse)
    speed, change = np.empty_like(velocity), np.zeros_like(velocity)
    rate, turn = np.zeros((1, 3)), np.zeros((1, 3))
    previous, done = np.inf, 0
    while done < sweeps and not error <= target:
        last = min(done + burst, sweeps)
        while done < last:
            _copy(impulse, before)
            _copy(velocity, speed)
            if strain is not None:
                _copy(strain[:1], rate)
            _sweep(contacts, coulomb, motion, strain)
            done += 1
            size = 0.0
            for c in range(impulse.shape[0]):
                for k in range(impulse.shape[1]):
                    size += (impulse[c, k] - before[c, k]) ** 2 / mass[c]
            beta = size / previous if size < previous else 0.0
            previous = size
            _extrapolate(impulse, before, direction, beta, done < last)
            _extrapolate(velocity, speed, change, beta, done < last)
            if strain is not None:
                _extrapolate(strain[:1], rate, turn, beta, done < last)
        error = _natural_map_error(contacts, coulomb, motion, strain)
    return done, error


@compiled(inline="always", fastmath=True)
def _copy(value, target):  # type: ignore[no-untyped-def]
    """Copy an array; assignment to a slice would compile its error message as well."""
    for c in range(value.shape[0]):
        for k in range(value.shape[1]):
            target[c, k] = value[c, k]


@compiled(inline="always", fastmath=True)
def _extrapolate(value, before, direction, beta, moves):  # type: ignore[no-untyped-def]
    """Apply (4) to an array in place; without ``moves`` update only the direction."""
    for c in range(value.shape[0]):
        for k in range(value.shape[1]):
            direction[c, k] = beta * direction[c, k] + value[c, k] - before[c, k]
            if moves:
                value[c, k] = before[c, k] + direction[c, k]
