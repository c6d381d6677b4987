"""Conjugate projected gradient (CPG) in the MPRGP form, for symmetric problems."""

from collections.abc import Iterator

import numpy as np

from multiscale.nonsmooth.lcp_problem import ScaledLCP
from multiscale.nonsmooth.spectrum import largest_eigenvalue
from multiscale.numerics.compiled import compiled

__all__ = ["iterate_projected_gradient"]

STEPS = 10
"""Gradient steps from one iterate to the next."""

FLAT = 1e-14
"""Curvature, relative to the largest one, below which a direction counts as straight."""


def iterate_projected_gradient(problem: ScaledLCP, start: np.ndarray) -> Iterator[np.ndarray]:
    r"""Yield x after every ten steps of modified proportioning with reduced gradient projections.

    With the gradient :math:`g = A x + b`, the free gradient :math:`\varphi` (g where x > 0) and
    the chopped gradient :math:`\beta` (the negative part of g where x = 0), a step is

    - a conjugate gradient step on the free unknowns if :math:`\|\beta\|^2 \le
      \tilde\varphi^T \varphi` and the step keeps :math:`x \ge 0`;
    - the part of it that does, then a gradient step of fixed length with projection, if not;
    - a step along :math:`\beta`, which frees unknowns, if the first condition fails.

    :math:`\tilde\varphi_i = \min(x_i / \bar\alpha, \varphi_i)` is the reduced free gradient.

    The last iterate lies far out on a ray along which the energy falls for ever, if there is one.

    References
    ----------
    .. [1] Z. Dostál and J. Schöberl, Comput. Optim. Appl. 30 (2005) 23-43,
       doi:10.1007/s10589-005-4557-7.
    """
    rows = problem.entries.rows
    largest = largest_eigenvalue(problem.entries.matrix)
    x, direction, carried = start.copy(), np.zeros_like(start), False
    while True:
        ray = _advance(
            rows.data, rows.indices, rows.indptr, problem.vector, largest, x, direction, carried
        )
        yield x.copy()
        if ray:
            return
        carried = True


@compiled
def _multiply(data, indices, indptr, x, out):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        total = 0.0
        for entry in range(indptr[i], indptr[i + 1]):
            total += data[entry] * x[indices[entry]]
        out[i] = total


@compiled(fastmath={"reassoc", "contract"})
def _dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product; the threads that BLAS would start for it cost more than they bring."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@compiled
def _free(x, gradient, out):  # type: ignore[no-untyped-def]
    """Write the free gradient to out."""
    for i in range(x.size):
        out[i] = gradient[i] if x[i] > 0.0 else 0.0


@compiled
def _advance(data, indices, indptr, vector, largest, x, p, carried):  # type: ignore[no-untyped-def]
    """Change x and the direction p by STEPS steps; return whether they end on a ray."""
    n = x.size
    fixed_step = 1.8 / largest
    g, image = np.empty(n), np.empty(n)
    _multiply(data, indices, indptr, x, g)
    g += vector
    if not carried:
        _free(x, g, p)

    for _ in range(STEPS):
        chopped, reduced = 0.0, 0.0
        for i in range(n):
            if x[i] > 0.0:
                reduced += min(x[i] / fixed_step, g[i]) * g[i]
            else:
                chopped += min(g[i], 0.0) ** 2
        proportional = chopped <= reduced
        if not proportional:
            for i in range(n):
                p[i] = min(g[i], 0.0) if x[i] <= 0.0 else 0.0
        size = _dot(p, p)
        if size == 0.0:
            _free(x, g, p)
            size = _dot(p, p)
            if size == 0.0:
                return False
        _multiply(data, indices, indptr, p, image)
        curvature = _dot(p, image)
        feasible = np.inf  # the longest step that keeps x >= 0
        for i in range(n):
            if p[i] > 0.0:
                feasible = min(feasible, x[i] / p[i])
        step = _dot(g, p) / curvature if curvature > FLAT * largest * size else np.inf
        if step == np.inf and feasible == np.inf:
            x -= 1e12 / np.sqrt(size) * p
            return True

        if step <= feasible:
            x -= step * p
            g -= step * image
            if proportional:
                turn = 0.0
                for i in range(n):
                    if x[i] > 0.0:
                        turn += g[i] * image[i]
                for i in range(n):
                    p[i] = (g[i] if x[i] > 0.0 else 0.0) - turn / curvature * p[i]
            else:
                _free(x, g, p)
        else:
            for i in range(n):
                x[i] = max(0.0, x[i] - feasible * p[i])
                g[i] -= feasible * image[i]
            for i in range(n):
                if x[i] > 0.0:
                    x[i] = max(0.0, x[i] - fixed_step * g[i])
            _multiply(data, indices, indptr, x, g)
            g += vector
            _free(x, g, p)
    return False
