"""Where the energy of a step goes."""

import numpy as np

from multiscale.macro.granulate.contacts import Contacts
from multiscale.macro.granulate.model import Model

__all__ = ["account", "cell_of"]


def cell_of(model: Model, period: np.ndarray) -> tuple[float, float]:
    r"""Inertia of a periodic cell, kg m2, and the moment of the pressure on it, J.

    The inertia is that of the grains in an affine motion, :math:`m L^2 / 4`; the pressure does the
    work :math:`-p\,V\,d\,\dot\varepsilon` in d directions. A cell of given size never moves.
    """
    if model.pressure is None:
        return np.inf, 0.0
    edges = period[np.isfinite(period)]
    inertia = 0.25 * float(model.grains.mass.sum()) * float(np.mean(edges**2))
    volume = float(np.prod(edges)) * (model.grains.thickness or 1.0)
    return inertia, -model.pressure * volume * edges.size


def account(
    model: Model,
    h: float,
    velocities: tuple[np.ndarray, np.ndarray, np.ndarray],
    contacts: Contacts,
    rebound: np.ndarray,
    rates: tuple[float, float, float],
    length: np.ndarray,
    cell: tuple[float, float],
) -> tuple[float, float, float, float, float, float]:
    r"""Kinetic and elastic energy, work, and what contacts, scheme and damping took, J.

    ``rebound`` (contacts,) is the normal velocity that a contact will have after an impact, m/s,
    zero if there was none: what it will bring, and do against gravity in a step, is elastic energy.

    With the velocities before the step, after the damping and after the step, and
    :math:`\Delta v` the last change, the kinetic energy grows by

        work - contact dissipation - numerical dissipation - damping,

    where the contacts take :math:`-r \cdot u` and the scheme :math:`\Delta v^T M \Delta v / 2`.
    """
    mobility, (old, slow, velocity) = model.mobility, velocities
    mass = np.zeros((len(velocity), 8))
    moves, turns = mobility[:, 0] > 0.0, mobility[:, 2] > 0.0
    mass[moves, :3] = 1.0 / mobility[moves, :1]
    mass[turns, 4:7] = 1.0 / mobility[turns, 2:]
    inertia = cell[0] if np.isfinite(cell[0]) else 0.0

    def kinetic(v: np.ndarray, rate: float) -> float:
        return 0.5 * float(np.sum(mass * v * v)) + 0.5 * inertia * rate**2

    n, impulse, (i, j) = contacts.data[:, :3], contacts.impulse, contacts.ends.T
    v, w = velocity[:, :3], velocity[:, 4:7]
    along = np.sum(impulse * n, axis=1)
    u = v[i] - v[j] - np.cross(w[i] + w[j], n)
    power = float(np.sum(impulse * u)) + rates[2] * float(along @ length)

    # walls move as they are told: altogether, or across the normal along which they are loaded
    told = np.where((mobility[:, 1] == 0.0)[:, None], v, 0.0)
    for k, wall in enumerate(model.walls, model.grains.n):
        if moves[k]:
            told[k] -= (told[k] @ wall.unit) * wall.unit
    walls = float(np.sum(impulse * told[j]))
    work = h * float(np.sum(mass * model.push * velocity)) + walls + h * cell[1] * rates[2]

    across = np.sum(impulse**2, axis=1) - along**2
    data = contacts.data
    springs = data[:, 6] * (along**2 / data[:, 4] + across / data[:, 5])
    closing = -h * np.sum((model.push[i, :3] - model.push[j, :3]) * n, axis=1)
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
