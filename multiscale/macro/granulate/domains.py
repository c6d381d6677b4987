r"""Domains of grains: each solves its inner contacts, then the contacts between them are solved.

Inner contacts of two domains share no grain, so that the domains work side by side, each on the
velocities of its own grains; the interface passes on what they push.
"""

import numba
import numpy as np

from multiscale.macro.granulate.sweeps import (
    along,
    components,
    natural_map_error,
    push,
    relative_velocity,
    sweep,
)

__all__ = ["order_contacts", "relax_domains", "split_grains"]


def split_grains(position: np.ndarray, parts: int) -> np.ndarray:
    """Cut grains into domains of equal number by halving along the longest edge, again and again.

    Parameters
    ----------
    position : ndarray, shape (grains, 3)
        m.
    parts : int
        Number of domains, at most that of the grains.

    Returns
    -------
    ndarray of int, shape (grains,)
        Domain of each grain.

    Examples
    --------
    >>> split_grains(np.array([[0.0, 0, 0], [3, 0, 0], [1, 0, 0], [2, 0, 0]]), 2)
    array([0, 1, 0, 1])
    """
    domain = np.zeros(len(position), dtype=int)
    todo = [(np.arange(len(position)), 0, parts)]
    while todo:
        grains, first, count = todo.pop()
        if count == 1:
            domain[grains] = first
            continue
        axis = int(np.argmax(np.ptp(position[grains], axis=0)))
        order = grains[np.argsort(position[grains, axis], kind="stable")]
        low = count // 2
        cut = len(order) * low // count
        todo += [(order[:cut], first, low), (order[cut:], first + low, count - low)]
    return domain


def order_contacts(
    ends: np.ndarray, domain: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sort contacts by domain, those of the interface last.

    Parameters
    ----------
    ends : ndarray, shape (contacts, 2)
        Bodies; walls from the number of grains on.
    domain : ndarray, shape (grains,)
    free : ndarray of bool, shape (bodies,)
        Which bodies a contact moves: a wall that moves belongs to the interface.

    Returns
    -------
    order : ndarray, shape (contacts,)
    bounds : ndarray, shape (domains + 1,)
        First contact of every domain, and of the interface.
    """
    n, parts = domain.size, int(domain.max()) + 1
    first, second = ends[:, 0], ends[:, 1]
    own = domain[first]
    wall = second >= n
    other = np.where(wall, own, domain[np.minimum(second, n - 1)])
    inner = np.where(wall, ~free[second], own == other)
    key = np.where(inner, own, parts)
    order = np.argsort(key, kind="stable")
    return order, np.concatenate([[0], np.cumsum(np.bincount(key, minlength=parts + 1))[:-1]])


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _descend(  # type: ignore[no-untyped-def]
    first, last, steps, velocity, mobility, ends, data, coulomb, impulse, anchor, work, change
):
    r"""Conjugate projected gradients on the normal impulses of some contacts.

    Tangential impulses are held. With the masses of the contacts as preconditioner P and the
    gradient w = -(u + b), which is zero where a contact is open and opens further,

        p = P w + beta p,   beta = max(0, w.P(w - w') / w'.P w'),                         (1)
        r = max(0, r + (p.w / p.W p) p).                                                  (2)

    ``work`` (contacts, 2) holds w and p, ``change`` (bodies, 4) the velocities that p brings.
    """
    previous = 0.0
    for step in range(steps):
        size, overlap = 0.0, 0.0
        for c in range(first, last):
            i, j = ends[c, 0], ends[c, 1]
            nx, ny, nz, a, mass = data[c, 0], data[c, 1], data[c, 2], data[c, 5], data[c, 4]
            ux, uy, uz = relative_velocity(i, j, nx, ny, nz, velocity, None)
            rx, ry, rz = components(c, impulse, coulomb)
            r = along(rx, ry, rz, nx, ny, nz, coulomb)
            ax, ay, az = components(c, anchor, coulomb)
            held = along(ax, ay, az, nx, ny, nz, coulomb)
            w = -(ux * nx + uy * ny + uz * nz + data[c, 3] + a * (r - held) / mass)
            if step == 0:
                work[c, 1] = 0.0
            if r <= 0.0 and w <= 0.0:
                w, work[c, 1] = 0.0, 0.0
            size += mass * w * w
            overlap += mass * w * work[c, 0]
            work[c, 0] = w
            for k in range(3):
                change[i, k] = 0.0
                change[j, k] = 0.0
        if size == 0.0:
            return
        beta = max(0.0, (size - overlap) / previous) if step > 0 else 0.0  # (1)
        previous = size
        slope, curvature = 0.0, 0.0
        for c in range(first, last):
            nx, ny, nz = data[c, 0], data[c, 1], data[c, 2]
            p = data[c, 4] * work[c, 0] + beta * work[c, 1]
            work[c, 1] = p
            slope += p * work[c, 0]
            push(ends[c, 0], ends[c, 1], nx, ny, nz, p, change, mobility)
        for c in range(first, last):
            nx, ny, nz, p = data[c, 0], data[c, 1], data[c, 2], work[c, 1]
            ux, uy, uz = relative_velocity(ends[c, 0], ends[c, 1], nx, ny, nz, change, None)
            curvature += p * (ux * nx + uy * ny + uz * nz) + data[c, 5] * p * p / data[c, 4]
        if curvature <= 0.0 or slope <= 0.0:
            return
        length = slope / curvature
        for c in range(first, last):
            nx, ny, nz = data[c, 0], data[c, 1], data[c, 2]
            rx, ry, rz = components(c, impulse, coulomb)
            r = along(rx, ry, rz, nx, ny, nz, coulomb)
            d = max(0.0, r + length * work[c, 1]) - r  # (2)
            if coulomb is None:
                impulse[c, 0] += d
            else:
                impulse[c, 0] += d * nx
                impulse[c, 1] += d * ny
                impulse[c, 2] += d * nz
            push(ends[c, 0], ends[c, 1], nx, ny, nz, d, velocity, mobility)


@numba.njit(cache=True, fastmath=True, parallel=True, error_model="numpy")
def relax_domains(  # type: ignore[no-untyped-def]
    velocity,
    mobility,
    ends,
    data,
    coulomb,
    impulse,
    anchor,
    bounds,
    inner,
    conjugate,
    target,
    rounds,
    burst,
):
    """Solve domains side by side and the interface between them, round by round.

    A round gives every domain ``inner`` sweeps and ``conjugate`` steps of conjugate projected
    gradients on its normal impulses, and the interface a sweep. Returns the rounds made and
    the error of :func:`multiscale.macro.granulate.sweeps.natural_map_error`.
    """
    arrays = (velocity, mobility, ends, data, coulomb, impulse, anchor, None)
    error = natural_map_error(velocity, ends, data, coulomb, impulse, anchor, None)
    work = np.zeros((ends.shape[0] if conjugate > 0 else 0, 2))
    change = np.zeros((velocity.shape[0] if conjugate > 0 else 0, 4))
    done = 0
    while done < rounds and not error <= target:
        for _ in range(min(burst, rounds - done)):
            for part in numba.prange(bounds.size - 1):
                first, last = bounds[part], bounds[part + 1]
                for _ in range(inner):
                    sweep(first, last, *arrays)
                if conjugate > 0:
                    _descend(
                        first,
                        last,
                        conjugate,
                        velocity,
                        mobility,
                        ends,
                        data,
                        coulomb,
                        impulse,
                        anchor,
                        work,
                        change,
                    )
            sweep(bounds[-1], ends.shape[0], *arrays)
            done += 1
        error = natural_map_error(velocity, ends, data, coulomb, impulse, anchor, None)
    return done, error
