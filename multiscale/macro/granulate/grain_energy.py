"""Where the energy of a step goes."""

import numpy as np

from multiscale.macro.granulate.contacts import Contacts
from multiscale.macro.granulate.model import Model

__all__ = ["account_grains", "cell_inertia"]


def cell_inertia(model: Model, period: np.ndarray) -> tuple[float, float]:
    r"""Inertia of a periodic cell, kg m2, and the moment of the pressure on it, J.

    The inertia is that of the grains in an affine motion, :math:`m L^2 / 4`; the pressure does the
    work :math:`-p\,V\,d\,\dot\varepsilon` in the d directions in which the cell is free to strain.
    Where another strain is given the cell is lighter, :math:`m (2 R)^2`, and so follows its
    pressure. A cell of given size never moves.
    """
    if model.pressure is None:
        return np.inf, 0.0
    edges, mass = period[model.free], float(model.grains.mass.sum())
    if model.driven:
        inertia = mass * float(2.0 * model.grains.radius.mean()) ** 2
    else:
        inertia = 0.25 * mass * float(np.mean(edges**2))
    return inertia, -model.pressure * model.volume(period) * edges.size


def account_grains(
    model: Model,
    times: tuple[float, float],
    velocities: tuple[np.ndarray, np.ndarray, np.ndarray],
    contacts: Contacts,
    rebound: np.ndarray,
    rates: tuple[np.ndarray, np.ndarray, np.ndarray],
    branch: np.ndarray,
    cell: tuple[float, float],
) -> tuple[float, float, float, float, float, float]:
    r"""Kinetic and elastic energy, work, and what contacts, scheme and damping took, J.

    ``rebound`` (contacts,) is the normal velocity that a contact will have after an impact, m/s,
    zero if there was none: what it will bring, and do against gravity in a step, is elastic energy.

    With the velocities before the step, after the damping and after the step, and
    :math:`\Delta v` the last change, the kinetic energy grows by

        work - contact dissipation - numerical dissipation - damping,

    where the contacts take :math:`-r \cdot u` and the scheme :math:`\Delta v^T M \Delta v / 2`.

    The spring of a compliant contact forgets its load but not its overlap, against which the grains
    are pushed apart: what it keeps is its force times its overlap. ``times`` are the length of the
    step and the time in which the forces acted, s.
    """
    h, acted = times
    mass, (old, slow, velocity) = model.masses, velocities
    inertia = cell[0] if np.isfinite(cell[0]) else 0.0

    def kinetic(v: np.ndarray, rate: np.ndarray) -> float:
        return 0.5 * float(np.sum(mass * v * v)) + 0.5 * inertia * alike(rate) ** 2

    def alike(rate: np.ndarray) -> float:
        return float(np.sum(rate[model.free])) / max(1, int(model.free.sum()))

    n, impulse, (i, j) = contacts.data[:, :3], contacts.vectors, contacts.ends.T
    v, along = velocity[:, :3], contacts.normal_impulse
    u = v[i] - v[j]
    if contacts.coulomb is not None:
        w = velocity[:, 4:7]
        u = u - np.cross(w[i] + w[j], n)
    moments = np.sum(impulse * branch, axis=0)  # on the cell, along its axes
    power = float(np.sum(impulse * u)) + float(moments @ rates[2])

    # walls move as they are told: altogether, or across the normal along which they are loaded
    told = np.where((np.arange(len(v)) >= model.grains.n)[:, None], v, 0.0)
    for k, wall in enumerate(model.walls, model.grains.n):
        if mass[k, 0] > 0.0:
            told[k] -= (told[k] @ wall.unit) * wall.unit
    walls = float(np.sum(impulse * told[j]))
    told_rate = np.where(model.free, 0.0, rates[2])
    work = float(np.sum(mass * model.push * velocity)) + cell[1] * alike(rates[2])
    work = acted * work + walls - float(moments @ told_rate)

    data, bias = contacts.data, contacts.data[:, 3]
    speed = np.sum((u + rates[2] * branch) * n, axis=1)
    gap = h * (np.where(bias > 0.0, bias, bias * model.law.relaxation) + speed)
    overlap = np.where(data[:, 5] > 0.0, np.maximum(-gap, 0.0), 0.0)
    springs = 2.0 * along / acted * overlap
    closing = -acted * np.sum((model.push[i, :3] - model.push[j, :3]) * n, axis=1)
    rise = rebound**2 - np.sum(u * n, axis=1) ** 2 + 2.0 * rebound * np.maximum(closing, 0.0)
    springs += data[:, 4] * np.where(rebound > 0.0, np.maximum(rise, 0.0), 0.0)
    return (
        kinetic(velocity, rates[2]),
        0.5 * float(np.sum(springs)),
        work,
        -power,
        kinetic(velocity - slow, rates[2] - rates[1]),
        kinetic(old, rates[0]) - kinetic(slow, rates[1]),
    )
