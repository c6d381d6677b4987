"""Path of a cell that is pressed, sheared until all of it slips, and sheared back."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.cell import FiniteCell
from multiscale.micro.path import Path
from multiscale.surfaces.statistics import rms_height

__all__ = ["shear_path"]

REACH = 8.0
"""Largest slip of the interface, relative to that over which a joint gives way: full slip."""

DECAY = 0.4  # p / K over the rms height of a self-affine surface at light load


def shear_path(
    cell: FiniteCell,
    pressures: Sequence[float],
    *,
    along: Literal["x", "y", "xy"] = "xy",
    steps: int = 10,
    cycle: float = 0.0,
    pressed: Sequence[float] = (),
) -> Path:
    r"""Press, shear and release a cell at each of several pressures and in each direction.

    Parameters
    ----------
    cell : FiniteCell
        With friction; two deformable bodies, as a rigid obstacle couples pressing and shear. Tells
        the lengths of the path, which serves all realisations.
    pressures : sequence of float, mean pressures that are held, Pa
    along : {"x", "y", "xy"}, directions of the shear
    steps : int, number of steps to full slip; the first ones are short
    cycle : float
        Amplitude of a closed cycle on the way, relative to the slip :math:`u_*` below, at the step
        that is nearest: it tells what the cell loses. None if zero.
    pressed : sequence of float
        Mean pressures through which the cell is pressed and then released at first, Pa, rising: it
        then tells its own normal law, on the grid on which it is sheared.

    Returns
    -------
    Path
        Sheared to :data:`REACH`, the cell is released: pressure and slide zero. An elastic cell
        then forgets its path.

    Raises
    ------
    CaseError
        If the cell has no friction, or a number makes no sense.

    Notes
    -----
    The bodies move by the slip :math:`u` of the interface and by their own shear. For an interface
    whose pressure is :math:`e`-fold over the length :math:`\lambda \approx 0.4\, h_\mathrm{rms}`,

    .. math::
        s(u) = u + f(u) \sum_k D_k / G_k, \qquad f = \mu p\, (1 - e^{-u / u_*}), \qquad
        u_* = \mu \lambda / \kappa,    \tag{1}

    with the depths :math:`D` and shear moduli :math:`G` of the bodies and
    :math:`\kappa = 2(1-\nu)/(2-\nu)`; Masing's rule gives the way back. What the cell makes of it
    is measured, so that (1) need not be exact.
    """
    mu = cell.friction_coefficient
    if not mu > 0.0:
        raise CaseError("a cell without friction cannot be sheared; give a friction_coefficient")
    if not pressures or not all(0.0 < one < np.inf for one in pressures):
        raise CaseError(f"a cell is sheared under positive pressures (Pa), got {pressures}")
    if not all(0.0 < one < np.inf for one in pressed):
        raise CaseError(f"a cell is pressed by positive pressures (Pa), got {pressed}")
    if along not in ("x", "y", "xy"):
        raise CaseError(f"a cell is sheared along 'x', 'y' or 'xy', got {along!r}")
    if steps < 1:
        raise CaseError(f"a shear needs at least 1 step, got {steps}")
    if not 0.0 <= cycle < REACH:
        raise CaseError(
            f"a cycle lies on the way to full slip, with an amplitude from 0 to less than "
            f"{REACH:g}, got {cycle:g}"
        )
    heights = [rms_height(body.surface) for body in cell.bodies]
    heights += [] if cell.second or cell.obstacle is None else [rms_height(cell.obstacle)]
    nu = float(np.mean(cell.law.poissons_ratio))
    kappa = 2.0 * (1.0 - nu) / (2.0 - nu)
    scale = mu * DECAY * float(np.linalg.norm(heights)) / kappa
    if not scale > 0.0:
        raise CaseError("the surfaces are flat, so that nothing slips before all of it does")
    compliance = sum(np.sum(np.diff(body.planes) / body.layer_moduli[1]) for body in cell.bodies)
    rise = (np.arange(1, steps + 1) / steps) ** 2  # share of the way

    turn = int(np.argmin(np.abs(REACH * rise - cycle)))  # the step at which a cycle begins

    pressure: list[float] = [*pressed, 0.0] if pressed else []
    slide: list[tuple[float, float]] = [(0.0, 0.0)] * len(pressure)
    for p in pressures:
        force, slip = mu * p * -np.expm1(-REACH * rise), REACH * scale * rise  # (1)
        way = slip + force * compliance
        if cycle:  # Masing: twice the way at twice the slip
            middle = 2.0 * mu * p * -np.expm1(-0.5 * slip[turn] / scale) * compliance
            middle = way[turn] - slip[turn] - middle  # where the slip is zero on the way back
            there = [middle, -way[turn], -middle, way[turn]]
            way = np.concatenate([way[: turn + 1], there, way[turn + 1 :]])
        way = np.concatenate([[0.0], way, [0.0]])
        for axis in along:
            pressure += [p] * (len(way) - 1) + [0.0]
            slide += [(float(s), 0.0) if axis == "x" else (0.0, float(s)) for s in way]
    return Path(pressure=tuple(pressure), slide=tuple(slide))
