"""Where the energy of a step goes."""

import numpy as np

from multiscale.macro.granulate.contacts import Contacts
from multiscale.macro.granulate.model import Model

__all__ = ["account"]


def account(
    model: Model,
    h: float,
    old: np.ndarray,
    slow: np.ndarray,
    velocity: np.ndarray,
    contacts: Contacts,
    rate: float,
) -> tuple[float, float, float, float, float, float]:
    r"""Kinetic and elastic energy, work, and what contacts, scheme and damping took.

    With :math:`\Delta v = v^+ - v^-`, the change of the kinetic energy is

        work - contact dissipation - numerical dissipation - damping,

    where the contacts take :math:`-r \cdot u` and the scheme :math:`\Delta v^T M \Delta v / 2`.
    """
    mobility = model.mobility
    mass = np.zeros((len(velocity), 8))
    moves = mobility[:, 0] > 0.0
    mass[moves, :3] = 1.0 / mobility[moves, :1]
    turns = mobility[:, 2] > 0.0
    mass[turns, 4:7] = 1.0 / mobility[turns, 2:]

    def kinetic(v: np.ndarray) -> float:
        return 0.5 * float(np.sum(mass * v * v))

    n = contacts.data[:, :3]
    i, j = contacts.ends.T
    v, w = velocity[:, :3], velocity[:, 4:7]
    u = v[i] - v[j] - np.cross(w[i] + w[j], n)
    power = float(np.sum(contacts.impulse * u))
    radius = np.append(model.grains.radius, np.zeros(len(model.walls)))
    along = np.sum(contacts.impulse * n, axis=1)
    grains = j < model.grains.n
    cell = rate * float(np.sum((along * (radius[i] + radius[j]))[grains]))
    given = v * (mobility[:, 1] == 0.0)[:, None] * 1.0  # walls, across their normal or altogether
    loaded = np.flatnonzero((mobility[:, 1] == 0.0) & moves)
    for k in loaded:
        axis = model.walls[k - model.grains.n].unit
        given[k] -= (given[k] @ axis) * axis
    walls = float(np.sum(contacts.impulse * given[j]))
    work = h * float(np.sum(mass * model.push * velocity)) + walls - cell
    damped = kinetic(old) - kinetic(slow)
    across = np.sum(contacts.impulse**2, axis=1) - along**2
    data = contacts.data
    elastic = 0.5 * float(np.sum(data[:, 6] * (along**2 / data[:, 4] + across / data[:, 5])))
    return (
        kinetic(velocity),
        elastic,
        work,
        -power - cell,
        kinetic(velocity - slow),
        damped,
    )
