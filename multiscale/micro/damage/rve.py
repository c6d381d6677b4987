r"""Stiffness and damage of representative volumes, images of voxels, and of the material.

For each of six mean strains :math:`\bar\varepsilon`, conjugate gradients with the inverse stiffness
of a uniform material in Fourier space as preconditioner [1]_, and voids without stiffness [2]_,
solve for the periodic displacement u,

.. math:: \mathrm{div}\,\sigma = 0, \qquad \sigma = C(x) : (\bar\varepsilon + \nabla_s u),
    \qquad \bar C : \bar\varepsilon = \langle \sigma \rangle;    \tag{1}

with the residual forces :math:`r_k` of strain k the error is of the order of the tolerance squared:

.. math:: V\, \bar C_{jk} = V\, \bar\varepsilon_j : \langle\sigma\rangle_k - u_j \cdot r_k
    = \int (\bar\varepsilon_j + \nabla_s u_j) : C : (\bar\varepsilon_k + \nabla_s u_k).    \tag{2}

.. [1] M. Ladecký, R. J. Leute, A. Falsafi, I. Pultarová, L. Pastewka, T. Junge and J. Zeman, Appl.
   Math. Comput. 446 (2023) 127835, doi:10.1016/j.amc.2023.127835.
.. [2] M. Schneider, Int. J. Numer. Methods Eng. 121 (2020) 5017-5041, doi:10.1002/nme.6508.
"""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.convergence import Solution, Status, check_limits, verdict
from multiscale.errors import CaseError, ConvergenceError, require
from multiscale.io.images import VoxelImage as VoxelImage
from multiscale.laws.bulk.bulk_law import (
    check_moduli,
    drop_soft_modes,
    lame_parameters,
)
from multiscale.laws.bulk.bulk_law import youngs_modulus_along as youngs_modulus_along
from multiscale.micro.damage.sections import Volume, max_damage, section_normals
from multiscale.schema import RVE, RVE_VOLUMES, Dataset

if TYPE_CHECKING:
    from multiscale.micro.damage.voxels import VoxelOperator

SIDES = ("traction", "periodic", "displacement")
"""Conditions on the sides of a volume, from the softest to the stiffest."""

STRAINS = ("xx", "yy", "zz", "yz", "xz", "xy")
"""Order of strains and stresses; shear strains are angles, twice the tensor components."""

LOST_STIFFNESS = 1e-7
"""Share of Young's modulus of the solid below which a stiffness of the volume counts as zero."""

PATIENCE = 100  # iterations without a smaller residual after which a solve counts as stalled

ERRORS = ("sampling", "sides", "elements")
"""Causes of the error of the mean stiffness: few volumes, their size, and the elements."""

TAIL = 0.025  # share of sections below, and above, the reported range of damage
APART = 0.5  # largest edge of boxes at the corners of a volume that do not overlap, over its edge

PERIODIC = SIDES.index("periodic")


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
        area, a lower bound of the periodic stiffness.
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
        iterations of each strain, and ``detail`` names the strains with zero stiffness, such as
        normal to a crack through the whole section.

    Examples
    --------
    >>> laminate = VoxelImage(np.arange(8)[:, None, None] >= 6, (1.0, 1.0, 1.0))
    >>> stiffness = effective_stiffness(laminate, 200e9, 0.0).unwrap()
    >>> stiffness[2, 2] / 200e9  # along the layers: the volume fraction
    np.float64(0.75)
    """
    check_limits(tolerance, max_iterations)
    from multiscale.micro.damage.voxels import (
        FixedVoxels,
        VoxelOperator,
        traction_stiffness,
    )
    from multiscale.numerics.vectors import dot

    if not isinstance(image, VoxelImage):
        raise CaseError(
            f"effective_stiffness takes a VoxelImage, got {type(image).__name__}; convert cavities "
            f"by voxelise(rve, 64)"
        )
    if sides not in SIDES:
        raise CaseError(f"there are no sides {sides!r}; choose from {', '.join(SIDES)}")
    if sides != "periodic" and min(image.void.shape) < 2:
        raise CaseError(
            f"{sides} sides need two voxels or more along every axis, got {image.void.shape}"
        )
    check_moduli(youngs_modulus, poissons_ratio)
    lame, shear = map(float, lame_parameters(1.0, poissons_ratio))  # over Young's modulus
    require("void_modulus", void_modulus, "[0, inf)", "Pa")
    if image.void.all() and void_modulus == 0.0:
        raise CaseError("the image contains no solid; check which voxels are void")
    # lengths and moduli relative to the longest edge and the modulus of the solid
    modulus = np.where(image.void, void_modulus / youngs_modulus, 1.0)
    edges = np.array(image.spacing) / max(image.spacing)

    def solve(operator: "VoxelOperator", load: np.ndarray) -> tuple[Solution, np.ndarray]:
        return _solve(operator, load, max_iterations, tolerance, callback)

    if sides == "traction":
        stiffness, loads = traction_stiffness(modulus, lame, shear, edges, solve)
    else:
        kind = VoxelOperator if sides == "periodic" else FixedVoxels
        operator = kind(lame * modulus, shear * modulus, edges)
        volume = float(np.prod(edges)) * image.void.size
        stiffness = np.empty((6, 6))
        loads, motions = [], list[np.ndarray]()
        for k in range(6):
            strain = np.eye(6)[k]
            rest = np.zeros((3, *modulus.shape))
            load, r = solve(operator, -operator.forces(rest, strain))
            stress = operator.mean_stress(load.value, strain)
            motions.append(load.value.astype(np.float32))
            for j, u in enumerate(motions):  # (2)
                stiffness[j, k] = stiffness[k, j] = stress[j] - dot(r, u) / volume
            loads.append(replace(load, value=stress))
    # a stiffness below the error of (2) counts as zero
    lost = max(LOST_STIFFNESS, 10.0 * tolerance**2) if void_modulus == 0.0 else 0.0
    return _summarise_loads(youngs_modulus * stiffness, loads, lost * youngs_modulus)


def _solve(
    operator: "VoxelOperator",
    load: np.ndarray,
    max_iterations: int,
    tolerance: float,
    callback: Callable[[int, float], None] | None,
) -> tuple[Solution, np.ndarray]:
    """Solve for nodal forces by conjugate gradients: u and the residual forces."""
    from multiscale.numerics.vectors import advance, dot, turn

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
        advance(power / curvature, *(field.ravel() for field in (p, u, q, r)))
        rough[...] = r
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


def _summarise_loads(stiffness: np.ndarray, loads: list[Solution], lost: float) -> Solution:
    """Combine the solves of six strains, with the worst status; stiffness below ``lost`` is 0."""
    slowest = max(loads, key=lambda load: len(load.residuals))
    failed = [load for load in loads if not load.converged]
    worst = failed[0] if failed else slowest
    soft = [STRAINS[k] for k in range(6) if stiffness[k, k] < lost]
    detail = (
        f"zero stiffness for the strains {', '.join(soft)}: the solid is cut through, D = 1"
        if soft
        else ""
    )
    trail = tuple(
        f"strain {name}: {len(load.residuals) - 1} iterations"
        for name, load in zip(STRAINS, loads, strict=True)
    )
    value = drop_soft_modes(stiffness, lost)
    return Solution(value, worst.status, worst.residuals, worst.seconds, trail, detail)


def measure_volume(
    rve: Volume,
    youngs_modulus: float,
    poissons_ratio: float,
    *,
    voxels: int,
    level: int = 2,
    sections: int = 33,
    slab: float = 0.0,
    share: float = 1.0,
) -> Dataset:
    """Compute damage of sections and stiffness of a volume, with all kinds of sides."""
    # stiffness with each kind of sides, and with voxels twice as large
    image = rve.image(voxels)
    stiffness, ended = np.full((len(SIDES), 6, 6), np.nan), []
    coarse = np.full((6, 6), np.nan)
    for k, sides in enumerate(SIDES):
        try:
            solution = effective_stiffness(image, youngs_modulus, poissons_ratio, sides=sides)
            if solution.detail:
                ended.append(f"{sides} sides: {solution.detail}")
            stiffness[k] = solution.unwrap()
        except ConvergenceError as error:
            ended.append(f"{sides} sides: {error}")
    halved = image.coarser()
    if halved is not None and share == 1.0:
        try:
            coarse = effective_stiffness(halved, youngs_modulus, poissons_ratio).unwrap()
        except ConvergenceError as error:
            ended.append(f"voxels twice as large: {error}")
    # damage of sections
    planes = max_damage(rve, level=level, sections=sections, slab=slab, refine=False)
    damage = planes["damage"]
    values = {
        "share": [share],
        "porosity": [image.porosity],
        "largest_damage": damage.max("section").to_numpy()[None],
        "mean_damage": damage.mean("section").to_numpy()[None],
        "low_damage": damage.quantile(TAIL, "section").to_numpy()[None],
        "high_damage": damage.quantile(1.0 - TAIL, "section").to_numpy()[None],
        "apparent_stiffness": stiffness[None],
        "coarse_stiffness": coarse[None],
    }
    dataset = RVE_VOLUMES.build(values)
    return dataset.assign_attrs(ended="; ".join(ended)) if ended else dataset


def represent(
    volumes: Dataset,
    image: VoxelImage,
    youngs_modulus: float,
    poissons_ratio: float,
    *,
    level: int,
) -> Dataset:
    """Average volumes to a representation of the material, with the errors of the mean."""
    # Young's modulus of each volume along the normals
    normals = section_normals(image.size, level)
    C = volumes["apparent_stiffness"].to_numpy()
    E = np.full((*C.shape[:2], len(normals)), np.nan)
    for place in np.ndindex(C.shape[:2]):
        if np.isfinite(C[place]).all():
            E[place] = youngs_modulus_along(C[place], normals)
    share = volumes["share"].to_numpy()
    whole = (share == 1.0) & np.isfinite(E[:, PERIODIC]).all(axis=1)
    if not whole.any():
        raise ConvergenceError(
            f"no volume has a stiffness: {volumes.attrs.get('ended', 'no solve converged')}; take "
            f"fewer cracks or pores, or more voxels"
        )
    # mean stiffness, and its errors by sampling, sides and elements
    mean = C[whole, PERIODIC].mean(axis=0)
    modulus = youngs_modulus_along(mean, normals)
    safe = np.where(modulus > 0.0, modulus, np.nan)
    scatter, spread, students = _scatter(E[:, PERIODIC], share, whole)
    count = int(whole.sum())
    sides = E[whole].mean(axis=0)
    coarse = volumes["coarse_stiffness"].to_numpy()[whole]
    solved = np.isfinite(coarse).all(axis=(1, 2))
    elements = np.full(len(normals), np.nan)
    if solved.any():
        finer = C[whole, PERIODIC][solved]
        change = [
            youngs_modulus_along(a, normals) - youngs_modulus_along(b, normals)
            for a, b in zip(coarse[solved], finer, strict=True)
        ]
        elements = np.abs(np.mean(change, axis=0)) / safe
    errors = np.stack(
        [
            students * scatter / np.sqrt(count),
            np.maximum(sides[2] - sides[1], sides[1] - sides[0]) / safe,
            elements,
        ]
    )
    total = np.sqrt((errors**2).sum(axis=0))
    # largest damage, with the interval of its mean and its prediction interval
    largest = volumes["largest_damage"].to_numpy()
    damage = largest[whole].mean(axis=0)
    damage_scatter, _, factor = _scatter(largest, share, whole)
    half = factor * damage_scatter * damage
    values: dict[str, Any] = {name: volumes[name].to_numpy() for name in RVE_VOLUMES.variables}
    values |= {
        "normal": normals,
        "box_size": np.array(image.size),
        "apparent_modulus": E,
        "stiffness": mean,
        "modulus": modulus,
        "modulus_mean_law": _interval(modulus, modulus * total),
        "modulus_one_part": _interval(modulus, modulus * np.hypot(total, students * scatter)),
        "modulus_error": errors,
        "scatter": scatter,
        "damage": damage,
        "damage_mean_law": np.clip(_interval(damage, half / np.sqrt(count)), 0.0, 1.0),
        "damage_one_part": np.clip(_interval(damage, half * np.sqrt(1.0 + 1.0 / count)), 0.0, 1.0),
        "void": image.void.astype(np.int8),
        "sides": list(SIDES),
        "strain": list(STRAINS),
        "other_strain": list(STRAINS),
        "rve_error": list(ERRORS),
    }
    return RVE.build(
        values, youngs_modulus=youngs_modulus, poissons_ratio=poissons_ratio, spread=spread
    )


def _scatter(
    values: np.ndarray, share: np.ndarray, whole: np.ndarray
) -> tuple[np.ndarray, str, float]:
    """Relative standard deviation between volumes, its source, and Student's factor."""
    from scipy.special import stdtrit

    if whole.sum() > 1:
        sample, scale, source = values[whole], 1.0, "the volumes"
    else:
        shares = [k for k in np.unique(share[share <= APART]) if (share == k).sum() > 2]
        if not shares:
            return np.full(values.shape[1], np.nan), "", np.nan
        sample, scale = values[share == shares[-1]], float(shares[-1]) ** 1.5
        source = f"boxes of {shares[-1]:g} of the edge, by the law of large numbers"
    sample = sample[np.isfinite(sample).all(axis=1)]
    mean = sample.mean(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        scatter = scale * sample.std(axis=0, ddof=1) / mean
    return scatter, source, float(stdtrit(max(1, len(sample) - 1), 1.0 - TAIL))


def _interval(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    return np.stack([value - half, value + half])
