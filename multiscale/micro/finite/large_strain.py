"""Layers at large strain as bodies: internal forces, matrix-free tangent, state.

Displacements, m, and forces, N, are arrays of shape ``(nx, layers, 3 or 4, ny)``, with pressures as
the fourth component for the mean dilatation of elements.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from multiscale.executors import run_ranges
from multiscale.laws.bulk import J2, NeoHookean, Prony
from multiscale.micro.elastic.stiffness import BATCH, gather, scatter
from multiscale.micro.finite.equations import BodyResponse, FiniteBody, Respond
from multiscale.micro.finite.matrix import (
    ENTRIES,
    FIRST,
    MOTIONS,
    POINT_ROWS,
    SECOND,
    STEP,
    add_matrix,
    multiply,
    walsh,
)
from multiscale.micro.finite.plastic import SINGLE_ROWS, plastic, plastic_state
from multiscale.micro.finite.strain import (
    CHANGE,
    COFACTOR,
    DET,
    DILATED,
    FLUX,
    GEOMETRY,
    GRADIENT,
    LAW,
    LOG,
    MEAN,
    NODES,
    PRESSURE,
    PULLED,
    SCRATCH,
    VOLUME,
    WEIGHT,
    Moduli,
    edge_forces,
    inlined,
    kernel,
    logarithm,
    point_rows,
    pull_back,
    strain_batch,
)
from multiscale.micro.layer import GraphMesh

NEO_HOOKEAN, PLASTIC = 0, 1
LEAST_DILATATION = 1e-3  # smallest det F with forces
SHARE = math.sqrt(0.125)  # weight of each corner in an amplitude
LEAST = 1000  # fewest elements for a thread
LEAST_SLOPE = 0.1  # of ln J / J times J^2, which falls to 0 at J = e
NO_STATE = np.zeros((1, 1, 1, 8, 7, 1))
State = np.ndarray | None

# of a Neo-Hookean point
METRIC = LAW  # 6: R
LATER = METRIC + 6 * BATCH  # 9: columns of X
CURVED = LATER + 9 * BATCH  # 6: M


@kernel
def _neo_hookean(s, q, shear, frozen, has_frozen, tangent):  # type: ignore[no-untyped-def]
    """Add the flux of a Gauss point and write its tangent, both pulled back."""
    # R = mu I + S_v with the frozen second Piola-Kirchhoff stress S_v (rows 11, 22, 33, 12, 23,
    # 13), g = F^-T T^t, the volumetric Kirchhoff stress t and its derivative t' by ln J:
    #     P T^t = F R T^t + (t - mu) g,
    #     A_iakb = delta_ik (T R T^t)_ab + (mu - t) g_ib g_ka + t' g_ia g_kb
    rx, ry, _, rt = point_rows(q)
    f, weight = s[GRADIENT + 9 * q * BATCH :], s[WEIGHT + q * BATCH :]
    height = s[GEOMETRY + rt :]
    by_x, by_y = s[GEOMETRY + rx + 4 * BATCH :], s[GEOMETRY + ry + 4 * BATCH :]
    for row in range(6):
        for v in range(BATCH):
            s[METRIC + row * BATCH + v] = shear if row < 3 else 0.0
        if has_frozen:
            for v in range(BATCH):
                s[METRIC + row * BATCH + v] += frozen[row, v]
    for v in range(BATCH):
        xx, yy, zz = s[METRIC + v], s[METRIC + BATCH + v], s[METRIC + 2 * BATCH + v]
        xy, yz = s[METRIC + 3 * BATCH + v], s[METRIC + 4 * BATCH + v]
        xz = s[METRIC + 5 * BATCH + v]
        inverse = 1.0 / height[v]
        tx, ty = -by_x[v] * inverse, -by_y[v] * inverse
        x = tx * xx + ty * xy + inverse * xz
        y = tx * xy + ty * yy + inverse * yz
        z = tx * xz + ty * yz + inverse * zz
        s[LATER + v], s[LATER + BATCH + v], s[LATER + 2 * BATCH + v] = xx, xy, xz
        s[LATER + 3 * BATCH + v], s[LATER + 4 * BATCH + v], s[LATER + 5 * BATCH + v] = xy, yy, yz
        s[LATER + 6 * BATCH + v], s[LATER + 7 * BATCH + v], s[LATER + 8 * BATCH + v] = x, y, z
        s[CURVED + v], s[CURVED + BATCH + v], s[CURVED + 2 * BATCH + v] = xx, xy, x
        s[CURVED + 3 * BATCH + v], s[CURVED + 4 * BATCH + v] = yy, y
        s[CURVED + 5 * BATCH + v] = tx * x + ty * y + inverse * z
    force = s[LOG:]
    for k in range(3):
        for a in range(3):
            row = (rx, ry, 8 * BATCH + rt)[a] + 12 * k * BATCH
            fk, xa, out = f[3 * k * BATCH :], s[LATER + 3 * a * BATCH :], s[FLUX + row :]
            g = s[PULLED + (3 * k + a) * BATCH :]
            for v in range(BATCH):
                push = fk[v] * xa[v] + fk[BATCH + v] * xa[BATCH + v]
                push += fk[2 * BATCH + v] * xa[2 * BATCH + v]
                out[v] += weight[v] * (push + (force[v] - shear) * g[v])
    _neo_hookean_tangent(s, weight, shear, tangent)


@kernel
def _neo_hookean_tangent(s, weight, shear, tangent):  # type: ignore[no-untyped-def]
    for block in range(6):
        i, k = FIRST[block], SECOND[block]
        same = 1.0 if i == k else 0.0
        g, h, m = s[PULLED + 3 * i * BATCH :], s[PULLED + 3 * k * BATCH :], s[CURVED:]
        out = tangent[(block if block < 3 else 24 + block) * BATCH :]
        for v in range(BATCH):
            p, w = weight[v] * (shear - s[LOG + v]), weight[v] * s[LOG + BATCH + v]
            x, y, z = g[v], g[BATCH + v], g[2 * BATCH + v]
            a, b, c = h[v], h[BATCH + v], h[2 * BATCH + v]
            curved = same * weight[v]
            xy, xz, yz = curved * m[BATCH + v], curved * m[2 * BATCH + v], curved * m[4 * BATCH + v]
            out[v] = (p + w) * x * a + curved * m[v]
            out[STEP + v] = p * y * a + w * x * b + xy
            out[2 * STEP + v] = p * z * a + w * x * c + xz
            out[3 * STEP + v] = p * x * b + w * y * a + xy
            out[4 * STEP + v] = (p + w) * y * b + curved * m[3 * BATCH + v]
            out[5 * STEP + v] = p * z * b + w * y * c + yz
            out[6 * STEP + v] = p * x * c + w * z * a + xz
            out[7 * STEP + v] = p * y * c + w * z * b + yz
            out[8 * STEP + v] = (p + w) * z * c + curved * m[5 * BATCH + v]


@inlined
def _volume(s, q, modulus, mixed):  # type: ignore[no-untyped-def]
    """Volumetric Kirchhoff stress J p, or of U = modulus / 2 ln^2 J, and its derivative by ln J."""
    det = s[DET + q * BATCH :]
    if mixed:
        for v in range(BATCH):
            s[LOG + v] = s[PRESSURE + v] * det[v]
            s[LOG + BATCH + v] = s[LOG + v]
    else:
        logarithm(det, s[CHANGE:])
        for v in range(BATCH):
            s[LOG + v], s[LOG + BATCH + v] = modulus * s[CHANGE + v], modulus


@inlined
def _dilate(s, q):  # type: ignore[no-untyped-def]
    """Add the flux of a Gauss point of the derivatives of the volume."""
    weight, det = s[WEIGHT + q * BATCH :], s[DET + q * BATCH :]
    for direction, row in enumerate(point_rows(q)[:3]):
        _spread(s[PULLED + direction * BATCH :], weight, det, s[DILATED + row :])


@inlined
def _spread(g, weight, det, out):  # type: ignore[no-untyped-def]
    """Add a direction of this flux to its rows of the three components."""
    for v in range(BATCH):
        volume = weight[v] * det[v]
        out[v] += volume * g[v]
        out[12 * BATCH + v] += volume * g[3 * BATCH + v]
        out[24 * BATCH + v] += volume * g[6 * BATCH + v]


@kernel
def _couple(s, mesh, modulus, scale, rows):  # type: ignore[no-untyped-def]
    """Residual of the volume into PRESSURE; its derivatives by motions and pressure into rows."""
    for k in range(36 * BATCH):
        s[FLUX + k] = s[DILATED + k]
    edge_forces(s, mesh.dx, mesh.dy)
    _to_modes(s[NODES:], rows)
    for k in range(MOTIONS * BATCH):
        rows[k] *= scale
    for v in range(BATCH):
        mean = s[MEAN + v]
        weight = scale * s[VOLUME + v] * mean / max(1.0 - s[CHANGE + v], LEAST_SLOPE)
        give = weight * mean / modulus
        s[PRESSURE + v] = weight * s[CHANGE + v] - give * s[PRESSURE + v]
        rows[MOTIONS * BATCH + v] = scale * give


def _run_coloured(kernel: Callable[..., None], u: np.ndarray, *arguments: Any) -> None:
    """Run a kernel on the first strips of all pairs, then on the second strips."""
    nx, layers, _, ny = u.shape
    for colour in range(2):
        least = -(-LEAST // (layers * ny))
        run_ranges(kernel, (nx + 1 - colour) // 2, colour, *arguments, least=least)


@kernel
def _respond(  # type: ignore[no-untyped-def]
    begin, end, colour, mesh, law, moduli, scale, u, state, out, tangent, least
):
    """Compute forces and tangent of strips, and the smallest det F and flowing points of each."""
    nx, layers, _, ny = u.shape
    batches = (ny + BATCH - 1) // BATCH
    has, mixed = state.shape[5] > 1, scale > 0.0
    for pair in range(begin, end):
        i = 2 * pair + colour
        sides = (i, (i + 1) % nx)
        s = np.zeros(SCRATCH)
        points = np.empty(8 * POINT_ROWS * BATCH, np.float32)
        sums = np.empty(ENTRIES * BATCH, np.float32)
        single = np.empty(SINGLE_ROWS * BATCH, np.float32)
        smallest, flowing = 1e300, 0
        for batch in range(batches):
            start = batch * BATCH
            lanes = min(BATCH, ny - start)
            for layer in range(layers):
                determinant = strain_batch(mesh, u, sides, layer, start, lanes, s)
                smallest = min(smallest, determinant)
                if not determinant > LEAST_DILATATION:
                    smallest = -1.0
                    continue
                rows = tangent[i, layer, batch]
                before = state[i, layer, batch] if has else state[0, 0, 0]
                for k in range(36 * BATCH):
                    s[FLUX + k], s[DILATED + k] = 0.0, 0.0
                if mixed:
                    logarithm(s[MEAN:], s[CHANGE:])
                    for v in range(lanes):
                        s[PRESSURE + v] = scale * u[i, layer, 3, start + v]
                for q in range(8):
                    point = points[q * POINT_ROWS * BATCH :]
                    pull_back(s, q)
                    _volume(s, q, moduli.volume, mixed)
                    if mixed:
                        _dilate(s, q)
                    if law == NEO_HOOKEAN:
                        _neo_hookean(s, q, moduli.shear, before[q], has, point)
                    else:
                        flowing += plastic(s, q, moduli, before[q], single, point, lanes)
                add_matrix(points, sums, mesh.dx, mesh.dy, rows)
                edge_forces(s, mesh.dx, mesh.dy)
                scatter(s[NODES:], sides, layer, start, lanes, out)
                if mixed:
                    _couple(s, mesh, moduli.volume, scale, rows[ENTRIES * BATCH :])
                    for v in range(lanes):
                        out[i, layer, 3, start + v] = s[PRESSURE + v]
        least[i, 0], least[i, 1] = smallest, flowing


@kernel
def _update(begin, end, mesh, law, moduli, u, state, new):  # type: ignore[no-untyped-def]
    """Write the state of strips at the end of a step: of J2 plasticity, or I - C^-1."""
    nx, layers, _, ny = u.shape
    batches = (ny + BATCH - 1) // BATCH
    for i in range(begin, end):
        sides = (i, (i + 1) % nx)
        s = np.zeros(SCRATCH)
        for batch in range(batches):
            start = batch * BATCH
            lanes = min(BATCH, ny - start)
            for layer in range(layers):
                strain_batch(mesh, u, sides, layer, start, lanes, s)
                for q in range(8):
                    out = new[i, layer, batch, q]
                    pull_back(s, q)
                    if law == PLASTIC:
                        for v in range(2 * BATCH):
                            s[LOG + v] = 0.0
                        old = state[i, layer, batch, q]
                        plastic_state(s, moduli, old, out)
                    else:
                        _inverse_strain(s, out)


@kernel
def _inverse_strain(s, out):  # type: ignore[no-untyped-def]
    """I - C^-1 from F^-T."""
    for row in range(6):
        a = row % 3 if row < 5 else 0
        b = a if row < 3 else (a + 1 if row < 5 else 2)
        unit = 1.0 if row < 3 else 0.0
        for v in range(BATCH):
            value = s[COFACTOR + a * BATCH + v] * s[COFACTOR + b * BATCH + v]
            for k in range(1, 3):
                x, y = COFACTOR + (3 * k + a) * BATCH + v, COFACTOR + (3 * k + b) * BATCH + v
                value += s[x] * s[y]
            out[row, v] = unit - value


@kernel
def _apply_tangent(begin, end, colour, tangent, u, out):  # type: ignore[no-untyped-def]
    """Multiply a displacement, m, by the tangent and add forces, N, of pairs of strips."""
    nx, layers, components, ny = u.shape
    batches = (ny + BATCH - 1) // BATCH
    for pair in range(begin, end):
        i = 2 * pair + colour
        sides = (i, (i + 1) % nx)
        s = np.empty(24 * BATCH, u.dtype)
        x, y = np.empty(MOTIONS * BATCH, np.float32), np.empty(MOTIONS * BATCH, np.float32)
        for batch in range(batches):
            start = batch * BATCH
            lanes = min(BATCH, ny - start)
            for layer in range(layers):
                gather(u, sides, layer, start, lanes, s)
                _to_modes(s, x)
                multiply(tangent[i, layer, batch], x, y)
                if components == 4:
                    rows = tangent[i, layer, batch, ENTRIES * BATCH :]
                    _press(rows, u[i, layer, 3, start:], x, y, out[i, layer, 3, start:], lanes)
                _from_modes(y, s)
                scatter(s, sides, layer, start, lanes, out)


@inlined
def _press(rows, pressure, x, y, out, lanes):  # type: ignore[no-untyped-def]
    """Add the forces of the pressure to ``y``, and write the change of the volume."""
    for v in range(lanes):
        out[v] = -rows[MOTIONS * BATCH + v] * pressure[v]
    for k in range(MOTIONS):
        row = k * BATCH
        for v in range(lanes):
            y[row + v] += rows[row + v] * pressure[v]
            out[v] += rows[row + v] * x[row + v]


@inlined
def _to_modes(s, x):  # type: ignore[no-untyped-def]
    for k in range(3):
        values, out = s[8 * k * BATCH :], x[7 * k * BATCH :]
        walsh(values, 0, BATCH, SHARE)
        for v in range(7 * BATCH):
            out[v] = values[BATCH + v]


@inlined
def _from_modes(y, s):  # type: ignore[no-untyped-def]
    for k in range(3):
        values, x = s[8 * k * BATCH :], y[7 * k * BATCH :]
        for v in range(BATCH):
            values[v] = 0.0
        for v in range(7 * BATCH):
            values[BATCH + v] = x[v]
        walsh(values, 0, BATCH, SHARE)


def pressure_scale(mesh: GraphMesh, shear_modulus: float) -> float:
    """Return the pressure per unit of its unknown, Pa/m, which scales its equations like forces."""
    return shear_modulus / min(mesh.surface.spacing)


@dataclass(frozen=True, eq=False)
class LargeStrainLayer(FiniteBody):
    """The layered cell at large strain, with pressures as unknowns if it is mixed."""

    mesh: GraphMesh
    law: NeoHookean | J2 | Prony
    mixed: bool

    @property
    def shape(self) -> tuple[int, ...]:  # type: ignore[override]
        """Shape of the displacement."""
        nx, ny, layers = self.mesh.shape
        return nx, layers, 4 if self.mixed else 3, ny

    @property
    def _points(self) -> tuple[int, ...]:
        """Shape of the Gauss points without the lanes."""
        nx, ny, layers = self.mesh.shape
        return nx, layers, -(-ny // BATCH), 8

    @cached_property
    def _tangent(self) -> np.ndarray:
        """Buffer for the tangents of all iterations."""
        rows = ENTRIES + MOTIONS + 1 if self.mixed else ENTRIES
        return np.empty((*self._points[:3], rows * BATCH), dtype=np.float32)

    def _apply(self, v: np.ndarray) -> np.ndarray:
        out = np.zeros_like(v)
        _run_coloured(_apply_tangent, v, self._tangent, v, out)
        return out

    def rest(self) -> State:
        """Return the state before any load, for each batch of elements."""
        rows = self.law.n_state
        return np.zeros((*self._points, rows, BATCH)) if rows else None

    def begin(self, state: Any, time_step: float) -> Respond:
        """Begin a time step; viscous branches add the frozen stress of the previous step."""
        law = self.law
        if isinstance(law, J2):
            hard = Moduli(law.shear_modulus, law.volume_modulus, *law.hardening)
            rows = law.n_state
            return self._step(PLASTIC, hard, state, lambda u: self._update(hard, u, state, rows))
        soft = Moduli(law.shear_modulus, law.volume_modulus)
        if isinstance(law, NeoHookean):
            return self._step(NEO_HOOKEAN, soft, NO_STATE, lambda u: None)
        viscous, branches = law.over(time_step), np.moveaxis(state, -2, 0)

        def finish(u: np.ndarray) -> np.ndarray:
            elastic = law.shear_modulus * self._update(soft, u, NO_STATE, 6)
            new = viscous.advance(branches, np.moveaxis(elastic, -2, 0))
            return np.ascontiguousarray(np.moveaxis(new, 0, -2))

        frozen = np.ascontiguousarray(np.moveaxis(viscous.frozen_stress(branches), 0, -2))
        moduli = soft._replace(shear=viscous.share * law.shear_modulus)
        return self._step(NEO_HOOKEAN, moduli, frozen, finish)

    def _step(
        self, kind: int, moduli: Moduli, state: np.ndarray, finish: Callable[[np.ndarray], State]
    ) -> Respond:
        scale = pressure_scale(self.mesh, self.law.shear_modulus) if self.mixed else 0.0

        def respond(u: np.ndarray) -> BodyResponse:
            force, flags = np.zeros_like(u), np.empty((len(u), 2))
            arguments = self.mesh.arrays, kind, moduli, scale, u, state, force, self._tangent, flags
            _run_coloured(_respond, u, *arguments)
            flowing = float(flags[:, 1].sum()) / (8.0 * np.prod(self.mesh.shape))
            least = float(flags[:, 0].min())
            return BodyResponse(force, self._apply, lambda: finish(u), least, flowing)

        return respond

    def _update(self, moduli: Moduli, u: np.ndarray, state: np.ndarray, rows: int) -> np.ndarray:
        """Return the state at the end of a step, rows of each Gauss point."""
        nx, ny, layers = self.mesh.shape
        new = np.empty((*self._points, rows, BATCH))
        kind = PLASTIC if self.law.flows else NEO_HOOKEAN
        arguments = self.mesh.arrays, kind, moduli, u, state, new
        run_ranges(_update, nx, *arguments, least=-(-LEAST // (layers * ny)))
        return new
