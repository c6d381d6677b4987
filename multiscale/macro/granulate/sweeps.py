r"""Gauss-Seidel on the contacts of grains, whose Delassus operator is never assembled.

The arrays of the kernels, for b bodies (grains first, then walls) and m contacts:

- ``velocity`` (b, 8): velocity in columns 0-2 and radius times spin in 4-6, m/s;
- ``mobility`` (b, 3): one over the mass along the normal and across it, and the squared radius
  over the inertia, 1/kg;
- ``ends`` (m, 2): the bodies i and j; the normal points from j to i;
- ``data`` (m, 8): normal; bias b, m/s; masses of the contact along and across the normal, kg;
  compliance a and friction coefficient, dimensionless;
- ``impulse``, ``anchor`` (m, 3): r in global axes and where its tangential part springs from, N s.
"""

import numba
import numpy as np

__all__ = ["apply_impulses", "closing_size", "natural_map_error", "relax", "relax_coloured"]


@numba.njit(inline="always", fastmath=True, error_model="numpy")
def _relative_velocity(i, j, n, velocity):  # type: ignore[no-untyped-def]
    """Return u at the contact, body i minus body j."""
    wx = velocity[i, 4] + velocity[j, 4]
    wy = velocity[i, 5] + velocity[j, 5]
    wz = velocity[i, 6] + velocity[j, 6]
    ux = velocity[i, 0] - velocity[j, 0] - (wy * n[2] - wz * n[1])
    uy = velocity[i, 1] - velocity[j, 1] - (wz * n[0] - wx * n[2])
    uz = velocity[i, 2] - velocity[j, 2] - (wx * n[1] - wy * n[0])
    return ux, uy, uz


@numba.njit(inline="always", fastmath=True, error_model="numpy")
def _push(i, j, n, dx, dy, dz, dn, velocity, mobility):  # type: ignore[no-untyped-def]
    """Add to the velocities what an impulse d with the normal part dn brings."""
    for b, sign in ((i, 1.0), (j, -1.0)):
        across = sign * mobility[b, 1]
        along = sign * (mobility[b, 0] - mobility[b, 1]) * dn
        velocity[b, 0] += across * dx + along * n[0]
        velocity[b, 1] += across * dy + along * n[1]
        velocity[b, 2] += across * dz + along * n[2]
        turn = mobility[b, 2]
        velocity[b, 4] -= turn * (n[1] * dz - n[2] * dy)
        velocity[b, 5] -= turn * (n[2] * dx - n[0] * dz)
        velocity[b, 6] -= turn * (n[0] * dy - n[1] * dx)


@numba.njit(inline="always", fastmath=True, error_model="numpy")
def _solve_contact(c, velocity, mobility, ends, data, impulse, anchor):  # type: ignore[no-untyped-def]
    r"""Solve one contact exactly while the others are held.

    W is diagonal there, so the normal part comes first and bounds the tangential one:

        r_N = max(0, (r_N - m_N (u_N + b)) / (1 + a)),                            (1)
        r_T = projection of (r_T + a anchor_T - m_T u_T) / (1 + a) on the disc mu r_N.   (2)
    """
    i, j, n = ends[c, 0], ends[c, 1], data[c]
    ux, uy, uz = _relative_velocity(i, j, n, velocity)
    u = ux * n[0] + uy * n[1] + uz * n[2]
    rx, ry, rz = impulse[c, 0], impulse[c, 1], impulse[c, 2]
    old = rx * n[0] + ry * n[1] + rz * n[2]
    give = 1.0 / (1.0 + n[6])
    ax, ay, az = anchor[c, 0], anchor[c, 1], anchor[c, 2]
    held = ax * n[0] + ay * n[1] + az * n[2]
    normal = max(0.0, (old + n[6] * held - (u + n[3]) * n[4]) * give)  # (1)
    tx = rx - old * n[0] - (ux - u * n[0]) * n[5]
    ty = ry - old * n[1] - (uy - u * n[1]) * n[5]
    tz = rz - old * n[2] - (uz - u * n[2]) * n[5]
    tx = (tx + n[6] * (ax - held * n[0])) * give
    ty = (ty + n[6] * (ay - held * n[1])) * give
    tz = (tz + n[6] * (az - held * n[2])) * give
    square, bound = tx * tx + ty * ty + tz * tz, n[7] * normal
    if square > bound * bound:  # (2)
        shrink = bound / np.sqrt(square)
        tx, ty, tz = tx * shrink, ty * shrink, tz * shrink
    dx, dy, dz = normal * n[0] + tx - rx, normal * n[1] + ty - ry, normal * n[2] + tz - rz
    if dx != 0.0 or dy != 0.0 or dz != 0.0:
        impulse[c, 0], impulse[c, 1], impulse[c, 2] = rx + dx, ry + dy, rz + dz
        _push(i, j, n, dx, dy, dz, normal - old, velocity, mobility)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def apply_impulses(velocity, mobility, ends, data, impulse):  # type: ignore[no-untyped-def]
    """Add M^-1 H r to the velocities in place."""
    for c in range(ends.shape[0]):
        n, r = data[c], impulse[c]
        along = r[0] * n[0] + r[1] * n[1] + r[2] * n[2]
        _push(ends[c, 0], ends[c, 1], n, r[0], r[1], r[2], along, velocity, mobility)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def closing_size(velocity, ends, data):  # type: ignore[no-untyped-def]
    """Norm of u + b n over the contacts that close, with their masses, sqrt(J)."""
    total = 0.0
    for c in range(ends.shape[0]):
        n = data[c]
        ux, uy, uz = _relative_velocity(ends[c, 0], ends[c, 1], n, velocity)
        ux, uy, uz = ux + n[3] * n[0], uy + n[3] * n[1], uz + n[3] * n[2]
        if ux * n[0] + uy * n[1] + uz * n[2] < 0.0:
            total += (ux * ux + uy * uy + uz * uz) * n[4]
    return np.sqrt(total)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def natural_map_error(velocity, ends, data, impulse, anchor):  # type: ignore[no-untyped-def]
    r"""Norm of Coulomb's law as an equation, every contact with its mass, sqrt(J).

    De Saxce's form, with the step rho of each contact and the compliance in u:

        F = r - P_K(r - rho (u + b n + mu |u_T| n)),    sqrt(sum |F|^2 / rho).       (3)
    """
    total = 0.0
    for c in range(ends.shape[0]):
        n, r = data[c], impulse[c]
        mu, a, rho = n[7], n[6], n[4] / (1.0 + n[6])
        ux, uy, uz = _relative_velocity(ends[c, 0], ends[c, 1], n, velocity)
        u = ux * n[0] + uy * n[1] + uz * n[2]
        old = r[0] * n[0] + r[1] * n[1] + r[2] * n[2]
        rx, ry, rz = r[0] - old * n[0], r[1] - old * n[1], r[2] - old * n[2]
        ux, uy, uz = ux - u * n[0], uy - u * n[1], uz - u * n[2]
        if a > 0.0:
            ax, ay, az = anchor[c, 0], anchor[c, 1], anchor[c, 2]
            held = ax * n[0] + ay * n[1] + az * n[2]
            u += a * (old - held) / n[4]
            spring = a / n[5]
            ux += spring * (rx - ax + held * n[0])
            uy += spring * (ry - ay + held * n[1])
            uz += spring * (rz - az + held * n[2])
        slip = np.sqrt(ux * ux + uy * uy + uz * uz)
        height = old - rho * (u + n[3] + mu * slip)
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


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def relax(velocity, mobility, ends, data, impulse, anchor, target, sweeps, burst):  # type: ignore[no-untyped-def]
    """Sweep to and fro until (3) is below the target; return the sweeps made and the error."""
    contacts = ends.shape[0]
    error = natural_map_error(velocity, ends, data, impulse, anchor)
    done = 0
    while done < sweeps and not error <= target:
        for _ in range(min(burst, sweeps - done)):
            for c in range(contacts):
                _solve_contact(c, velocity, mobility, ends, data, impulse, anchor)
            done += 1
        error = natural_map_error(velocity, ends, data, impulse, anchor)
    return done, error


@numba.njit(cache=True, fastmath=True, parallel=True, error_model="numpy")
def relax_coloured(  # type: ignore[no-untyped-def]
    velocity, mobility, ends, data, impulse, anchor, bounds, target, sweeps, burst
):
    """Do the same colour by colour; the contacts after the last bound are not coloured."""
    error = natural_map_error(velocity, ends, data, impulse, anchor)
    done = 0
    threads = numba.get_num_threads()
    while done < sweeps and not error <= target:
        for _ in range(min(burst, sweeps - done)):
            for k in range(bounds.size - 1):
                first, size = bounds[k], bounds[k + 1] - bounds[k]
                if size < 64:
                    for c in range(first, first + size):
                        _solve_contact(c, velocity, mobility, ends, data, impulse, anchor)
                else:
                    for t in numba.prange(threads):
                        for c in range(
                            first + size * t // threads, first + size * (t + 1) // threads
                        ):
                            _solve_contact(c, velocity, mobility, ends, data, impulse, anchor)
            for c in range(bounds[-1], ends.shape[0]):
                _solve_contact(c, velocity, mobility, ends, data, impulse, anchor)
            done += 1
        error = natural_map_error(velocity, ends, data, impulse, anchor)
    return done, error
