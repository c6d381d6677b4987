"""Cells of every kind, and the maker that chooses the kind."""

from typing import Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk import J2, BulkLaw, Elastic, GradedElastic, NeoHookean, Prony
from multiscale.laws.bulk.moduli import contact_modulus as contact_modulus
from multiscale.micro.elastic.graph_cell import GraphCell
from multiscale.micro.finite.finite_cell import FiniteCell
from multiscale.micro.flat.flat_cell import FlatCell
from multiscale.micro.layer import Coating, LayerLaw, SecondBody
from multiscale.micro.mesh.mesh_cell import MeshCell
from multiscale.surfaces import self_affine as self_affine
from multiscale.surfaces.surface import Surface as Surface

__all__ = ["AnyCell", "Cell", "GridCell"]

GridCell = FlatCell | GraphCell | FiniteCell
AnyCell = GridCell | MeshCell


def Cell(  # noqa: N802  reads like the kinds that it makes
    surface: Surface,
    depth: float,
    layers: int,
    youngs_modulus: float | np.ndarray,
    poissons_ratio: float | np.ndarray,
    obstacle: Surface | None = None,
    geometry: Literal["conforming", "flat"] = "conforming",
    hardness: float | None = None,
    bulk: BulkLaw | None = None,
    friction_coefficient: float = 0.0,
    opposite: SecondBody | None = None,
    slope_order: int = 1,
    coating: tuple[Coating, ...] = (),
) -> GridCell:
    """Build the kind of cell that the arguments ask for.

    Parameters
    ----------
    surface, depth, layers
        As of :class:`~multiscale.micro.layer.PeriodicLayer`.
    youngs_modulus, poissons_ratio : float or ndarray
        Pa and 1: of the whole cell, of each layer from the base up, shape (layers,), or of each
        element, shape (nx, layers, ny). For two bodies, a material with their contact modulus.
    obstacle, hardness, friction_coefficient
        As of :class:`FlatCell` and :class:`FiniteCell`.
    geometry : {"conforming", "flat"}
        Whether the mesh follows the surface, or the surface only makes the gap above a flat layer.
    bulk : NeoHookean, J2 or Prony, optional
        Law at large strain, with the moduli above; small strain if not given.
    opposite : SecondBody, optional
        Makes the obstacle deformable, as ``second`` of :class:`FlatCell` and :class:`FiniteCell`.
    slope_order : int, as of :class:`FlatCell`; other cells are exact in the slope
    coating : tuple of Coating
        Layers of other materials at the top of the first body, outermost first.

    Returns
    -------
    FlatCell, GraphCell or FiniteCell
        A finite cell if there is a law at large strain, friction or a second body.

    Raises
    ------
    CaseError
        If a parameter is outside its range or means nothing to this kind of cell.
    """
    moduli = {"youngs_modulus": youngs_modulus, "poissons_ratio": poissons_ratio}
    law: LayerLaw
    if bulk is None:
        graded = bool(np.ndim(youngs_modulus) or np.ndim(poissons_ratio))
        law = GradedElastic(**moduli) if graded else Elastic(*map(float, moduli.values()))
    elif not isinstance(bulk, NeoHookean | J2 | Prony):
        raise CaseError(
            f"a cell takes NeoHookean, J2 or Prony as its law at large strain, got "
            f"{type(bulk).__name__}; leave bulk out for linear elasticity"
        )
    else:
        law = bulk
        for name, value in moduli.items():  # which the law repeats
            if not np.all(np.isclose(value, given := getattr(law, name), rtol=1e-12, atol=0.0)):
                raise CaseError(
                    f"{name} of the bulk law is {given:g}, but of the cell "
                    f"{np.ravel(value)[0]:g}; give the same, and one for the whole cell"
                )
    if geometry not in ("conforming", "flat"):
        raise CaseError(f"geometry must be 'conforming' or 'flat', got {geometry!r}")
    if geometry == "flat":
        if friction_coefficient != 0.0:
            raise CaseError(
                "a flat cell has neither friction nor a law at large strain; use the conforming "
                "geometry"
            )
        flat = obstacle, hardness, slope_order, opposite
        return FlatCell(surface, depth, layers, law, *flat, coating=coating)
    if hardness is not None:
        raise CaseError("a hardness caps the pressure of a flat cell only; use geometry='flat'")
    if slope_order != 1:
        raise CaseError("slope_order belongs to flat cells, as others follow the surface")
    if bulk is None and friction_coefficient == 0.0 and opposite is None:
        return GraphCell(surface, depth, layers, law, obstacle, coating=coating)
    more = obstacle, friction_coefficient, opposite
    return FiniteCell(surface, depth, layers, law, *more, coating=coating)
