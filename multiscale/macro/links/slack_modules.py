"""Homogenised substructures with slack links: a plate of their modules, with a band."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.data_range import without_steps
from multiscale.macro.links.equivalent_plate import EquivalentPlate, solve_plate
from multiscale.macro.links.statics import solve_static
from multiscale.schema import MACRO_RESULT, Dataset

INSIDE = 2  # distance from the edge, in modules, from which modules count as inside

COVER = 0.95
"""Share of the links of the specimen that a band covers."""

LARGEST_ERROR = 0.2
"""Error of the displacement of a specimen, relative, above which the law does not hold."""

RESIDUAL = 1e-6
"""Residual of plates over their load, which is far below the error of the law."""

IMAGES = 4
"""Links of a specimen that are alike by the symmetry of a rectangle: the fewest that are wrong."""

OF_ANSWERS = ("largest_displacement_error", "largest_tension_error", "slack_links_error")
"""Half-widths of the bands of answers: two relative, and a number of links."""


def with_specimen_error(
    result: Dataset, structure: EquivalentPlate, specimen: EquivalentPlate
) -> Dataset:
    """Return the result of a plate of modules with its error, by a specimen with fewer modules.

    Parameters
    ----------
    result : Dataset, from :func:`~.solve_plate` with ``links=True``
    structure : EquivalentPlate, with an element for each substructure
    specimen : EquivalentPlate
        Has the elements of the structure, fewer modules, and a prestress smaller by the square of
        their ratio, so that as many of a hundred links are slack.

    Returns
    -------
    Dataset
        ``result`` with ``tension_error`` (N), half-width of the interval that contains 95 % of the
        links, ``largest_displacement_error`` and ``largest_tension_error``, relative, and
        ``slack_links_error``, a number of links. A step fails where the specimen does, or where it
        is off by more than :data:`LARGEST_ERROR`.

    Raises
    ------
    CaseError
        If the specimen has no fewer modules, or too few to have links at each distance from the
        edge, or groups of links are not cells of the plates.

    Examples
    --------
    >>> from multiscale.macro import tensegrity_grid
    >>> from multiscale.macro.links import EquivalentPlate, plate_cell
    >>> def plate(n):
    ...     options = {"prestress": 10.0 * n**2}
    ...     cell = plate_cell(tensegrity_grid(1, **options), (1.0, 1.0))
    ...     return EquivalentPlate(tensegrity_grid(n, **options), cell, (4, 4))
    >>> result = solve_plate(plate(16), [1.0], links=True)
    >>> result = with_specimen_error(result, plate(16), plate(8))
    >>> 0.05 < result.largest_displacement_error.item() < 0.15
    True
    """
    if len(specimen.members) >= len(structure.members):
        raise CaseError(
            f"the specimen of {len(specimen.members)} modules has no fewer than the structure with "
            f"{len(structure.members)}, so its links are not faster; solve the links, or cut the "
            f"structure into fewer substructures"
        )
    known, classes = (_classes(each) for each in (specimen, structure))
    if not np.isin(classes, known).all():
        raise CaseError(
            f"the specimen of {len(specimen.members)} modules has no links as far from the edge as "
            f"the structure; take at least {2 * INSIDE + 1} modules each way"
        )
    factors = result["load_factor"].to_numpy().tolist()
    plate = solve_plate(specimen, factors, links=True, tolerance=RESIDUAL)
    links = solve_static(specimen.system, factors)
    tension, exact = (data["tension"].to_numpy() for data in (plate, links))
    error = np.abs(tension - exact) / np.abs(exact).max(axis=1, keepdims=True)

    # error of links of the same kind, at the same distance from the edge
    band = np.zeros((len(error), classes.size))
    for alike in np.unique(classes):
        share = np.quantile(error[:, known == alike], COVER, axis=1)
        band[:, classes == alike] = share[:, None]
    pull = result["tension"].to_numpy()
    band *= np.abs(pull).max(axis=1, keepdims=True)

    # errors of answers: another link may have the largest tension
    moved, pulled, slack = _errors(plate, links)
    pulled = np.maximum(pulled, (pull + band).max(axis=1) / pull.max(axis=1) - 1.0)
    slack *= structure.system.n_links
    values = dict(zip(OF_ANSWERS, (moved, pulled, slack), strict=True))
    return _refuse_far(MACRO_RESULT.assign(result, {"tension_error": band, **values}))


def _classes(structure: EquivalentPlate) -> np.ndarray:
    """Return a number for every kind of link at every distance of its module from the edge."""
    classes = np.zeros(structure.system.n_links, dtype=int)
    ring = np.minimum(structure.ring, INSIDE)
    classes[structure.members] = len(structure.system.laws) * ring[:, None]
    return np.asarray(classes + structure.system.kind)


def _errors(plate: Dataset, links: Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Relative errors of displacements and the largest tension, and the share of wrong links."""
    u, exact = (data["displacement"].to_numpy() for data in (plate, links))
    size = np.linalg.norm(exact, axis=2).max(axis=1)
    moved = np.linalg.norm(u - exact, axis=2).max(axis=1) / np.where(size > 0.0, size, 1.0)
    pull, pulled = (data["tension"].to_numpy().max(axis=1) for data in (plate, links))
    status, slack = (data["slack"].to_numpy() > 0.0 for data in (plate, links))
    wrong = np.maximum(np.count_nonzero(status != slack, axis=1), IMAGES) / slack.shape[1]
    return moved, np.abs(pull / pulled - 1.0), wrong


def _refuse_far(result: Dataset) -> Dataset:
    """Refuse steps at which the specimen shows that the law does not hold, or has no answer."""
    solved = result["converged"].to_numpy() == 1
    error = result["largest_displacement_error"].to_numpy()
    far = solved & ~(error <= LARGEST_ERROR)
    if not far.any():
        return result
    step = int(np.argmax(far))
    why = (
        f"is off by {100.0 * error[step]:.3g} % of the largest displacement, more than "
        f"{100.0 * LARGEST_ERROR:g} %"
        if np.isfinite(error[step])
        else "has no equilibrium"
    )
    fields = ("displacement", "tension", "slack", "tension_error", *OF_ANSWERS)
    result = without_steps(result, far, fields)
    failure = (
        f"load factor {float(result['load_factor'][step]):g}: modules with slack links leave their "
        f"law, and their specimen {why}; take more substructures, or the model adaptive"
    )
    return result.assign_attrs(
        failure="\n".join(filter(None, [result.attrs.get("failure"), failure]))
    )
