r"""Newton steps by a Krylov method, with flat elastic cells as the preconditioner.

With rows :math:`E` of unit directions of prescribed or supported motions, compliances
:math:`\epsilon` of the springs, the flat cell :math:`K_0` and the change :math:`\zeta` of the
approach under a prescribed load,

.. math::
    K_0 z + E^t l = r, \qquad E z + e_z \zeta - \epsilon\, l = d, \qquad
    -e_z^t l = \rho. \tag{1}

Two bodies, with the interpolation :math:`W` of the second surface at the nodes of the first and the
mirror :math:`M`, move against each other under forces :math:`l` and their reactions by

.. math:: (C_1 + W M C_2 M W^t)\, l.    \tag{2}

With pressures :math:`p` of the elements as unknowns, the stiffness :math:`A` against shear, the
changes :math:`B z` of the volumes :math:`V` and the bulk modulus :math:`\kappa`, the flat cell is

.. math::
    A z + B^t p = r, \qquad B z - \frac{V}{\kappa}\, p = g. \tag{3}

.. [1] M. Benzi, G. H. Golub and J. Liesen, Acta Numer. 14 (2005) 1-137,
   doi:10.1017/S0962492904000212: saddle points, section 10.1 for preconditioners of the form (3).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.micro.elastic.flat_contact import solve_flat
from multiscale.micro.elastic.flat_reference import Field, Reference, flat_inverse
from multiscale.micro.elastic.lateral_fft import LateralInverse
from multiscale.micro.finite.equations import Iterate, join
from multiscale.micro.finite.large_strain import pressure_scale
from multiscale.micro.finite.strain import kernel
from multiscale.micro.finite.surfaces import MIRROR, Meeting
from multiscale.micro.layer import GraphMesh, PeriodicLayer
from multiscale.numerics.krylov import conjugate_gradients, minimal_residual

LEAST_SPRING = 0.3 / 1.3  # share of the bound above which the preconditioner has a spring
KRYLOV_MEMORY = 1e9  # bytes of the directions of a linear problem
SINGLE = 4e-6  # least relative tolerance of a linear problem, which single precision reaches
KRYLOV_ITERATIONS = (60, 400)  # bounds on the number of stored directions
_INNER = 1e-3  # relative tolerance on the surface; the Krylov method is flexible
_LIMIT = 200  # iterations on the surface
_MIRRORED = np.array([1.0, 1.0, -1.0, 1.0, -1.0, 1.0])[:, None, None]  # of xx, xy, xz, yy, yz, zz


@dataclass(frozen=True, eq=False)
class FlatCells:
    """The flat cells of all bodies."""

    references: tuple[Reference, ...]  # of each body in its local frame
    both: Reference  # flat cell with the sum of the compliances, on the grid of the first body

    def touch(self, gap: np.ndarray, closing: np.ndarray, load: float) -> tuple[np.ndarray, float]:
        """Press the flat cells under a load, N; see :class:`.LinearSolver`."""
        touch = solve_flat(self.both.vertical[0], gap, closing, load=load)
        return touch.value > 0.0, touch.approach

    def step(self, now: Iterate, forcing: float, floor: float) -> tuple[np.ndarray, float, int]:
        """Solve the linear problem of a Newton step; see :class:`.LinearSolver`."""
        size, constraint = now.u.size, self.constraint(now)
        carries = now.target.load is not None
        weight = 1.0 / np.sqrt(max(int(now.active.sum()), 1))

        def apply(x: np.ndarray) -> np.ndarray:
            change, vertical = now.apply(x[:size], x[size])
            balance = weight * vertical if carries else 0.0
            return np.append(change, np.asarray(balance, change.dtype))

        def precondition(r: np.ndarray) -> np.ndarray:
            z, shift = constraint.solve(r[:size], r[size] / weight)
            return np.append(z, np.asarray(shift, z.dtype))

        # the first step satisfies the prescribed motions, all Krylov directions leave them fixed
        first, shift = constraint.solve(-now.residual, now.missing, now.distance)
        x = np.append(first, shift)
        rest = np.append(-now.residual, weight * now.missing if carries else 0.0) - apply(x)
        weights = now.scene.weights[0] * float(np.linalg.norm(now.distance))
        present = np.hypot(float(np.linalg.norm(now.residual)), weights)
        norm = float(np.linalg.norm(rest)) or 1.0
        goal = max(max(forcing * present, floor * now.scale) / norm, SINGLE)
        room = int(KRYLOV_MEMORY / (2 * x.nbytes))
        limit = min(max(room, KRYLOV_ITERATIONS[0]), KRYLOV_ITERATIONS[1])
        unit = (rest / norm).astype(np.float32)  # enough for the tolerance, in half the memory
        y, iterations = minimal_residual(apply, unit, precondition, goal=goal, room=limit)
        x += norm * y.astype(float)
        return x[:size], float(x[size]), iterations + 1

    def constraint(self, now: Iterate) -> "Constraint":
        """Return prescribed motions and springs of an iterate."""
        rows, fixed = now.meeting.normal[None], now.active[None]
        spring = np.zeros(fixed.shape)
        if now.friction is not None:
            rows = np.concatenate([rows, now.friction.direction])
            fixed = np.stack([now.active, now.sticking, now.sticking])
            strong = now.friction.share > LEAST_SPRING
            spring = np.zeros(fixed.shape)
            spring[2] = np.where(strong, now.scene.weights[1] * now.friction.stretch, 0.0)
        return Constraint(self, now, rows, fixed, spring)

    def solve(
        self, loads: list[Field], correct: Callable[[Field], Field], meeting: Meeting
    ) -> list[Field]:
        """Solve for nodal forces, (nx, 3, ny); ``correct`` maps relative motion to contact."""
        if len(self.references) == 1:
            return [self.references[0].solve(loads[0], correct)]
        point = meeting.point
        assert point is not None
        second: list[Field] = []

        def meet(top: Field) -> Field:
            pushes: list[Field] = []

            def push(moved: Field) -> Field:
                pushes.append(correct(top - MIRROR * point.carry(moved)))
                return np.asarray(-MIRROR * point.spread(pushes[0]))

            second.append(self.references[1].solve(loads[1], push))
            return pushes[0]

        return [self.references[0].solve(loads[0], meet), *second]

    def compliance(self, force: Field, meeting: Meeting) -> Field:
        """Relative motion (2), m, under forces on the nodes, N, and their reactions."""
        moved = self.references[0].compliance(force)
        for reference in self.references[1:]:
            assert meeting.point is not None
            reaction = reference.compliance(MIRROR * meeting.point.spread(force))
            moved = moved + MIRROR * meeting.point.carry(reaction)
        return moved


def join_flat_cells(first: Reference, second: Reference, compliance: np.ndarray) -> FlatCells:
    """Return the flat cells of two bodies, with the second compliance on the first grid."""
    inverse = first.inverse
    symbol = inverse.surface_compliance + _MIRRORED * compliance
    nx, _, ny = inverse.shape
    layer = np.repeat(np.moveaxis(symbol[:, : nx // 2 + 1], 0, 1)[:, None], 2, axis=3)
    nothing = np.zeros((0, 9)), np.zeros((4, nx)), np.zeros((4, layer.shape[3]))
    both = LateralInverse((nx, 1, ny), layer, nothing)
    return FlatCells((first, second), Reference(both, np.ones(1)))


@dataclass(frozen=True, eq=False)
class Constraint:
    """Rows of (1) for each direction of each surface node."""

    cells: FlatCells
    now: Iterate
    direction: np.ndarray  # (rows, nx, 3, ny), unit directions
    fixed: np.ndarray  # (rows, nx, ny), whether a motion is prescribed
    spring: np.ndarray  # (rows, nx, ny), stiffness that supports a motion, N/m, or 0

    @cached_property
    def touched(self) -> np.ndarray:
        """Rows of the surface problem."""
        return np.asarray(self.fixed | (self.spring > 0.0))

    @cached_property
    def _give(self) -> np.ndarray:
        return np.where(self.spring > 0.0, 1.0 / np.where(self.spring > 0.0, self.spring, 1.0), 0.0)

    @property
    def closing(self) -> np.ndarray:
        """Share of the approach in each row."""
        return np.asarray(self.direction[:, :, 2] * self.touched)

    @cached_property
    def _vertical(self) -> bool:
        convolves = len(self.cells.references) == 1 and self.cells.both.convolves
        return convolves and len(self.direction) == 1 and bool(np.all(self.direction[0, :, 2] == 1))

    def along(self, moved: Field) -> Field:
        """Project a motion, m, on the rows, shape (rows, nx, ny)."""
        return np.asarray(np.sum(self.direction * moved, axis=2) * self.touched)

    def push(self, force: Field) -> Field:
        """Sum the forces along the rows, N, to vectors, shape (nx, 3, ny)."""
        return np.asarray(np.sum(self.direction * (force * self.touched)[:, :, None], axis=0))

    def _respond(self, force: Field) -> Field:
        if self._vertical:
            return np.where(self.fixed, self.cells.both.vertical[0](force[0]), 0.0)
        moved = self.along(self.cells.compliance(self.push(force), self.now.meeting))
        return np.asarray(moved + self._give * force)

    def _resist(self, moved: Field) -> Field:
        if self._vertical:
            return np.where(self.fixed, self.cells.both.vertical[1](moved[0]), 0.0)
        return self.along(self.cells.both.stiffness(self.push(moved)))  # as on matching grids

    def surface_solve(self, right_hand_side: Field) -> Field:
        """Solve for the forces along the rows, N, for given motions, m, both (rows, nx, ny)."""
        r = right_hand_side * self.touched
        goal = _INNER * float(np.linalg.norm(r))
        return conjugate_gradients(self._respond, r, self._resist, goal=goal, limit=_LIMIT)[0]

    @cached_property
    def _unit(self) -> Field:
        """Forces under a unit approach, N/m."""
        return self.surface_solve(self.closing)

    def solve(
        self, residual: Field, missing: float, distance: np.ndarray | None = None
    ) -> tuple[Field, float]:
        r"""Solve (1)."""
        shift = 0.0

        def correct(moved: Field) -> Field:
            nonlocal shift
            excess = self.along(moved)
            if distance is not None:
                excess = excess - distance
            force = self.surface_solve(excess)
            if self.now.target.load is not None:
                balance = float(np.vdot(self.closing, force))
                shift = -(missing + balance) / float(np.vdot(self.closing, self._unit))
                force = force + shift * self._unit
            return -self.push(force)

        z = join(self.cells.solve(self.now.scene.split(residual), correct, self.now.meeting))
        target = -self.closing * shift if distance is None else distance - self.closing * shift
        moved = self.now.meeting.relative(z)
        off = np.where(self.fixed, target - np.sum(self.direction * moved, axis=2), 0.0)
        # correct prescribed motions for rounding and the inner tolerance
        self.now.scene.surface(z)[:] += self.push(off)
        return z, shift


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedReference(Reference):
    """The flat cell of a body of shape (nx, layers, 4, ny), with scaled pressures."""

    faces: np.ndarray  # (3, layers), quarter of an element's faces across x, y, z, times scale, N/m
    give: np.ndarray  # (layers,), V over kappa times the square of the scale, N/m

    def solve(
        self,
        force: Field | None,
        correct: Callable[[Field], Field] | None,
        out: Field | None = None,
    ) -> Field:
        """Solve (3) with eliminated pressures; ``correct`` returns added surface forces."""
        assert force is not None
        z = np.empty_like(force) if out is None else out
        _push(self.faces, self.give, force, z)
        moved = z[:, :, :3]
        self.inverse.solve(moved, correct, moved)
        _widen(self.faces, self.give, force, z)
        return z


@kernel
def _push(faces, give, force, z):  # type: ignore[no-untyped-def]
    """Write the forces r + B^t g kappa / V without the pressures into ``z``."""
    nx, layers, _, ny = force.shape
    total, turned = np.empty(ny, force.dtype), np.empty(ny, force.dtype)
    for i in range(nx):
        for layer in range(layers):
            for k in range(3):
                for j in range(ny):
                    z[i, layer, k, j] = force[i, layer, k, j]
    for i in range(nx):
        for layer in range(layers):
            p = force[i, layer, 3]
            factor = 1.0 / give[layer]
            for j in range(1, ny):  # of both elements next to a node
                total[j], turned[j] = factor * (p[j - 1] + p[j]), factor * (p[j - 1] - p[j])
            total[0], turned[0] = factor * (p[ny - 1] + p[0]), factor * (p[ny - 1] - p[0])
            for a in range(2):
                for c in range(0 if layer > 0 else 1, 2):
                    row = z[(i + a) % nx, layer + c - 1]
                    x, y, up = (2 * a - 1) * faces[0, layer], faces[1, layer], faces[2, layer]
                    up *= 2 * c - 1
                    for j in range(ny):
                        row[0, j] += x * total[j]
                        row[1, j] += y * turned[j]
                        row[2, j] += up * total[j]


@kernel
def _widen(faces, give, force, z):  # type: ignore[no-untyped-def]
    """Write the pressures (B z - g) kappa / V into ``z``."""
    nx, layers, _, ny = force.shape
    across, along = np.empty(ny, force.dtype), np.empty(ny, force.dtype)
    for i in range(nx):
        for layer in range(layers):
            across[:], along[:] = 0.0, 0.0
            for a in range(2):
                for c in range(0 if layer > 0 else 1, 2):
                    row = z[(i + a) % nx, layer + c - 1]
                    x, y, up = (2 * a - 1) * faces[0, layer], faces[1, layer], faces[2, layer]
                    up *= 2 * c - 1
                    for j in range(ny):
                        across[j] += x * row[0, j] + up * row[2, j]
                        along[j] += y * row[1, j]
            g, p = force[i, layer, 3], z[i, layer, 3]
            factor = 1.0 / give[layer]
            for j in range(ny):
                after = j + 1 if j + 1 < ny else 0
                change = across[j] + across[after] + along[after] - along[j]
                p[j] = factor * (change - g[j])


def mixed_reference(
    layer: PeriodicLayer, mesh: GraphMesh, dtype: type[np.floating] = np.float64
) -> MixedReference:
    """Return the flat cell of a meshed layer at rest, with its pressures."""
    lame, shear = layer.layer_moduli
    dx, dy = mesh.surface.spacing
    heights, scale = np.diff(mesh.planes), pressure_scale(mesh, float(shear[0]))
    areas = np.array([dy * heights, dx * heights, np.full(len(heights), dx * dy)])
    return MixedReference(
        flat_inverse(layer, layer.surface.heights.shape, layer.surface.spacing, dtype),
        mesh.map_factor[1:],
        faces=scale * areas / 4.0,
        give=scale**2 * dx * dy * heights / (lame + 2.0 / 3.0 * shear),
    )
