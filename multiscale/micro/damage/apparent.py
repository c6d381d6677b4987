"""Damage and apparent stiffness of one volume, and of the material from many volumes."""

from typing import Any

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.io.images import VoxelImage
from multiscale.laws.bulk.moduli import youngs_modulus_along
from multiscale.micro.damage.cavities import Cavities, voxelise
from multiscale.micro.damage.rve import SIDES, STRAINS, effective_stiffness
from multiscale.micro.damage.sections import max_damage, section_normals
from multiscale.schema import RVE, RVE_VOLUMES, Dataset

__all__ = ["ERRORS", "measure_volume", "represent"]

ERRORS = ("sampling", "sides", "elements")
"""Causes of the error of the mean stiffness: few volumes, their size, and the elements."""

TAIL = 0.025
"""Share of sections below, and above, the range of damage that is kept."""

APART = 0.5
"""Edge of parts at the corners of a volume up to which they do not overlap, over its edge."""

PERIODIC = SIDES.index("periodic")


def measure_volume(
    rve: Cavities | VoxelImage,
    youngs_modulus: float,
    poissons_ratio: float,
    *,
    voxels: int,
    element_size: float | None = None,
    level: int = 2,
    sections: int = 33,
    slab: float = 0.0,
    share: float = 1.0,
) -> Dataset:
    """Measure sections and stiffness of one volume, with all kinds of sides."""
    image = voxelise(rve, voxels) if isinstance(rve, Cavities) else rve
    stiffness, ended = np.full((len(SIDES), 6, 6), np.nan), []
    coarse = np.full((6, 6), np.nan)

    def solve(sides: str, *, halved: bool) -> np.ndarray:
        if element_size is not None and isinstance(rve, Cavities):
            size = (1.0 + halved) * element_size
            from multiscale.micro.damage.meshed_volume import mesh_stiffness

            solution = mesh_stiffness(
                rve, youngs_modulus, poissons_ratio, element_size=size, sides=sides
            )
        else:
            one = image.coarsened() if halved else image
            solution = effective_stiffness(one, youngs_modulus, poissons_ratio, sides=sides)
        if solution.detail and not halved:
            ended.append(f"{sides} sides: {solution.detail}")
        return np.asarray(solution.unwrap())

    for k, sides in enumerate(SIDES):
        try:
            stiffness[k] = solve(sides, halved=False)
        except ConvergenceError as error:
            ended.append(f"{sides} sides: {error}")
    if min(image.void.shape) > 1 and share == 1.0:
        try:
            coarse = solve("periodic", halved=True)
        except ConvergenceError as error:
            ended.append(f"elements twice as large: {error}")
    found = max_damage(rve, level=level, sections=sections, slab=slab, refine=False)
    damage = found["damage"]
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
    r"""Average volumes, and say how well they represent their material."""
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
            f"fewer cracks or pores, or smaller elements"
        )
    mean = C[whole, PERIODIC].mean(axis=0)
    modulus = youngs_modulus_along(mean, normals)
    safe = np.where(modulus > 0.0, modulus, np.nan)
    scatter, spread, students = _scatter(E[:, PERIODIC], share, whole)
    count = int(whole.sum())
    sides = E[whole].mean(axis=0)
    coarse = volumes["coarse_stiffness"].to_numpy()[whole]
    known = np.isfinite(coarse).all(axis=(1, 2))
    elements = np.full(len(normals), np.nan)
    if known.any():
        finer = C[whole, PERIODIC][known]
        change = [
            youngs_modulus_along(a, normals) - youngs_modulus_along(b, normals)
            for a, b in zip(coarse[known], finer, strict=True)
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
    largest = volumes["largest_damage"].to_numpy()
    damage = largest[whole].mean(axis=0)
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
        "damage_mean_law": np.clip(
            _interval(damage, _spread(largest, share, whole, 1.0 / count)), 0.0, 1.0
        ),
        "damage_one_part": np.clip(
            _interval(damage, _spread(largest, share, whole, 1.0 + 1.0 / count)), 0.0, 1.0
        ),
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
    """Relative standard deviation between volumes, how it is known, and Student's factor."""
    from scipy.special import stdtrit

    if whole.sum() > 1:
        found, scale, told = values[whole], 1.0, "the volumes"
    else:
        parts = [k for k in np.unique(share[share <= APART]) if (share == k).sum() > 2]
        if not parts:
            return np.full(values.shape[1], np.nan), "", np.nan
        found, scale = values[share == parts[-1]], float(parts[-1]) ** 1.5
        told = f"parts of {parts[-1]:g} of the edge, by the law of large numbers"
    found = found[np.isfinite(found).all(axis=1)]
    mean = found.mean(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        scatter = scale * found.std(axis=0, ddof=1) / mean
    return scatter, told, float(stdtrit(max(1, len(found) - 1), 1.0 - TAIL))


def _spread(values: np.ndarray, share: np.ndarray, whole: np.ndarray, count: float) -> np.ndarray:
    """Half-width of the interval of damage, for a variance of some volumes."""
    scatter, _, students = _scatter(values, share, whole)
    return np.asarray(students * scatter * values[whole].mean(axis=0) * np.sqrt(count))


def _interval(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    return np.stack([value - half, value + half])
