"""Averages of a granulate: coordination number, and what its walls bear."""

import numpy as np

from multiscale.macro.granulate.model import Model
from multiscale.schema import GRANULATE, Dataset

__all__ = [
    "coordination",
    "network",
    "with_plate_stress",
    "with_run_out",
    "with_weight_shares",
]


def network(result: Dataset, frame: int = -1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ends, forces (N) and branches (m) of the contacts of a frame.

    Parameters
    ----------
    result : Dataset, result of a simulation; follows ``GRANULATE``
    frame : int, number of the frame, counted from the end if negative

    Returns
    -------
    ends, force, branch : ndarray, shapes (contacts, 2), (contacts, 3) and (contacts, 3)
        The force acts on the first end.
    """
    frame = range(result.sizes["frame"])[frame]
    here = result["contact_frame"].values == frame
    ends, force, branch = (
        result[name].values[here] for name in ("contact_ends", "contact_force", "branch")
    )
    return ends, force, branch


def coordination(ends: np.ndarray, n_grains: int, *, rattlers_below: int = 4) -> tuple[float, int]:
    """Return the mean number of contacts of grains that bear load, and the number of rattlers.

    Parameters
    ----------
    ends : ndarray, shape (contacts, 2), bodies in contact; walls from ``n_grains`` on
    n_grains : int
    rattlers_below : int
        A grain with fewer contacts is a rattler: 4 for spheres and 3 for discs without friction, 2
        with friction. Rattlers are removed with their contacts until none is left.

    Returns
    -------
    coordination : float
        Contacts per grain that is no rattler; zero if all grains are rattlers. A contact of two
        grains counts for both.
    rattlers : int

    Examples
    --------
    Three grains in a ring, and one that touches the ring once:

    >>> coordination(np.array([[0, 1], [1, 2], [2, 0], [3, 0]]), 4, rattlers_below=2)
    (2.0, 1)
    """
    held = np.ones(n_grains, dtype=bool)
    while True:
        alive = np.append(held, True)[np.minimum(ends, n_grains)].all(axis=1)
        grains = ends[alive].ravel()
        count = np.bincount(grains[grains < n_grains], minlength=n_grains)
        loose = held & (count < rattlers_below)
        if not loose.any():
            break
        held &= ~loose
    number = int(held.sum())
    return (float(count[held].sum()) / number if number else 0.0), n_grains - number


def with_weight_shares(result: Dataset, floor: int) -> Dataset:
    """Return a result with the shares of the weight that the side walls and the floor bear.

    Parameters
    ----------
    result : Dataset, follows ``GRANULATE``; grains under their weight
    floor : int, number of the wall that is the floor; the others are sides
    """
    weight = -Model.gravity[2] * float(result["mass"].sum())
    borne = -result["wall_force"].to_numpy()[..., 2] / weight
    sides = np.delete(borne, floor, axis=1).sum(axis=1)
    return GRANULATE.assign(result, {"side_share": sides, "floor_share": borne[:, floor]})


def with_run_out(result: Dataset, gate: float) -> Dataset:
    """Return a result with the distance of the farthest grain beyond a gate at x, m, by frame."""
    edge = (result["position"].to_numpy()[..., 0] + result["radius"].to_numpy()).max(axis=1)
    return GRANULATE.assign(result, {"run_out": edge - gate})


def with_plate_stress(result: Dataset, plate: int, area: float, speed: float) -> Dataset:
    """Return a result with shear stress and pressure on the upper plate, and its slip.

    Parameters
    ----------
    result : Dataset, follows ``GRANULATE``
    plate : int, number of the wall, which moves along x
    area, speed : float, of the plate, m2 and m/s
    """
    force = result["wall_force"].to_numpy()[:, plate]
    values = {
        "plate_shear": -force[:, 0] / area,
        "plate_pressure": force[:, 2] / area,
        "plate_slip": speed * result["time"].to_numpy(),
    }
    return GRANULATE.assign(result, values)
