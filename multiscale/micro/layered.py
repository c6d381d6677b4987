r"""Surface compliance of a layered elastic body on a clamped base, exact for every wave.

In a layer, the displacement :math:`u_x = U \sin qx`, :math:`u_z = W \cos qx` solves Navier's
equations if, with :math:`\zeta = q z`, :math:`s = \pm 1` and :math:`\kappa = 3 - 4\nu`,

.. math::
    W &= (a + b\zeta)\, e^{s\zeta}, \qquad
    U = -(s a + \kappa b + s b \zeta)\, e^{s\zeta},    \tag{1} \\
    \sigma_{zz} &= 2 \mu q \left(s (a + b\zeta) + (1 - 2\nu) b\right) e^{s\zeta} \cos qx, \qquad
    \sigma_{xz} = -2 \mu q \left(a + b\zeta + 2 s (1 - \nu) b\right) e^{s\zeta} \sin qx.  \tag{2}
"""

import numpy as np

__all__ = ["layered_compliance"]

_DEEP = 24.0  # thickness times wavenumber from which a layer is a half-space to rounding


def layered_compliance(
    shape: tuple[int, int],
    size: tuple[float, float],
    planes: np.ndarray,
    lame: np.ndarray,
    shear: np.ndarray,
) -> np.ndarray:
    r"""Return the normal displacement of the surface under unit pressure, by wavenumber.

    Examples
    --------
    >>> planes, one = np.array([0.0, 50.0]), np.array([1.0])
    >>> symbol = layered_compliance((4, 4), (1.0, 1.0), planes, one, one)  # nu = 1/4
    >>> round(float(symbol[1, 0] * np.pi * 1.0 / (1.0 - 0.25**2)), 6)  # 2 / (E* q), E = 2.5
    0.4
    """
    q_x = 2.0 * np.pi / size[0] * np.abs(np.fft.fftfreq(shape[0], 1.0 / shape[0]))
    q_y = 2.0 * np.pi / size[1] * np.arange(shape[1] // 2 + 1)
    waves = np.hypot(q_x[:, None], q_y)
    layers: list[list[float]] = []  # thickness and moduli, with equal neighbours joined
    for h, first, second in zip(np.diff(planes), lame, shear, strict=True):
        if layers and layers[-1][1:] == [first, second]:
            layers[-1][0] += h
        else:
            layers.append([h, first, second])
    h, first, second = layers[-1]
    shallow = h * waves < _DEEP
    with np.errstate(divide="ignore"):  # the mean is replaced
        compliance = (first + 2.0 * second) / (2.0 * second * (first + second)) / waves
    wavenumber, place = np.unique(waves[shallow], return_inverse=True)

    symbol = np.empty_like(wavenumber)
    symbol[0] = sum(h / (first + 2.0 * second) for h, first, second in layers)  # q = 0
    q = wavenumber[1:]
    below = np.full((q.size, 2, 2), np.inf)
    for h, first, second in layers:
        stiffness = _layer_stiffness(q, h, first, second)
        low, up = slice(0, 2), slice(2, 4)
        if np.isinf(below).all():  # the base is clamped
            below = stiffness[:, up, up]
        else:
            carried = np.linalg.solve(stiffness[:, low, low] + below, stiffness[:, low, up])
            below = stiffness[:, up, up] - stiffness[:, up, low] @ carried
    symbol[1:] = np.linalg.inv(below)[:, 1, 1]
    compliance[shallow] = symbol[place]
    return np.asarray(compliance)


def _layer_stiffness(q: np.ndarray, thickness: float, lame: float, shear: float) -> np.ndarray:
    """Stresses on the lower and upper face by (U, W) of both, shape (waves, 4, 4), Pa/m."""
    nu = 0.5 * lame / (lame + shear)
    kappa = 3.0 - 4.0 * nu
    depth = q * thickness
    motion, stress = np.zeros((2, q.size, 4, 4))
    for face, zeta in enumerate((np.zeros_like(q), depth)):
        for side, s in enumerate((1.0, -1.0)):
            # each pair of waves starts from the face where it is largest
            from_there = zeta - depth if s > 0.0 else zeta
            wave = np.exp(s * from_there)
            for term in range(2):  # a and b of (1) and (2)
                column = 2 * side + term
                value = from_there if term else np.ones_like(q)
                b = float(term)
                motion[:, 2 * face, column] = -(s * value + kappa * b) * wave
                motion[:, 2 * face + 1, column] = value * wave
                outward = (2.0 * face - 1.0) * 2.0 * shear * q * wave
                shear_stress = value + 2.0 * s * (1.0 - nu) * b
                stress[:, 2 * face, column] = -outward * shear_stress
                stress[:, 2 * face + 1, column] = outward * (s * value + (1.0 - 2.0 * nu) * b)
    return np.asarray(np.linalg.solve(motion.swapaxes(1, 2), stress.swapaxes(1, 2)).swapaxes(1, 2))
