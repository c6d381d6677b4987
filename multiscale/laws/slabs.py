"""Kernels of the bed of sliders: equations (a) to (d) of :class:`Sliders`, point by point.

``edges``, shape (3, slabs), holds gap, pressure and stiffness at the upper edge of every slab on
the elastic curve. ``start`` and ``end`` of a step, shape (5, 1, points), hold gap, pressure and
stiffness of every point on this curve, and the scales of force and length. For springs without a
common curve, such as asperities, they hold load and stiffness of every spring and the derivatives
of both by the gap, shape (4, springs, points); there are no edges, and the slope is not used.
"""

from typing import Any

import numpy as np

from multiscale.executors import run_ranges
from multiscale.numerics.compiled import compiled

LEAST_DIVISOR = 1e-300

ROUNDING_CHANGE = 1e-5
"""Change of the gap, relative to pressure over stiffness, below which the change of the load of a
slab is rounding."""

LEAST = 20_000  # least entries of states per thread

MAX_ITERATIONS, MAX_HALVINGS, TOLERANCE = 100, 40, 1e-13
"""Iteration and halving limits of Newton's method, and its residual relative to all forces."""


@compiled
def _slab(i, place, c, edges):  # type: ignore[no-untyped-def]
    """Return load and stiffness (a) of slab i at point c."""
    if edges.shape[1] == 0:
        return place[0, i, c], place[1, i, c]
    gap, upper = place[0, 0, c], edges[0, i]
    if gap >= upper:
        return 0.0, 0.0
    h, p, K = gap, place[1, 0, c], place[2, 0, c]
    if i > 0 and gap < edges[0, i - 1]:
        h, p, K = edges[0, i - 1], edges[1, i - 1], edges[2, i - 1]
    w = max(K - edges[2, i], 0.0)
    N = p - edges[1, i] - edges[2, i] * (upper - h) + w * (h - gap)  # (a)
    N = min(max(N, w * (h - gap)), w * (upper - gap))  # bounds violated by rounding only
    return place[3, 0, c] * N, place[3, 0, c] / place[4, 0, c] * w


@compiled
def _step(i, c, start, end, loaded, edges):  # type: ignore[no-untyped-def]
    """Return load and stiffness at the end, w1/l0 and m of (b), and dm/dw (0 for the quotient)."""
    N0, w0 = _slab(i, start, c, edges)
    N, w = _slab(i, end, c, edges)
    keep = w / loaded if loaded > w else 1.0
    if edges.shape[1] == 0:
        return N, w, keep, min(0.5 * (w0 + w), w), 0.5 if w0 < w else 1.0
    fall = (start[0, 0, c] - end[0, 0, c]) * end[4, 0, c]
    flows = start[3, 0, c] != end[3, 0, c]
    if flows or abs(start[0, 0, c] - end[0, 0, c]) * end[2, 0, c] <= ROUNDING_CHANGE * end[1, 0, c]:
        return N, w, keep, min(0.5 * (w0 + w), w), 0.5 if w0 < w else 1.0
    if fall <= 0.0:
        return N, w, keep, w, 1.0
    return N, w, keep, min(max((N - N0) / fall, min(w0, w)), w), 0.0


def respond_slabs(
    jump: np.ndarray, state: np.ndarray, *arguments: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return tangential traction, tangent, new state and energies of a step, (a) to (d)."""
    points = jump.shape[1]
    traction, tangent = np.empty((2, points)), np.empty((2, 3, points))
    new, account = np.empty(state.shape), np.empty((4, points))
    results = traction, tangent, new, account
    run_ranges(_respond, points, jump, state, *arguments, *results, least=_least(state))
    return results


def _least(state: np.ndarray) -> int:
    return -(-LEAST // len(state))


@compiled
def _respond(  # type: ignore[no-untyped-def]
    begin, finish, jump, state, start, end, slope, edges, friction, kappa, creep,
    traction, tangent, new, account,
):  # fmt: skip
    slabs = (state.shape[0] - 3) // 3
    for c in range(begin, finish):
        x = jump[1, c] - state[3 * slabs + 1, c]
        y = jump[2, c] - state[3 * slabs + 2, c]
        tx = ty = d_xn = d_yn = d_xx = d_xy = d_yy = stored = left = load = slipping = 0.0
        for i in range(slabs):
            # force A and stiffness l of the committed state, load and stiffness of the slab
            a, b, l0 = state[i, c], state[slabs + i, c], state[2 * slabs + i, c]
            stored += (a * a + b * b) / l0 if l0 > 0.0 else 0.0
            N, w, keep, m, m_by_w = _step(i, c, start, end, l0, edges)
            if w == 0.0:  # open
                new[i, c] = new[slabs + i, c] = new[2 * slabs + i, c] = 0.0
                continue
            # derivatives of load, stiffness and m by the gap
            if edges.shape[1] == 0:
                dN, dw = end[2, i, c], end[3, i, c]
                dm = m_by_w * dw
            else:
                inside = i == 0 or end[0, 0, c] >= edges[0, i - 1]
                dw = w * slope[2, c] + (slope[0, c] if inside else 0.0)
                dN = N * slope[1, c] if slope[1, c] != 0.0 else -w
                fall = (start[0, 0, c] - end[0, 0, c]) * end[4, 0, c]
                dm = m_by_w * dw if m_by_w > 0.0 else (dN + m) / fall
            lost = dw / l0 if l0 > w else 0.0
            # derivative of the trial force by the gap
            fx, fy = lost * a + dm * x, lost * b + dm * y
            # trial force, and its projection onto the friction limit
            a, b = keep * a, keep * b
            before = a * a + b * b
            moment = 2.0 * (a * x + b * y) + m * (x * x + y * y)
            a, b = a + m * x, b + m * y  # (c)
            size, cap = np.sqrt(a * a + b * b), friction * N / kappa
            if size > cap:
                share, nx, ny = cap / size, a / size, b / size
                jx, jy, jo = share * ny * ny, share * nx * nx, -share * nx * ny
                d_xn, d_yn = d_xn + friction * dN * nx, d_yn + friction * dN * ny
                a, b, carries = share * a, share * b, w
            else:
                jx, jy, jo, carries = 1.0, 1.0, 0.0, min(l0, w)
                if size > 0.0:  # (d)
                    moment += before / carries if carries > 0.0 else 0.0
                    carries = min(max(size * size / max(moment, LEAST_DIVISOR), carries), w)
            d_xn, d_yn = d_xn + kappa * (jx * fx + jo * fy), d_yn + kappa * (jo * fx + jy * fy)
            d_xx, d_xy, d_yy = d_xx + kappa * m * jx, d_xy + kappa * m * jo, d_yy + kappa * m * jy
            left += (a * a + b * b) / carries if carries > 0.0 else 0.0
            tx, ty, load = tx + kappa * a, ty + kappa * b, load + N
            slipping += N if size > (1.0 + creep) * cap else 0.0
            new[i, c], new[slabs + i, c], new[2 * slabs + i, c] = a, b, carries
        new[3 * slabs :, c] = jump[:, c]
        traction[0, c], traction[1, c] = tx, ty
        tangent[0, 0, c], tangent[0, 1, c], tangent[0, 2, c] = d_xn, d_xx, d_xy
        tangent[1, 0, c], tangent[1, 1, c], tangent[1, 2, c] = d_yn, d_xy, d_yy
        account[0, c], account[1, c] = tx * x + ty * y, 0.5 * kappa * stored
        account[2, c], account[3, c] = 0.5 * kappa * left, slipping / max(load, LEAST_DIVISOR)


@compiled
def _forces(force, m, cap, k, x, y):  # type: ignore[no-untyped-def]
    """Return traction (c) at a change of the jump, and the tangent of traction and direction."""
    tx = ty = h_xy = 0.0
    h_xx, h_yy = k[0], k[1]
    for i in range(m.size):
        a, b = force[0, i] + m[i] * x, force[1, i] + m[i] * y
        size = np.sqrt(a * a + b * b)
        if size > cap[i]:
            h, nx, ny = m[i] * cap[i] / size, a / size, b / size
            tx, ty = tx + cap[i] * nx, ty + cap[i] * ny
            h_xx, h_yy, h_xy = h_xx + h * ny * ny, h_yy + h * nx * nx, h_xy - h * nx * ny
        else:
            tx, ty, h_xx, h_yy = tx + a, ty + b, h_xx + m[i], h_yy + m[i]
    return tx, ty, h_xx, h_yy, h_xy


def resolve(
    source: np.ndarray, k: np.ndarray, state: np.ndarray, *arguments: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Solve (c) + k x = 0 by Newton's method: tangential jump, and the points that failed."""
    points = source.shape[1]
    jump, failed = np.empty((2, points)), np.zeros(points, dtype=np.bool_)
    results = jump, failed
    run_ranges(_resolve, points, source, k, state, *arguments, *results, least=_least(state))
    return results


@compiled
def _resolve(  # type: ignore[no-untyped-def]
    begin, finish, source, k, state, start, end, edges, friction, kappa, jump, failed
):
    slabs = (state.shape[0] - 3) // 3
    for c in range(begin, finish):
        force, m, cap, kc = np.empty((2, slabs)), np.empty(slabs), np.empty(slabs), k[1:, c].copy()
        stiffness = size = 0.0
        last_x, last_y = state[3 * slabs + 1, c], state[3 * slabs + 2, c]
        bx, by = source[1, c] - kc[0] * last_x, source[2, c] - kc[1] * last_y
        x, y = bx, by
        for i in range(slabs):
            N, _, keep, m[i], _ = _step(i, c, start, end, state[2 * slabs + i, c], edges)
            cap[i], m[i] = friction * N, kappa * m[i]
            for row in range(2):
                force[row, i] = kappa * keep * state[row * slabs + i, c]
            stiffness += m[i]
            size += cap[i] + abs(force[0, i]) + abs(force[1, i])
            x, y = x - force[0, i], y - force[1, i]
        x, y = x / (kc[0] + stiffness), y / (kc[1] + stiffness)
        tx, ty, h_xx, h_yy, h_xy = _forces(force, m, cap, kc, x, y)
        failed[c] = True
        for _ in range(MAX_ITERATIONS):
            fx, fy = tx + kc[0] * x - bx, ty + kc[1] * y - by
            small_x = abs(fx) <= TOLERANCE * (size + abs(bx) + abs(kc[0] * x))
            if small_x and abs(fy) <= TOLERANCE * (size + abs(by) + abs(kc[1] * y)):
                failed[c] = False
                break
            det = h_xx * h_yy - h_xy * h_xy
            dx, dy = (h_xy * fy - h_yy * fx) / det, (h_xy * fx - h_xx * fy) / det
            slope, s = dx * fx + dy * fy, 1.0
            for _ in range(MAX_HALVINGS):
                u, v = x + s * dx, y + s * dy
                tx, ty, h_xx, h_yy, h_xy = _forces(force, m, cap, kc, u, v)
                after = dx * (tx + kc[0] * u - bx) + dy * (ty + kc[1] * v - by)
                if after <= -0.5 * slope:
                    break
                s *= 0.5
            x, y = u, v
        # the form with the smaller rounding error
        jump[0, c] = (source[1, c] - tx) / kc[0] if kc[0] > stiffness else last_x + x
        jump[1, c] = (source[2, c] - ty) / kc[1] if kc[1] > stiffness else last_y + y


def asperity_loads(gap: np.ndarray, peak: np.ndarray, *arguments: Any) -> np.ndarray:
    """Load and stiffness of classes on their unloading curves, and derivatives by the gap."""
    place = np.zeros((4, arguments[1].size, gap.size))
    run_ranges(_unload, gap.size, gap, peak, *arguments, place, least=_least(place[0]))
    return place


@compiled
def _unload(begin, end, gap, peak, yields, height, density, grid, ratios, hertz, place):  # type: ignore[no-untyped-def]
    classes, top = height.size, height.max()
    for c in range(begin, end):
        loads = yields and top - gap[c] > peak[c]
        for i in range(classes):
            d = height[i] - gap[c]
            most = d if loads else max(peak[c] - (top - height[i]), 0.0)
            ratio, slope = 1.0, 0.0
            t = (np.log(most) - grid[0]) / grid[1] if most > 0.0 else -1.0
            if t >= ratios.shape[1]:
                x, j = grid[1], ratios.shape[1] - 1
                ratio = ratios[3, j] + x * (ratios[2, j] + x * (ratios[1, j] + x * ratios[0, j]))
            elif t > 0.0:
                j = int(t)
                x = (t - j) * grid[1]
                ratio = ratios[3, j] + x * (ratios[2, j] + x * (ratios[1, j] + x * ratios[0, j]))
                slope = ratios[2, j] + x * (2.0 * ratios[1, j] + x * 3.0 * ratios[0, j])
            e = d - most * (1.0 - ratio)
            if e <= 0.0:
                continue
            load = density[i] * hertz / np.sqrt(ratio) * e * np.sqrt(e)  # (2)
            stiffness = 1.5 * load / e
            place[0, i, c], place[1, i, c] = load, stiffness
            if loads:
                place[2, i, c] = -load / d * (1.5 + slope / ratio)
                place[3, i, c] = -0.5 * stiffness / d
            else:
                place[2, i, c], place[3, i, c] = -stiffness, -0.5 * stiffness / e
