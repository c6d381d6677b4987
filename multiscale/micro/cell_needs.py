"""Components that solving a cell may need, and why each is built or left out."""

from collections.abc import Mapping

from multiscale.needs import Choice

AVERAGES = "averages the change of volume over an element, which is too stiff otherwise ({})"

NO_ELEMENTS = "Poisson's ratio below 0.4, or no elements"

COMPONENTS = {  # in the order of the text: why a component is built, and why it is left out
    "stiffness": (
        "applied element by element, without a matrix",
        "it changes with the strain, which the tangent follows",
    ),
    "tangent": (
        "stiffness of the elements as they are strained, in single precision",
        "the material is linear elastic: its stiffness does not change",
    ),
    "friction": (
        "three unknowns at a contact node: one normal, two tangential",
        "without friction a contact node has only its normal unknown",
    ),
    "factors": (
        "the stiffness is factorised once: the cell is small",
        "the stiffness is applied, or too large for its factors",
    ),
    "multigrid": (
        "the stiffness is too large for factors; coarse spaces hold the rigid motions",
        "the stiffness has factors, or another inverse speeds up the iteration",
    ),
    "opposite body": ("a second deformable body", "the counterface is rigid"),
    "layer factors": (
        "the solution of the same cell with a flat face, which speeds up the iteration",
        "a flat cell has a closed form for each wavelength of the surface",
    ),
    "mean dilatation": (AVERAGES.format("B-bar"), NO_ELEMENTS),
    "tilt": ("speeds up the iteration where Poisson's ratio is near 0.5", NO_ELEMENTS),
    "obstacle normals": (
        "directions of contact: the counterface is rough or moves",
        "contact acts along z only",
    ),
    "element moduli": (
        "moduli that differ from element to element",
        "moduli vary at most from layer to layer",
    ),
    "stress recovery": (
        "means of the stress in the body, in addition to means of the contact forces",
        "the stress is not asked for, or the material is not linear",
    ),
    "hardness cap": (
        "local pressure stays below the hardness",
        "no hardness is given, or the law of the metal has its yield stress",
    ),
    "coating": (
        "layers of other materials at the top of a body",
        "every body has a single material, or is graded by its law",
    ),
    "slope expansion": (
        "compliance to first order in the slopes: six transforms instead of two",
        "the mesh follows the surface, however steep",
    ),
}


def cell_choices(
    built: Mapping[str, bool | str], omitted: Mapping[str, str] = {}
) -> tuple[Choice, ...]:
    """Return the choices of all components; a kind of cell can replace the usual reasons."""
    choices = []
    for component, (why, why_not) in COMPONENTS.items():
        reason = built.get(component, False)
        if reason:
            choices.append(Choice(component, why if reason is True else str(reason), True))
        else:
            choices.append(Choice(component, omitted.get(component, why_not), False))
    return tuple(choices)
