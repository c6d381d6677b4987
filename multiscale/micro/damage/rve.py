r"""Effective stiffness of a voxel image with periodic, displacement or traction sides.

For each of six mean strains :math:`\bar\varepsilon` the periodic displacement :math:`u` solves

.. math:: \mathrm{div}\,\sigma = 0, \qquad \sigma = C(x) : (\bar\varepsilon + \nabla_s u),
    \qquad \bar C : \bar\varepsilon = \langle \sigma \rangle,    \tag{1}

with trilinear bricks, by conjugate gradients on the stiffness of all voxels. The preconditioner is
the inverse stiffness of a uniform material, in Fourier space, so that the number of iterations
depends on the contrast and hardly on the resolution. Voids may have no stiffness at all: the
iterates then stay in the range of the stiffness, whose spectrum the voids do not widen.

The energy is stationary at the solution. With the forces :math:`r_k` that the solve for the strain
k leaves, and the mean stress :math:`\langle\sigma\rangle_k` of its last iterate,

.. math:: V\, \bar C_{jk} = V\, \bar\varepsilon_j : \langle\sigma\rangle_k - u_j \cdot r_k
    = \int (\bar\varepsilon_j + \nabla_s u_j) : C : (\bar\varepsilon_k + \nabla_s u_k)    \tag{2}

has an error of the order of the square of the tolerance.

With displacement sides u vanishes on the boundary, which bounds the periodic stiffness from above.
With traction sides :math:`\int u \otimes n` alone vanishes on the solid part of the sides, which
bounds it from below: see :mod:`~.voxel_sides`.

References
----------
.. [1] M. Ladecký, R. J. Leute, A. Falsafi, I. Pultarová, L. Pastewka, T. Junge and J. Zeman, Appl.
   Math. Comput. 446 (2023) 127835, doi:10.1016/j.amc.2023.127835: finite elements with this
   preconditioner.
.. [2] M. Schneider, Int. J. Numer. Methods Eng. 121 (2020) 5017-5041, doi:10.1002/nme.6508: pores
   without stiffness.
"""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from multiscale.convergence import Solution, Status, check_limits, verdict
from multiscale.errors import CaseError
from multiscale.io.images import VoxelImage
from multiscale.laws.bulk.moduli import check_moduli, drop_soft_modes, lame_parameters
from multiscale.laws.bulk.moduli import youngs_modulus_along as youngs_modulus_along

if TYPE_CHECKING:
    from multiscale.micro.damage.voxel_operator import VoxelOperator

__all__ = ["SIDES", "STRAINS", "check_sides", "effective_stiffness", "summarise_loads"]

SIDES = ("traction", "periodic", "displacement")
"""Conditions on the sides of a volume, from the softest to the stiffest."""

STRAINS = ("xx", "yy", "zz", "yz", "xz", "xy")
"""Order of strains and stresses; shear strains are angles, twice the tensor components."""

LOST_STIFFNESS = 1e-7
"""Share of Young's modulus of the solid below which a stiffness of the volume counts as zero."""

PATIENCE = 100  # iterations without a smaller residual after which a solve counts as stalled


def effective_stiffness(
    image: VoxelImage,
    youngs_modulus: float,
    poissons_ratio: float,
    *,
    sides: str = "periodic",
    void_modulus: float = 0.0,
    max_iterations: int = 1000,
    tolerance: float = 1e-4,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    r"""Effective stiffness of an image with two isotropic materials.

    Parameters
    ----------
    image : VoxelImage
        The volume. Its edges may differ, and a single voxel across means plane strain.
    youngs_modulus, poissons_ratio : float, moduli of the solid, Pa and dimensionless
    sides : {"periodic", "displacement", "traction"}
        Conditions on the sides: the image continues periodically, or has sides with the linear
        displacement of the mean strain, an upper bound, or with uniform tractions on their solid
        part, a lower bound of the periodic stiffness.
    void_modulus : float
        Young's modulus of the filling of the voids, Pa, with the same Poisson's ratio.
    max_iterations : int, iteration limit for each of the six strains
    tolerance : float
        Bound on the residual in the norm of the preconditioner, relative to the first residual;
        dimensionless. The relative error of the stiffness, by (2), is about its square.
    callback : callable, optional
        Called as ``callback(iteration, residual)`` for each strain in turn.

    Returns
    -------
    Solution
        ``value`` is :math:`\bar C`, shape (6, 6), Pa, in the order of ``STRAINS``. ``residuals``
        and ``seconds`` belong to the strain with the most iterations, ``trail`` lists the
        iterations of each strain, and ``detail`` names the strains against which the stiffness is
        zero, as normal to a crack through the whole section.

    Raises
    ------
    CaseError
        If a modulus is outside its range, the sides have no such condition or too few voxels, or
        the image is no VoxelImage or holds no solid.

    Examples
    --------
    >>> laminate = VoxelImage(np.arange(8)[:, None, None] >= 6, (1.0, 1.0, 1.0))
    >>> stiffness = effective_stiffness(laminate, 200e9, 0.0).unwrap()
    >>> stiffness[2, 2] / 200e9  # along the layers: the volume fraction
    np.float64(0.75)
    """
    check_limits(tolerance, max_iterations)
    from multiscale.micro.damage.voxel_operator import VoxelOperator
    from multiscale.micro.damage.voxel_sides import HeldVoxels, traction_stiffness
    from multiscale.numerics.vectors import dot

    if not isinstance(image, VoxelImage):
        raise CaseError(
            f"effective_stiffness takes a VoxelImage, got {type(image).__name__}; turn cavities "
            f"into one by voxelise(rve, 64), or mesh them by mesh_stiffness"
        )
    check_sides(sides)
    if sides != "periodic" and min(image.void.shape) < 2:
        raise CaseError(
            f"{sides} sides need two voxels or more along every axis, got {image.void.shape}"
        )
    check_moduli(youngs_modulus, poissons_ratio)
    lame, shear = map(float, lame_parameters(1.0, poissons_ratio))  # over Young's modulus
    if not 0.0 <= void_modulus < np.inf:
        raise CaseError(f"void_modulus must not be negative (Pa), got {void_modulus:g}")
    if image.void.all() and void_modulus == 0.0:
        raise CaseError("the image holds no solid; check which voxels are void")
    # in units of the solid's modulus and the longest edge, so that no unit is special
    modulus = np.where(image.void, void_modulus / youngs_modulus, 1.0)
    edges = np.array(image.spacing) / max(image.spacing)

    def solve(operator: "VoxelOperator", load: np.ndarray) -> tuple[Solution, np.ndarray]:
        return _solve(operator, load, max_iterations, tolerance, callback)

    if sides == "traction":
        stiffness, loads = traction_stiffness(modulus, lame, shear, edges, solve)
    else:
        kind = VoxelOperator if sides == "periodic" else HeldVoxels
        operator = kind(lame * modulus, shear * modulus, edges)
        volume = float(np.prod(edges)) * image.void.size
        stiffness = np.empty((6, 6))
        loads, motions = [], list[np.ndarray]()
        for k in range(6):
            strain = np.eye(6)[k]
            nothing = np.zeros((3, *modulus.shape))
            load, r = solve(operator, -operator.forces(nothing, strain))
            stress = operator.mean_stress(load.value, strain)
            motions.append(load.value.astype(np.float32))
            for j, u in enumerate(motions):  # (2)
                stiffness[j, k] = stiffness[k, j] = stress[j] - dot(r, u) / volume
            loads.append(replace(load, value=stress))
    # a stiffness below the error of (2) cannot be told from zero
    lost = max(LOST_STIFFNESS, 10.0 * tolerance**2) if void_modulus == 0.0 else 0.0
    return summarise_loads(youngs_modulus * stiffness, loads, lost * youngs_modulus)


def check_sides(sides: str) -> None:
    """Refuse sides that there are not."""
    if sides not in SIDES:
        raise CaseError(f"there are no sides {sides!r}; choose from {', '.join(SIDES)}")


def _solve(
    operator: "VoxelOperator",
    load: np.ndarray,
    max_iterations: int,
    tolerance: float,
    callback: Callable[[int, float], None] | None,
) -> tuple[Solution, np.ndarray]:
    """Preconditioned conjugate gradients for nodal forces: u and the forces left.

    Any fixed positive definite preconditioner will do, so that single precision is enough for it;
    all sums are in double precision.
    """
    from multiscale.micro.damage.voxel_operator import update_iterate
    from multiscale.numerics.vectors import dot, turn

    begin = perf_counter()
    u, r = np.zeros(load.shape), load.copy()
    size = float(np.abs(r).max())
    floor = 1e-13 * float(np.max(operator.lame + operator.shear) * np.prod(operator.edges))
    if size <= floor / operator.edges.min():  # uniform along the strain: nothing to solve
        return Solution(u, Status.CONVERGED, (0.0,), (perf_counter() - begin,)), r
    rough = r.astype(np.float32)
    z = operator.precondition(rough)
    p = z.astype(float)
    power = first = dot(r, z)
    residuals, seconds = [1.0], [perf_counter() - begin]
    status = Status.MAX_ITERATIONS
    for iteration in range(1, max_iterations + 1):
        q = operator.forces(p)
        curvature = dot(p, q)
        if not curvature > 0.0:
            status = Status.STALLED if np.isfinite(curvature) else Status.NOT_FINITE
            break
        update_iterate(power / curvature, p, q, u, r, rough)
        z = operator.precondition(rough)
        previous, power = power, dot(r, z)
        residuals.append(float(np.sqrt(max(power, 0.0) / first)))
        seconds.append(perf_counter() - begin)
        if callback is not None:
            callback(iteration, residuals[-1])
        if reason := verdict(residuals, tolerance, PATIENCE):
            status = reason
            break
        turn(power / previous, p.ravel(), z.ravel())
    return Solution(u, status, tuple(residuals), tuple(seconds)), r


def summarise_loads(stiffness: np.ndarray, loads: list[Solution], lost: float) -> Solution:
    """Combine the solves of six strains in one solution, with the status of the worst solve.

    Modes of strain with less stiffness than ``lost``, Pa, count as free, and the value, Pa, is
    without.
    """
    slowest = max(loads, key=lambda load: len(load.residuals))
    failed = [load for load in loads if not load.converged]
    worst = failed[0] if failed else slowest
    loose = [STRAINS[k] for k in range(6) if stiffness[k, k] < lost]
    detail = (
        f"no stiffness against the strains {', '.join(loose)}: the solid is cut through, D = 1"
        if loose
        else ""
    )
    trail = tuple(
        f"strain {name}: {len(load.residuals) - 1} iterations"
        for name, load in zip(STRAINS, loads, strict=True)
    )
    value = drop_soft_modes(stiffness, lost)
    return Solution(value, worst.status, worst.residuals, worst.seconds, trail, detail)
