"""Path of a cell that is pressed, sheared until all of it slips, and sheared back."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.cell import FiniteCell
from multiscale.micro.path import Path
from multiscale.surfaces.statistics import rms_height

__all__ = ["shear_path"]

DECAY = 0.4  # p / K over the rms height of a self-affine surface at light load


def shear_path(
    cell: FiniteCell,
    pressures: Sequence[float],
    *,
    along: Literal["x", "y", "xy"] = "xy",
    reach: float = 8.0,
    steps: int = 10,
    legs: int = 1,
    cycle: float = 0.0,
    pressing_steps: int = 1,
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
    reach : float
        Largest slip of the interface, relative to the slip :math:`u_*` below; 8 is full slip.
    steps : int, number of steps of a leg; the first ones are short
    legs : int
        How often the cell is sheared: there, back, there again and so on, between the slips
        plus and minus ``reach``.
    cycle : float
        Amplitude of a closed cycle on the way of the first leg, relative to :math:`u_*`, at the
        step that is nearest: it tells what the cell loses. None if zero.
    pressing_steps : int
        Steps in which a pressure is reached. They matter between unlike bodies, which slip as they
        are pressed.
    pressed : sequence of float
        Mean pressures through which the cell is pressed and then released at first, Pa, rising: it
        then tells its own normal law, on the grid on which it is sheared.

    Returns
    -------
    Path
        After each leg the cell is released: pressure and slide zero. An elastic cell then forgets
        its path.

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
    if not reach > 0.0 or min(steps, legs, pressing_steps) < 1:
        raise CaseError(
            f"a shear needs a positive reach and at least 1 step, 1 leg and 1 pressing step, got "
            f"{reach:g}, {steps}, {legs} and {pressing_steps}"
        )
    if not 0.0 <= cycle < reach:
        raise CaseError(
            f"a cycle lies on the way of the first leg, with an amplitude from 0 to less than "
            f"{reach:g}, got {cycle:g}"
        )
    heights = [rms_height(body.surface) for body in cell.bodies]
    heights += [] if cell.second or cell.obstacle is None else [rms_height(cell.obstacle)]
    nu = float(np.mean(cell.law.poissons_ratio))
    kappa = 2.0 * (1.0 - nu) / (2.0 - nu)
    scale = mu * DECAY * float(np.linalg.norm(heights)) / kappa
    if not scale > 0.0:
        raise CaseError("the surfaces are flat, so that nothing slips before all of it does")
    compliance = sum(np.sum(np.diff(body.planes) / body.layer_moduli[1]) for body in cell.bodies)
    rise = (np.arange(1, steps + 1) / steps) ** 2  # share of the way of a leg

    turn = int(np.argmin(np.abs(reach * rise - cycle)))  # the step at which a cycle begins

    pressure: list[float] = [*pressed, 0.0] if pressed else []
    slide: list[tuple[float, float]] = [(0.0, 0.0)] * len(pressure)
    for p in pressures:
        force, slip = mu * p * -np.expm1(-reach * rise), reach * scale * rise  # (1)
        back = 2.0 * mu * p * -np.expm1(-reach * rise)  # Masing: twice the way at twice the slip
        first = slip + force * compliance
        again = first[-1] - (2.0 * slip + back * compliance)
        ways = [first, *((-1.0) ** leg * again for leg in range(legs - 1))]
        if cycle:
            middle = 2.0 * mu * p * -np.expm1(-0.5 * slip[turn] / scale) * compliance
            middle = first[turn] - slip[turn] - middle  # where the slip is zero on the way back
            there = [middle, -first[turn], -middle, first[turn]]
            ways[0] = np.concatenate([first[: turn + 1], there, first[turn + 1 :]])
        for axis in along:
            pressure += [*(p * np.arange(1, pressing_steps + 1) / pressing_steps)]
            way = np.concatenate([np.zeros(pressing_steps), *ways, [0.0]])
            pressure += [p] * (len(way) - pressing_steps - 1) + [0.0]
            slide += [(float(s), 0.0) if axis == "x" else (0.0, float(s)) for s in way]
    return Path(pressure=tuple(pressure), slide=tuple(slide))
