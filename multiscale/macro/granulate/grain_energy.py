"""Energy balance of a step."""

import numpy as np

from multiscale.macro.granulate.contacts import Contacts
from multiscale.macro.granulate.model import Model

__all__ = ["account_grains", "cell_inertia"]


def cell_inertia(model: Model, period: np.ndarray) -> tuple[float, float]:
    r"""Return the inertia of a periodic cell, kg m2, and the moment of the pressure on it, J.

    The inertia belongs to an affine motion of the grains, :math:`m L^2 / 4`; the power of the
    pressure is :math:`-p\,V\,d\,\dot\varepsilon` for the d directions in which the cell strains
    freely. If a strain rate is prescribed along another axis, the smaller inertia
    :math:`m (2 R)^2` makes the cell follow the pressure. The inertia of a cell of given size is
    infinite.
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
) -> dict[str, float]:
    r"""Return kinetic and elastic energy, work, and dissipation by contacts, scheme and damping, J.

    Notes
    -----
    With :math:`\Delta v` the change of velocity after the damping, the kinetic energy grows by

        work - contact dissipation - numerical dissipation - damping,

    where the contacts dissipate :math:`-r \cdot u` and the scheme
    :math:`\Delta v^T M \Delta v / 2`.

    The spring of a compliant contact relaxes its force but pushes the grains apart against their
    overlap: its energy counts as force times overlap.
    """
    h, acted = times
    mass, (old, slow, velocity) = model.masses, velocities
    inertia = cell[0] if np.isfinite(cell[0]) else 0.0

    def kinetic(v: np.ndarray, rate: np.ndarray) -> float:
        return 0.5 * float(np.sum(mass * v * v)) + 0.5 * inertia * mean_rate(rate) ** 2

    def mean_rate(rate: np.ndarray) -> float:
        return float(np.sum(rate[model.free])) / max(1, int(model.free.sum()))

    n, impulse, (i, j) = contacts.data[:, :3], contacts.vectors, contacts.ends.T
    v, along = velocity[:, :3], contacts.normal_impulse
    u = v[i] - v[j]
    if contacts.coulomb is not None:
        w = velocity[:, 4:7]
        u = u - np.cross(w[i] + w[j], n)
    moments = np.sum(impulse * branch, axis=0)  # on the cell, along its axes
    power = float(np.sum(impulse * u)) + float(moments @ rates[2])

    # prescribed velocities of walls; a loaded wall moves freely along its normal
    prescribed = np.where((np.arange(len(v)) >= model.grains.n)[:, None], v, 0.0)
    for k, wall in enumerate(model.walls, model.grains.n):
        if mass[k, 0] > 0.0:
            prescribed[k] -= (prescribed[k] @ wall.unit) * wall.unit
    walls = float(np.sum(impulse * prescribed[j]))
    prescribed_rate = np.where(model.free, 0.0, rates[2])
    work = float(np.sum(mass * model.free_acceleration * velocity)) + cell[1] * mean_rate(rates[2])
    work = acted * work + walls - float(moments @ prescribed_rate)

    data, bias = contacts.data, contacts.data[:, 3]
    speed = np.sum((u + rates[2] * branch) * n, axis=1)
    gap = h * (np.where(bias > 0.0, bias, bias * model.law.relaxation) + speed)
    overlap = np.where(data[:, 5] > 0.0, np.maximum(-gap, 0.0), 0.0)
    springs = 2.0 * along / acted * overlap
    closing = -acted * np.sum(
        (model.free_acceleration[i, :3] - model.free_acceleration[j, :3]) * n, axis=1
    )
    rise = rebound**2 - np.sum(u * n, axis=1) ** 2 + 2.0 * rebound * np.maximum(closing, 0.0)
    springs += data[:, 4] * np.where(rebound > 0.0, np.maximum(rise, 0.0), 0.0)
    return {
        "kinetic_energy": kinetic(velocity, rates[2]),
        "elastic_energy": 0.5 * float(np.sum(springs)),
        "work": work,
        "contact_dissipation": -power,
        "numerical_dissipation": kinetic(velocity - slow, rates[2] - rates[1]),
        "damping_dissipation": kinetic(old, rates[0]) - kinetic(slow, rates[1]),
    }
