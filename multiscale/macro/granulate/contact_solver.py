r"""Gauss-Seidel on the contacts of grains, with a Delassus operator that is never assembled."""

from contextlib import suppress
from typing import Any

import numpy as np

from multiscale.errors import MultiscaleError
from multiscale.macro.granulate.contact_systems import solve_assembled, solve_interior
from multiscale.macro.granulate.contacts import Contacts, Velocities, relative_velocity
from multiscale.macro.granulate.model import Solver
from multiscale.numerics.compiled import compiled

SWEEPS_PER_CHECK = 10
"""Number of sweeps between two evaluations of the error."""

SMOOTH_SWEEPS = 200
"""Sweeps after which contacts without friction are solved by interior points."""

WINDOWS, MOST_IMPACTS = 10, 1000
"""Parts of a step whose impacts come one after another, and times that its pairs are visited."""


def solve_velocities(solver: Solver, motion: Velocities, contacts: Contacts) -> tuple[int, float]:
    r"""Solve the contacts of a step in place; return the sweeps and the relative error."""
    # norm of u + b n over the closing contacts, weighted by their masses, sqrt(J)
    rate = None if motion.strain is None else motion.strain[0]
    u = (
        relative_velocity(contacts, motion.velocity, rate)
        + contacts.bias[:, None] * contacts.normal
    )
    if not np.all(np.isfinite(u)):
        contacts.impulse[:] = 0.0
        return 0, np.nan
    closes = np.sum(u * contacts.normal, axis=1) < 0.0
    scale = float(np.sqrt(np.sum(u[closes] ** 2 * contacts.mass[closes, None])))
    arguments = _arguments(contacts, motion)
    if scale == 0.0:
        contacts.impulse[:] = 0.0
        return 0, 0.0
    free, count = motion._replace(velocity=motion.velocity.copy()), len(contacts.ends)
    _apply_impulses(*arguments)
    target, assembled = solver.tolerance * scale, count <= solver.most_assembled
    smooth = (
        contacts.coulomb is None and motion.strain is None and 0 < solver.most_assembled < count
    )
    sweeps = min(SMOOTH_SWEEPS, solver.max_iterations) if smooth else solver.max_iterations
    done, error = _relax(*arguments, target, sweeps, SWEEPS_PER_CHECK)
    if error <= target or motion.strain is not None or not (smooth or assembled):
        return done, error / scale
    # sweeps stall where heavy grains lie on light grains, in wedges and in dense piles
    with suppress(MultiscaleError):  # numbers out of range: the answer of the sweeps remains
        if smooth:
            impulse = solve_interior(free, contacts, scale, target)
        else:
            impulse = solve_assembled(free, contacts, 0.1 * solver.tolerance)
        solved = contacts._replace(impulse=impulse)
        _apply_impulses(*_arguments(solved, free))
        new = _natural_map_error(*_arguments(solved, free))
        if new < error:
            motion.velocity[:], contacts.impulse[:], error = free.velocity, solved.impulse, new
    return done, error / scale


def _arguments(contacts: Contacts, motion: Velocities) -> tuple[Any, ...]:
    """Return the arguments of the kernels; optional arrays are separate arguments."""
    # code for an argument that is None is not compiled
    plain = contacts._replace(coulomb=None, struck=None)
    return plain, contacts.coulomb, motion[:2], motion.strain


def collide(
    contacts: Contacts,
    motion: Velocities,
    gained: np.ndarray,
    restitution: float,
    rest: float,
    length: float,
) -> tuple[np.ndarray, bool]:
    """Solve the impacts of a step in turn, in place; return ways before them and completeness."""
    bodies = len(motion.velocity)
    shift, impulse = np.zeros((bodies, 3)), np.zeros_like(contacts.impulse)
    fastest = float(np.abs(motion.velocity[:, :3]).max(initial=0.0))
    complete = _collide(
        *_arguments(contacts._replace(impulse=impulse), motion),
        (gained, length, restitution, max(rest, 1e-12 * fastest)),
        shift,
        MOST_IMPACTS,
    )
    contacts.impulse[:] = impulse
    return shift, bool(complete)


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
    """Solve the contacts in their order, each exactly while the others are fixed."""
    velocity, mobility = motion
    ends, normals, branch = contacts.ends, contacts.normal, contacts.branch
    biases, masses, compliances = contacts.bias, contacts.mass, contacts.compliance
    impulse, anchor = contacts.impulse, contacts.anchor
    # the loop is inside: a function per contact would count references to the arrays each time
    for c in range(ends.shape[0]):
        i, j = ends[c, 0], ends[c, 1]
        nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
        mass, a, friction, across = 0.0, compliances[c], 0.0, 0.0
        if coulomb is not None:
            mass, friction, across = coulomb[c, 0], coulomb[c, 1], coulomb[c, 2]
        ux, uy, uz = _relative_velocity(c, i, j, nx, ny, nz, velocity, coulomb, strain, branch)
        u = ux * nx + uy * ny + uz * nz
        rx, ry, rz = _impulse_vector(c, impulse, coulomb)
        ax, ay, az = _impulse_vector(c, anchor, coulomb)
        old = _normal_component(rx, ry, rz, nx, ny, nz, coulomb)
        anchored = _normal_component(ax, ay, az, nx, ny, nz, coulomb)
        # the local W is diagonal: the normal impulse comes first and bounds the tangential part
        #     r_N = max(0, (r_N + a_N anchor_N - m_N (u_N + b)) / (1 + a_N))  (1)
        #     r_T = projection of (r_T + a_T anchor_T - m_T u_T) / (1 + a_T) on the disc mu r_N  (2)
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
            give = 1.0 / (1.0 + across)
            tx = (rx - old * nx + across * (ax - anchored * nx) - (ux - u * nx) * mass) * give
            ty = (ry - old * ny + across * (ay - anchored * ny) - (uy - u * ny) * mass) * give
            tz = (rz - old * nz + across * (az - anchored * nz) - (uz - u * nz) * mass) * give
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
def _collide(contacts, coulomb, motion, strain, law, shift, limit):  # type: ignore[no-untyped-def]
    """Solve impacts in turn; return whether none is left in the step; see :func:`collide`."""
    velocity, mobility = motion
    gained, h, restitution, rest = law
    ends, normals, branch = contacts.ends, contacts.normal, contacts.branch
    gaps, masses, impulse = contacts.gap, contacts.mass, contacts.impulse
    window, sweeps, impacts = 0, 0, 0
    while window < WINDOWS and sweeps < limit:
        sweeps += 1
        impacts = 0
        for c in range(ends.shape[0]):
            i, j = ends[c, 0], ends[c, 1]
            nx, ny, nz, turn = normals[c, 0], normals[c, 1], normals[c, 2], gained[c]
            ux, uy, uz = _relative_velocity(c, i, j, nx, ny, nz, velocity, coulomb, strain, branch)
            u = ux * nx + uy * ny + uz * nz
            # share of the step until they meet
            gap, time = gaps[c], 0.0
            gap += (shift[i, 0] - shift[j, 0]) * nx + (shift[i, 1] - shift[j, 1]) * ny
            gap += (shift[i, 2] - shift[j, 2]) * nz
            if gap > 0.0:
                root = np.sqrt(max(0.0, u * u - 2.0 * turn * gap / h)) - u
                time = 2.0 * gap / (h * root) if root > 0.0 else 2.0
            if time > (window + 1.0) / WINDOWS:
                continue
            if strain is not None:  # the places in a cell follow its strain: impacts are at once
                time = 0.0
            speed = u + time * turn
            if speed >= -rest:
                continue
            # from g + u th + a (th)²/2 = 0 at the share t of the step: r_N = -(1 + e) m_N (u + a t
            # h)_N, r_T the projection of -m_T u_T on the disc mu r_N (1). Bodies move as if from
            # the start of the step, from places shifted by -t h M^-1 H r_N: energy and work of the
            # forces on the shift then change by -(1 - e²) m_N (u + a t h)_N²/2 and the loss by
            # friction, and no cluster gains energy
            # impulses (1)
            impacts += 1
            dn = -(1.0 + restitution) * speed * masses[c]
            dx, dy, dz = dn * nx, dn * ny, dn * nz
            if coulomb is None:
                impulse[c, 0] += dn
                _apply_normal_impulse(i, j, nx, ny, nz, dn, velocity, mobility)
            else:
                mass, bound = coulomb[c, 0], coulomb[c, 1] * dn
                tx, ty, tz = (u * nx - ux) * mass, (u * ny - uy) * mass, (u * nz - uz) * mass
                size = np.sqrt(tx * tx + ty * ty + tz * tz)
                shrink = bound / size if size > bound else 1.0
                dx, dy, dz = dx + shrink * tx, dy + shrink * ty, dz + shrink * tz
                impulse[c, 0], impulse[c, 1] = impulse[c, 0] + dx, impulse[c, 1] + dy
                impulse[c, 2] += dz
                _apply_impulse(i, j, nx, ny, nz, dx, dy, dz, dn, velocity, mobility)
            if strain is not None:
                _strain_cell(c, dx, dy, dz, strain, branch)
            # way before the impact
            for body, sign in ((i, -1.0), (j, 1.0)):
                along = sign * time * h * mobility[body, 0] * dn
                shift[body, 0] += along * nx
                shift[body, 1] += along * ny
                shift[body, 2] += along * nz
        if impacts == 0:
            window += 1
    return window == WINDOWS


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
def _natural_map_error(contacts, coulomb, motion, strain):  # type: ignore[no-untyped-def]
    """Return the natural-map error of Coulomb's law, weighted by the masses, sqrt(J)."""
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
        if a > 0.0 or (coulomb is not None and coulomb[c, 2] > 0.0):
            ax, ay, az = _impulse_vector(c, anchor, coulomb)
            anchored = _normal_component(ax, ay, az, nx, ny, nz, coulomb)
            u += a * (old - anchored) / masses[c]
            if coulomb is not None:
                spring = coulomb[c, 2] / coulomb[c, 0]
                ux += spring * (rx - ax + anchored * nx)
                uy += spring * (ry - ay + anchored * ny)
                uz += spring * (rz - az + anchored * nz)
        if coulomb is None:
            total += min(old, rho * (u + biases[c])) ** 2 / rho
            continue
        # De Saxce: F = r - P_K(r - rho (u + b n + mu |u_T| n)),  sqrt(sum |F|² / rho)  (3)
        # F without differences of equal impulses, which may be huge where there is no solution
        slip = np.sqrt(ux * ux + uy * uy + uz * uz)
        fn, fx, fy, fz = rho * (u + biases[c] + mu * slip), rho * ux, rho * uy, rho * uz
        height = old - fn
        tx, ty, tz = rx - rho * ux, ry - rho * uy, rz - rho * uz
        length = np.sqrt(tx * tx + ty * ty + tz * tz)
        if mu * length <= -height:
            fn, fx, fy, fz = old, rx, ry, rz
        elif length > mu * height:
            fn = (fn + mu * (mu * old - length)) / (1.0 + mu * mu)
            shrink = mu * (old - fn) / length
            fx, fy, fz = rx - shrink * tx, ry - shrink * ty, rz - shrink * tz
        total += (fn * fn + fx * fx + fy * fy + fz * fz) / rho
    return np.sqrt(total)


@compiled(fastmath=True)
def _relax(contacts, coulomb, motion, strain, target, sweeps, burst):  # type: ignore[no-untyped-def]
    """Sweep until (3) is below the target; return the sweeps made and the error."""
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
            # conjugate gradients with the sweep G as gradient, in the norm of the masses (M.
            # Silcowitz-Hansen, S. Niebe and K. Erleben, Vis. Comput. 26 (2010) 893-901); the last
            # of a burst stays in the cones:
            #     g = G(r) - r,  beta = |g|²/|g'|² or 0 above 1,  p = g + beta p',  r = r + p  (4)
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
