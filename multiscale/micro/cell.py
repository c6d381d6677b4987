"""Cells of every kind, and the maker that chooses the kind."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk import J2, BulkLaw, Elastic, GradedElastic, NeoHookean, Prony
from multiscale.laws.bulk.moduli import contact_modulus as contact_modulus
from multiscale.micro.cell_needs import (
    MEAN,
    CellPart,
    cell_choices,
    layer_memory,
    layer_unknowns,
)
from multiscale.micro.elastic.graph_cell import GraphCell
from multiscale.micro.flat.flat_cell import FlatCell
from multiscale.micro.layer import Coating, LayerLaw, PeriodicLayer, SecondBody
from multiscale.micro.mesh.mesh_cell import MeshCell
from multiscale.micro.path import Path
from multiscale.needs import Needs
from multiscale.surfaces import self_affine as self_affine
from multiscale.surfaces.surface import Surface as Surface

if TYPE_CHECKING:
    from multiscale.micro.step_loop import CellModel

__all__ = ["AnyCell", "Cell", "FiniteCell", "GridCell"]

PAIR, FLOWING = 3e-6, 4.5e-5  # s of one core for a load step and an unknown, measured


@dataclass(frozen=True, eq=False)
class FiniteCell(PeriodicLayer):
    """A layer at large strain, with friction or against a second deformable body.

    Contact is sought in the current configuration. In addition to the parameters of
    :class:`PeriodicLayer`:

    Parameters
    ----------
    obstacle : Surface, optional
        Underside of the counterface; a flat if not given. It has the grid of the surface or, of
        a second body, another one on the same area.
    friction_coefficient : float, coefficient of the local Coulomb law
    second : SecondBody, optional
        Makes the obstacle deformable.
    """

    obstacle: Surface | None = None
    friction_coefficient: float = 0.0
    second: SecondBody | None = None
    recovers_stress: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        mu = self.friction_coefficient
        if not 0.0 <= mu < np.inf:
            raise CaseError(f"the friction coefficient must not be negative, got {mu:g}")
        if self.second is None:
            self._check_obstacle(self.obstacle)
            return
        if self.obstacle is not None and self.obstacle.size != self.surface.size:
            raise CaseError(
                f"both bodies need the same area, the first has {self.surface.size} m, the "
                f"opposite {self.obstacle.size} m; crop or repeat one"
            )
        grid = self.surface.heights.shape
        if self.obstacle is not None and np.any(np.less(grid, self.obstacle.heights.shape)):
            raise CaseError(
                f"contact is decided at the nodes of the first body, which has {grid} points, "
                f"fewer than the opposite body with {self.obstacle.heights.shape}; exchange them "
                f"or resample one"
            )
        try:
            self.second_layer  # noqa: B018  checks itself
        except CaseError as error:
            raise CaseError(f"the opposite body: {error}") from error

    @property
    def second_layer(self) -> PeriodicLayer:
        """The second body in its own frame, with z out of its surface."""
        if self.second is None:
            raise ValueError("the obstacle of this cell is rigid")
        under = self.obstacle
        heights = np.zeros_like(self.surface.heights) if under is None else -under.heights
        return self.second.layer(Surface(heights, self.surface.size))

    @property
    def bodies(self) -> tuple[PeriodicLayer, ...]:
        """The deformable bodies."""
        return (self,) if self.second is None else (self, self.second_layer)

    @property
    def flows(self) -> bool:
        """Whether a body flows."""
        return any(body.law.flows for body in self.bodies)

    def needs(self) -> Needs:
        """Parts, memory and time that a step takes."""
        laws, mu = [body.law for body in self.bodies], self.friction_coefficient
        large, pair = any(law.finite_strain for law in laws), self.second is not None
        linear = not all(law.finite_strain for law in laws)
        small = "small strain, the mesh follows the surface"
        here = ", contact in the current configuration"
        return Needs(
            unknowns_per_contact=3 if mu > 0.0 else 1,
            kinematics=small.replace("small", "large") + here
            if large
            else small + (here if pair else ""),
            choices=cell_choices(
                {
                    CellPart.STIFFNESS: linear,
                    CellPart.TANGENT: large,
                    CellPart.FRICTION: mu > 0.0,
                    CellPart.SECOND_BODY: pair,
                    CellPart.LAYER_FACTORS: True,
                    CellPart.MEAN_DILATATION: self.mean_dilatation or self.flows,
                    CellPart.TILT: self.nearly_incompressible and linear,
                    CellPart.OBSTACLE_NORMALS: self.obstacle is not None or pair,
                    CellPart.ELEMENT_MODULI: self.heterogeneous,
                    CellPart.COATING: any(body.coating for body in self.bodies),
                },
                {CellPart.MEAN_DILATATION: MEAN.format("pressures are unknowns")} if large else {},
            ),
            state_variables=tuple(name for law in laws for name in law.history),
            libraries=("numba",),
            memory=sum(layer_memory(body, mu) for body in self.bodies),
            seconds=(FLOWING if large or self.flows else PAIR)
            * sum(map(layer_unknowns, self.bodies)),
        )

    def model(self, path: Path, *, recover_stress: bool = False) -> "CellModel[Any]":
        """Set up the scene of the cell for a path."""
        from multiscale.micro.finite.finite_path import assemble_finite_cell

        return assemble_finite_cell(self, path)


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
