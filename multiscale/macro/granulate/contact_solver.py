r"""Gauss-Seidel on the contacts of grains, whose Delassus operator is never assembled.

The arrays of the kernels, for b bodies (grains first, then walls) and m contacts:

- ``velocity`` (b, 8): velocity in columns 0-2 and radius times spin in 4-6, m/s; (b, 4) if
  nothing turns;
- ``mobility`` (b, 3): one over the mass along the normal and across it, and the squared radius
  over the inertia, 1/kg; (b, 1), the first alone, if nothing turns;
- ``ends`` (m, 2): the bodies i and j; the normal points from j to i;
- ``data`` (m, 6): normal; bias b, m/s; mass of the contact along the normal, kg; compliance a,
  dimensionless;
- ``coulomb`` (m, 2): mass of the contact across the normal, kg, and friction coefficient; ``None``
  if no contact has friction, and then no such code is compiled;
- ``impulse``, ``anchor`` (m, 3): r in global axes and the impulse at which its springs are relaxed,
  N s; (m, 1), along the normal, without friction;
- ``cell`` (m + 2, 3): along each axis the strain rate of a periodic cell, 1/s, one over the root of
  its inertia, 1/(kg m2)^.5, zero for a prescribed rate, and the branch of every contact, from
  centre j to centre i, m; ``None`` if the cell is rigid.
"""

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.fe.elements import sum_blocks
from multiscale.macro.granulate.contacts import Contacts
from multiscale.macro.granulate.model import Model, Solver
from multiscale.nonsmooth import solve_friction, solve_lcp
from multiscale.numerics.compiled import compiled

__all__ = ["solve_velocities"]

SWEEPS_PER_CHECK = 10
"""Number of sweeps between two evaluations of the error."""


def solve_velocities(
    model: Model, solver: Solver, velocity: np.ndarray, contacts: Contacts, cell: np.ndarray
) -> tuple[int, float]:
    r"""Solve the contacts of a step in place."""
    ends, data, coulomb, impulse, anchor = contacts.arrays
    strained = cell if model.pressure is not None else None
    scale = _closing_size(velocity, ends, data, coulomb, strained)
    if scale == 0.0:
        impulse[:] = 0.0
        return 0, 0.0
    free, mobility = velocity.copy(), model.mobility
    _apply_impulses(velocity, mobility, ends, data, coulomb, impulse, strained)
    limits = (solver.tolerance * scale, solver.max_iterations, SWEEPS_PER_CHECK)
    done, error = _relax(velocity, mobility, *contacts.arrays, strained, *limits)
    if error <= limits[0] or strained is not None or len(ends) > solver.most_assembled:
        return done, error / scale
    found = _solve_assembled(free, mobility, contacts, 0.1 * solver.tolerance)
    _apply_impulses(free, mobility, ends, data, coulomb, found, None)
    new = _natural_map_error(free, ends, data, coulomb, found, anchor, None)
    if new < error:
        velocity[:], impulse[:], error = free, found, new
    return done, error / scale


def _solve_assembled(
    velocity: np.ndarray, mobility: np.ndarray, contacts: Contacts, tolerance: float
) -> np.ndarray:
    """Solve the assembled problem by :func:`multiscale.nonsmooth.solve_friction`, or as an LCP.

    It serves problems on which Gauss-Seidel stalls: heavy grains on light grains, wedges. It takes
    the arguments of :func:`solve_velocities`, with velocities before the impulses act. It returns
    impulses, N s, of the shape of ``contacts.impulse``, that may miss the tolerance.
    """
    ends, data, coulomb, impulse, anchor = contacts.arrays
    if coulomb is None:
        return _solve_normal(velocity, mobility, contacts, tolerance)
    m = len(ends)
    normal = data[:, :3]
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    first /= np.linalg.norm(first, axis=1)[:, None]
    # (contacts, 3, 3), right-handed: rows normal and tangents
    frames = np.stack([normal, first, np.cross(normal, first)], axis=1)
    transfer, inverse = _transfer(frames, ends, mobility)
    across = coulomb[:, 0]
    compliance = data[:, 5:6] / np.column_stack([data[:, 4], across, across])  # 1/kg
    operator = transfer.T @ diags_array(inverse) @ transfer + diags_array(compliance.ravel())

    u = velocity[ends[:, 0]] - velocity[ends[:, 1]]
    turning = velocity[ends[:, 0], 4:7] + velocity[ends[:, 1], 4:7]
    free = np.einsum("cab,cb->ca", frames, u[:, :3] - np.cross(turning, data[:, :3]))
    free[:, 0] += data[:, 3]
    free -= compliance * np.einsum("cab,cb->ca", frames, anchor)
    begin = np.einsum("cab,cb->ca", frames, impulse).ravel()
    found = solve_friction(
        csr_array(operator), free.ravel(), coulomb[:, 1], tolerance=tolerance, start=begin
    )
    return np.asarray(np.einsum("cab,ca->cb", frames, found.value.reshape(m, 3)))


def _solve_normal(
    velocity: np.ndarray, mobility: np.ndarray, contacts: Contacts, tolerance: float
) -> np.ndarray:
    """Solve frictionless contacts: one impulse per contact, three velocities per body."""
    normal, m = contacts.data[:, :3], len(contacts.ends)
    compliance = contacts.data[:, 5] / contacts.data[:, 4]  # 1/kg
    at = (3 * contacts.ends[:, :, None] + np.arange(3)).reshape(m, 6)
    values = np.hstack([normal, -normal])[:, :, None]
    transfer = sum_blocks(values, at, np.arange(m)[:, None], (3 * len(mobility), m))
    inverse = np.repeat(mobility[:, 0], 3)
    operator = transfer.T @ diags_array(inverse) @ transfer + diags_array(compliance)
    free = transfer.T @ velocity[:, :3].ravel() + contacts.data[:, 3]
    free -= compliance * contacts.anchor[:, 0]
    found = solve_lcp(csr_array(operator), free, tolerance=tolerance, start=contacts.impulse[:, 0])
    return np.asarray(found.value[:, None])


def _transfer(
    frames: np.ndarray, ends: np.ndarray, mobility: np.ndarray
) -> tuple[csr_array, np.ndarray]:
    r"""Return H, from contact impulses to momenta of bodies, and the inverse masses, 1/kg.

    The unknowns of a body are its velocity and radius times spin. A loaded wall moves along its
    normal only, so its entries of the tangential columns are zero.
    """
    m, bodies = len(ends), len(mobility)
    transfer, place = csr_array((6 * bodies, 3 * m)), np.arange(3 * m).reshape(m, 3)
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
def _relative_velocity(i, j, nx, ny, nz, velocity, coulomb):  # type: ignore[no-untyped-def]
    """Return u at the contact, body i minus body j; without friction u of the centres."""
    wx, wy, wz = 0.0, 0.0, 0.0
    if coulomb is not None:
        wx = velocity[i, 4] + velocity[j, 4]
        wy = velocity[i, 5] + velocity[j, 5]
        wz = velocity[i, 6] + velocity[j, 6]
    ux = velocity[i, 0] - velocity[j, 0] - (wy * nz - wz * ny)
    uy = velocity[i, 1] - velocity[j, 1] - (wz * nx - wx * nz)
    uz = velocity[i, 2] - velocity[j, 2] - (wx * ny - wy * nx)
    return ux, uy, uz


@compiled(inline="always", fastmath=True)
def _add_strain_velocity(c, ux, uy, uz, cell):  # type: ignore[no-untyped-def]
    """Return u with the velocity due to the strain of the cell."""
    if cell is not None:
        ux += cell[0, 0] * cell[c + 2, 0]
        uy += cell[0, 1] * cell[c + 2, 1]
        uz += cell[0, 2] * cell[c + 2, 2]
    return ux, uy, uz


@compiled(inline="always", fastmath=True)
def _strain_cell(c, dx, dy, dz, cell):  # type: ignore[no-untyped-def]
    """Add the effect of an impulse d to the strain rates, equal along the free axes."""
    moment = cell[1, 0] * cell[c + 2, 0] * dx + cell[1, 1] * cell[c + 2, 1] * dy
    moment += cell[1, 2] * cell[c + 2, 2] * dz
    cell[0, 0] += cell[1, 0] * moment
    cell[0, 1] += cell[1, 1] * moment
    cell[0, 2] += cell[1, 2] * moment


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
    return x if coulomb is None else x * nx + y * ny + z * nz


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
    across, turn = mobility[i, 1], mobility[i, 2]  # i is a grain: one mass along and across
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
def _sweep(velocity, mobility, ends, data, coulomb, impulse, anchor, cell):  # type: ignore[no-untyped-def]
    r"""Solve the contacts in their order, each exactly while the others are fixed.

    W is diagonal there, so the normal part comes first and bounds the tangential one:

        r_N = max(0, (r_N + a anchor_N - m_N (u_N + b)) / (1 + a)),                      (1)
        r_T = projection of (r_T + a anchor_T - m_T u_T) / (1 + a) on the disc mu r_N.   (2)
    """
    # the loop is inside: a function of one contact would count references to the arrays each time
    for c in range(ends.shape[0]):
        i, j = ends[c, 0], ends[c, 1]
        nx, ny, nz = data[c, 0], data[c, 1], data[c, 2]
        mass, a, friction = 0.0, data[c, 5], 0.0
        if coulomb is not None:
            mass, friction = coulomb[c, 0], coulomb[c, 1]
        ux, uy, uz = _relative_velocity(i, j, nx, ny, nz, velocity, coulomb)
        ux, uy, uz = _add_strain_velocity(c, ux, uy, uz, cell)
        u = ux * nx + uy * ny + uz * nz
        rx, ry, rz = _impulse_vector(c, impulse, coulomb)
        ax, ay, az = _impulse_vector(c, anchor, coulomb)
        old = _normal_component(rx, ry, rz, nx, ny, nz, coulomb)
        held = _normal_component(ax, ay, az, nx, ny, nz, coulomb)
        give = 1.0 / (1.0 + a)
        normal = max(0.0, (old + a * held - (u + data[c, 3]) * data[c, 4]) * give)  # (1)
        if coulomb is None:
            moves = normal != old
            if moves:
                impulse[c, 0] = normal
                dn = normal - old
                dx, dy, dz = dn * nx, dn * ny, dn * nz
                _apply_normal_impulse(i, j, nx, ny, nz, dn, velocity, mobility)
        else:
            tx = (rx - old * nx + a * (ax - held * nx) - (ux - u * nx) * mass) * give
            ty = (ry - old * ny + a * (ay - held * ny) - (uy - u * ny) * mass) * give
            tz = (rz - old * nz + a * (az - held * nz) - (uz - u * nz) * mass) * give
            square, bound = tx * tx + ty * ty + tz * tz, friction * normal
            if square > bound * bound:  # (2)
                shrink = bound / np.sqrt(square)
                tx, ty, tz = tx * shrink, ty * shrink, tz * shrink
            dx, dy, dz = normal * nx + tx - rx, normal * ny + ty - ry, normal * nz + tz - rz
            moves = dx != 0.0 or dy != 0.0 or dz != 0.0
            if moves:
                impulse[c, 0], impulse[c, 1], impulse[c, 2] = rx + dx, ry + dy, rz + dz
                _apply_impulse(i, j, nx, ny, nz, dx, dy, dz, normal - old, velocity, mobility)
        if cell is not None and moves:
            _strain_cell(c, dx, dy, dz, cell)


@compiled(fastmath=True)
def _apply_impulses(velocity, mobility, ends, data, coulomb, impulse, cell):  # type: ignore[no-untyped-def]
    """Add M^-1 H r to the velocities in place."""
    for c in range(ends.shape[0]):
        i, j, nx, ny, nz = ends[c, 0], ends[c, 1], data[c, 0], data[c, 1], data[c, 2]
        x, y, z = _impulse_vector(c, impulse, coulomb)
        normal = _normal_component(x, y, z, nx, ny, nz, coulomb)
        if coulomb is None:
            x, y, z = normal * nx, normal * ny, normal * nz
            _apply_normal_impulse(i, j, nx, ny, nz, normal, velocity, mobility)
        else:
            _apply_impulse(i, j, nx, ny, nz, x, y, z, normal, velocity, mobility)
        if cell is not None:
            _strain_cell(c, x, y, z, cell)


@compiled(fastmath=True)
def _closing_size(velocity, ends, data, coulomb, cell):  # type: ignore[no-untyped-def]
    """Return the norm of u + b n over the closing contacts, weighted by their masses, sqrt(J)."""
    total = 0.0
    for c in range(ends.shape[0]):
        nx, ny, nz, b = data[c, 0], data[c, 1], data[c, 2], data[c, 3]
        ux, uy, uz = _relative_velocity(ends[c, 0], ends[c, 1], nx, ny, nz, velocity, coulomb)
        ux, uy, uz = _add_strain_velocity(c, ux, uy, uz, cell)
        ux, uy, uz = ux + b * nx, uy + b * ny, uz + b * nz
        if ux * nx + uy * ny + uz * nz < 0.0:
            total += (ux * ux + uy * uy + uz * uz) * data[c, 4]
    return np.sqrt(total)


@compiled(fastmath=True)
def _natural_map_error(velocity, ends, data, coulomb, impulse, anchor, cell):  # type: ignore[no-untyped-def]
    r"""Return the natural-map error of Coulomb's law, weighted by the masses, sqrt(J).

    In De Saxce's form, with the step rho of each contact and the compliance in u:

        F = r - P_K(r - rho (u + b n + mu |u_T| n)),    sqrt(sum |F|^2 / rho).       (3)
    """
    total = 0.0
    for c in range(ends.shape[0]):
        nx, ny, nz = data[c, 0], data[c, 1], data[c, 2]
        a, mu = data[c, 5], 0.0
        if coulomb is not None:
            mu = coulomb[c, 1]
        rho = data[c, 4] / (1.0 + a)
        ux, uy, uz = _relative_velocity(ends[c, 0], ends[c, 1], nx, ny, nz, velocity, coulomb)
        ux, uy, uz = _add_strain_velocity(c, ux, uy, uz, cell)
        u = ux * nx + uy * ny + uz * nz
        rx, ry, rz = _impulse_vector(c, impulse, coulomb)
        old = _normal_component(rx, ry, rz, nx, ny, nz, coulomb)
        rx, ry, rz = rx - old * nx, ry - old * ny, rz - old * nz
        ux, uy, uz = ux - u * nx, uy - u * ny, uz - u * nz
        if a > 0.0:
            ax, ay, az = _impulse_vector(c, anchor, coulomb)
            held = _normal_component(ax, ay, az, nx, ny, nz, coulomb)
            u += a * (old - held) / data[c, 4]
            if coulomb is not None:
                spring = a / coulomb[c, 0]
                ux += spring * (rx - ax + held * nx)
                uy += spring * (ry - ay + held * ny)
                uz += spring * (rz - az + held * nz)
        if coulomb is None:
            total += (old - max(0.0, old - rho * (u + data[c, 3]))) ** 2 / rho
            continue
        slip = np.sqrt(ux * ux + uy * uy + uz * uz)
        height = old - rho * (u + data[c, 3] + mu * slip)
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
def _relax(velocity, mobility, ends, data, coulomb, impulse, anchor, cell, target, sweeps, burst):  # type: ignore[no-untyped-def]
    r"""Sweep until (3) is below the target; return the sweeps made and the error.

    Each sweep, from r to G(r), gives the gradient of a nonlinear conjugate gradient method in the
    norm of the masses of the contacts,

        g = G(r) - r,   beta = |g|^2 / |g'|^2,   p = g + beta p',   r = r + p,           (4)

    with p' = 0 if beta exceeds one. The velocities, linear in r, are extrapolated with the same
    weights. The last of ``burst`` sweeps is not extrapolated, so that r lies in the cones.

    References
    ----------
    .. [1] M. Silcowitz-Hansen, S. Niebe and K. Erleben, Vis. Comput. 26 (2010) 893-901,
       doi:10.1007/s00371-010-0502-6. Algorithm 2.
    """
    contacts, width = ends.shape[0], 1 if coulomb is None else 3
    arrays = (velocity, mobility, ends, data, coulomb, impulse, anchor, cell)
    error = _natural_map_error(velocity, ends, data, coulomb, impulse, anchor, cell)
    before, direction = np.empty_like(impulse), np.zeros_like(impulse)
    speed, change = np.empty_like(velocity), np.zeros_like(velocity)
    rate, turn = np.zeros((1, 3)), np.zeros((1, 3))
    previous, done = np.inf, 0
    while done < sweeps and not error <= target:
        last = min(done + burst, sweeps)
        while done < last:
            _copy(impulse, before)
            _copy(velocity, speed)
            if cell is not None:
                _copy(cell[:1], rate)
            _sweep(*arrays)
            done += 1
            size = 0.0
            for c in range(contacts):
                for k in range(width):
                    size += (impulse[c, k] - before[c, k]) ** 2 / data[c, 4]
            beta = size / previous if size < previous else 0.0
            previous = size
            _extrapolate(impulse, before, direction, beta, done < last)
            _extrapolate(velocity, speed, change, beta, done < last)
            if cell is not None:
                _extrapolate(cell[:1], rate, turn, beta, done < last)
        error = _natural_map_error(velocity, ends, data, coulomb, impulse, anchor, cell)
    return done, error


@compiled(inline="always", fastmath=True)
def _copy(value, kept):  # type: ignore[no-untyped-def]
    """Copy an array; a slice would have the compiler write the message of its error."""
    for c in range(value.shape[0]):
        for k in range(value.shape[1]):
            kept[c, k] = value[c, k]


@compiled(inline="always", fastmath=True)
def _extrapolate(value, before, direction, beta, moves):  # type: ignore[no-untyped-def]
    """Apply (4) to one array in place; without ``moves`` update the direction only."""
    for c in range(value.shape[0]):
        for k in range(value.shape[1]):
            direction[c, k] = beta * direction[c, k] + value[c, k] - before[c, k]
            if moves:
                value[c, k] = before[c, k] + direction[c, k]
