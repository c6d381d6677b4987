r"""Neo-Hookean stress and tangent of a batch, with the frozen stress of viscous branches."""

from multiscale.micro.elastic.hexahedron import BATCH
from multiscale.micro.finite.matrix import FIRST, SECOND, STEP
from multiscale.micro.finite.strain import (
    FLUX,
    GEOMETRY,
    GRADIENT,
    LAW,
    LOG,
    PULLED,
    WEIGHT,
    kernel,
    point_rows,
)

__all__ = ["neo_hookean"]

METRIC = LAW  # 6: R
LATER = METRIC + 6 * BATCH  # 9: columns of X
CURVED = LATER + 9 * BATCH  # 6: M


@kernel
def neo_hookean(s, q, shear, frozen, has_frozen, tangent):  # type: ignore[no-untyped-def]
    r"""Add the flux of one Gauss point and write its tangent, both pulled back.

    With :math:`R = \mu I + S_v`, the frozen second Piola-Kirchhoff stress :math:`S_v` (rows 11, 22,
    33, 12, 23, 13), :math:`g = F^{-T} T^t`, the volumetric Kirchhoff stress :math:`\tau` and its
    derivative :math:`\tau'` by :math:`\ln J`,

    .. math::
        P T^t = F R T^t + (\tau - \mu)\, g, \qquad
        A_{ia,kb} = \delta_{ik} (T R T^t)_{ab} + (\mu - \tau)\, g_{ib} g_{ka} + \tau' g_{ia} g_{kb}.
    """
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
    _tangent(s, weight, shear, tangent)


@kernel
def _tangent(s, weight, shear, tangent):  # type: ignore[no-untyped-def]
    """Write the six blocks of A."""
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
