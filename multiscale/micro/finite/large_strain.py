"""The layered cell at large strain as a body: neo-Hookean, J2 plasticity, viscous branches."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from multiscale.laws.bulk import J2, NeoHookean, Prony
from multiscale.micro.elastic.hexahedron import BATCH
from multiscale.micro.finite.element_stiffness import ENTRIES, MOTIONS
from multiscale.micro.finite.scene import BodyResponse, FiniteBody, Increment
from multiscale.micro.finite.tangent_operator import (
    NEO_HOOKEAN,
    PLASTIC,
    apply_tangent,
    respond_cell,
    update_state,
)
from multiscale.micro.layer import GraphMesh

__all__ = ["large_strain_body", "pressure_scale"]

NO_STATE = np.zeros((1, 1, 1, 8, 7, 1))
NO_HARDENING = (0.0, 0.0, 0.0, 0.0)
State = np.ndarray | None


def large_strain_body(mesh: GraphMesh, law: NeoHookean | J2 | Prony, *, mixed: bool) -> FiniteBody:
    """Return the layered cell at large strain as a body."""
    cell = _LargeStrainCell(mesh, law, mixed)
    begin = {NeoHookean: cell.begin_elastic, J2: cell.begin_plastic, Prony: cell.begin_viscous}
    return FiniteBody(cell.shape, begin[type(law)], cell.rest)


def pressure_scale(mesh: GraphMesh, shear_modulus: float) -> float:
    """Return the pressure over its unknown, Pa/m, for equations of one size."""
    return shear_modulus / min(mesh.surface.spacing)


@dataclass(frozen=True, eq=False)
class _LargeStrainCell:
    mesh: GraphMesh
    law: NeoHookean | J2 | Prony
    mixed: bool

    @property
    def shape(self) -> tuple[int, int, int, int]:
        nx, ny, layers = self.mesh.shape
        return nx, layers, 4 if self.mixed else 3, ny

    @property
    def scale(self) -> float:
        return pressure_scale(self.mesh, self.law.shear_modulus) if self.mixed else 0.0

    @property
    def points(self) -> tuple[int, ...]:
        nx, ny, layers = self.mesh.shape
        return nx, layers, -(-ny // BATCH), 8

    @cached_property
    def geometry(self) -> tuple[Any, ...]:
        heights = np.ascontiguousarray(self.mesh.surface.heights, dtype=np.float64)
        return heights, self.mesh.planes, self.mesh.map_factor, *self.mesh.surface.spacing

    @cached_property
    def tangent(self) -> np.ndarray:
        """One buffer for the tangents of all iterations."""
        rows = ENTRIES + MOTIONS + 1 if self.mixed else ENTRIES
        return np.empty((*self.points[:3], rows * BATCH), dtype=np.float32)

    def rest(self) -> State:
        """State before any load, for each batch of elements."""
        rows = self.law.n_state
        return np.zeros((*self.points, rows, BATCH)) if rows else None

    def apply(self, v: np.ndarray) -> np.ndarray:
        out = np.zeros_like(v)
        apply_tangent(self.tangent, v, out)
        return out

    def step(
        self, kept: np.ndarray, moduli: np.ndarray, finish: Callable[[np.ndarray], State]
    ) -> Increment:
        """Return the increment for given internal variables and moduli, Pa."""
        kind = PLASTIC if isinstance(self.law, J2) else NEO_HOOKEAN

        def respond(u: np.ndarray) -> BodyResponse:
            force, flags = np.zeros_like(u), np.empty((len(u), 2))
            respond_cell(
                self.geometry,
                kind,
                moduli,
                self.scale,
                u,
                kept,
                force,
                self.tangent,
                flags,
            )
            nx, ny, layers = self.mesh.shape
            flowing = float(flags[:, 1].sum()) / (8.0 * nx * ny * layers)
            return BodyResponse(force, self.apply, float(flags[:, 0].min()), flowing)

        return Increment(respond, finish)

    def moduli(self, share: float = 1.0) -> np.ndarray:
        hardening = self.law.hardening if isinstance(self.law, J2) else NO_HARDENING
        return np.array([share * self.law.shear_modulus, self.law.volume_modulus, *hardening])

    def begin_elastic(self, state: State, time_step: float) -> Increment:
        return self.step(NO_STATE, self.moduli(), lambda u: None)

    def begin_plastic(self, state: State, time_step: float) -> Increment:
        assert state is not None

        def finish(u: np.ndarray) -> np.ndarray:
            new = np.empty_like(state)
            update_state(self.geometry, PLASTIC, self.moduli(), u, state, new)
            return new

        return self.step(state, self.moduli(), finish)

    def begin_viscous(self, state: State, time_step: float) -> Increment:
        assert state is not None
        assert isinstance(self.law, Prony)
        law = self.law.over(time_step)
        rows = np.moveaxis(state, -2, 0)

        def finish(u: np.ndarray) -> np.ndarray:
            elastic = np.empty((*self.points, 6, BATCH))
            update_state(self.geometry, NEO_HOOKEAN, self.moduli(), u, NO_STATE, elastic)
            elastic *= law.shear_modulus
            new = law.advance(rows, np.moveaxis(elastic, -2, 0))
            return np.ascontiguousarray(np.moveaxis(new, 0, -2))

        frozen = np.ascontiguousarray(np.moveaxis(law.frozen_stress(rows), 0, -2))
        return self.step(frozen, self.moduli(law.share), finish)
