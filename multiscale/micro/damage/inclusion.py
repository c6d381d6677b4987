r"""Cycles of a weak micro-inclusion in an elastic volume: the kernel of two-scale fatigue.

With :math:`a = (1+\nu)/(3(1-\nu))` and :math:`b = 2(4-5\nu)/(15(1-\nu))` of Eshelby's tensor of a
ball, and an eigenstrain :math:`D \varepsilon^\mu + (1-D) \varepsilon^{p\mu}` in place of damage and
flow, Eshelby and Kröner's localisation of the strain of an elastic volume is

.. math::
    \varepsilon^\mu = \frac{1}{1 - bD} \Big[ \varepsilon
    + \frac{(a-b) D}{3 (1 - aD)}\, \mathrm{tr}(\varepsilon)\, 1
    + b (1-D)\, \varepsilon^{p\mu} \Big], \\
    \tilde s = \frac{s - 2G(1-b)\, \varepsilon^{p\mu}}{1 - bD}, \qquad
    \tilde\sigma_H = \frac{\sigma_H}{1 - aD}.    \tag{1}

The inclusion yields at the fatigue limit with linear kinematic hardening and is damaged beyond a
threshold:

.. math::
    (\tilde s - X)_{eq} \le \sigma_f, \quad
    \dot\varepsilon^{p\mu} = \tfrac32 \frac{\tilde s - X}{\sigma_f}\, \dot p, \quad
    \dot X = \tfrac23 C (1-D)\, \dot\varepsilon^{p\mu}, \quad
    \dot D = (Y/S)^s\, \dot p \;\; (p > p_D).    \tag{2}

With D frozen, the angle :math:`\theta` of :math:`\tilde s - X` on the yield surface to a straight
path, in the metric of Mises, changes in a step :math:`A = (\Delta s)_{eq} / (1 - bD)` as in the
perfectly plastic solid of [1]_:

.. math::
    \tan\tfrac{\theta_1}{2} = e^{-A/\sigma_f} \tan\tfrac{\theta_0}{2}, \qquad
    K\, \Delta p = A + \sigma_f \ln \frac{1 + \cos\theta_0}{1 + \cos\theta_1}, \qquad
    K = \frac{3G(1-b)}{1 - bD} + C (1-D).    \tag{3}

With the factor :math:`h` of crack closure

.. math::
    Y = \frac{1+\nu}{2E} \Big[ \langle\tilde\sigma\rangle_+^2
    + h k\, \langle\tilde\sigma\rangle_-^2 \Big]
    - \frac{\nu}{2E} \Big[ \langle \mathrm{tr}\,\tilde\sigma \rangle_+^2
    + h k\, \langle -\mathrm{tr}\,\tilde\sigma \rangle_+^2 \Big], \quad
    k = \Big(\frac{1-D}{1-hD}\Big)^2 .    \tag{4}

.. [1] R. D. Krieg and D. B. Krieg, J. Pressure Vessel Technol. 99 (1977) 510-515,
   doi:10.1115/1.3454568.
"""

import numpy as np

from multiscale.numerics.compiled import compiled

# places of the parameters in the array of a material, as the fields of FatigueMaterial
E, NU, LIMIT, STRENGTH, EXPONENT, HARDENING, THRESHOLD, CRITICAL, CLOSURE, FEEDBACK = range(10)


@compiled
def run_cycles(state, path, cycles, material, substeps):  # type: ignore[no-untyped-def]
    """Follow a closed stress path for a number of cycles."""
    points = len(path)
    for cycle in range(cycles):
        p = state[1]
        for k in range(points):
            share = _follow_segment(state, path[k], material, substeps)
            if state[0] >= material[CRITICAL]:
                return cycle + (k + share) / points, False
        if state[1] == p and (cycle > 0 or cycles == 1):
            return cycle + 1.0, True
    return float(cycles), False


@compiled
def run_points(state, path, path_of, cycles, material, kind_of, substeps):  # type: ignore[no-untyped-def]
    """Follow the paths of many inclusions: cycles done, and whether the last was elastic."""
    done, elastic = np.empty(len(state)), np.empty(len(state), dtype=np.bool_)
    for k in range(len(state)):
        corners, kind = path[path_of[k]], material[kind_of[k]]
        done[k], elastic[k] = run_cycles(state[k], corners, cycles, kind, substeps)
    return done, elastic


@compiled
def _mean(s):  # type: ignore[no-untyped-def]
    """Mean normal stress; with the sum of NumPy, numba would load scipy.linalg."""
    return (s[0] + s[1] + s[2]) / 3.0


@compiled
def _equivalent(s):  # type: ignore[no-untyped-def]
    direct = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
    return np.sqrt(1.5 * (direct + 2.0 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5])))


@compiled
def _follow_segment(state, target, material, substeps):  # type: ignore[no-untyped-def]
    """Follow a straight stress path; return the share at which damage becomes critical, or 1."""
    nu, limit = material[NU], material[LIMIT]
    shear = material[E] / (2.0 * (1.0 + nu))
    b = 2.0 * (4.0 - 5.0 * nu) / (15.0 * (1.0 - nu))
    start = state[14:].copy()
    xi, change, middle, flow = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    mean, mean_change = _mean(start), _mean(target) - _mean(start)
    loss = 1.0 - b * state[0] * material[FEEDBACK]
    for i in range(6):
        hydro, hydro_change = (mean, mean_change) if i < 3 else (0.0, 0.0)
        xi[i] = (start[i] - hydro - 2.0 * shear * (1.0 - b) * state[2 + i]) / loss - state[8 + i]
        change[i] = (target[i] - start[i] - hydro_change) / loss
    if _equivalent(xi + change) <= limit * (1.0 + 1e-14):
        for i in range(6):  # a slice would have the compiler write its error message
            state[14 + i] = target[i]
        return 1.0
    # elastic share of the step
    begin = _elastic_share(xi, change, limit)
    # deviator and mean of the effective stress where the step starts, for the energy
    old = np.empty(6)
    effective_stress(state, start, target, begin, material, shear, b, old)
    new = np.empty(6)
    # plastic substeps, with D frozen in each
    for step in range(substeps):
        t = begin + (1.0 - begin) * (step + 1.0) / substeps
        feedback = state[0] * material[FEEDBACK]
        effective_stress(state, start, target, t, material, shear, b, new)
        mean, mean_change = _mean(old), _mean(new) - _mean(old)
        for i in range(6):
            xi[i] = old[i] - (mean if i < 3 else 0.0) - state[8 + i]
            change[i] = new[i] - old[i] - (mean_change if i < 3 else 0.0)
        if _equivalent(xi + change) > limit:
            K = 3.0 * shear * (1.0 - b) / (1.0 - b * feedback)
            K += material[HARDENING] * (1.0 - feedback)
            dp = _plastic_step(xi, change, limit, K, flow)
            for i in range(6):
                state[2 + i] += flow[i]
                state[8 + i] += 2.0 / 3.0 * material[HARDENING] * (1.0 - feedback) * flow[i]
                new[i] -= 2.0 * shear * (1.0 - b) / (1.0 - b * feedback) * flow[i]
            share = _add_damage(state, dp, old, middle, new, material)
            if state[0] >= material[CRITICAL]:
                return begin + (1.0 - begin) * (step + share) / substeps
        for i in range(6):
            old[i] = new[i]
    for i in range(6):
        state[14 + i] = target[i]
    return 1.0


@compiled
def _elastic_share(xi, change, limit):  # type: ignore[no-untyped-def]
    """Compute the elastic share t of a step, with |xi + t change| = limit at its end."""
    A, B = _equivalent(change) ** 2, _product(xi, change)
    gap = (limit - _equivalent(xi)) * (limit + _equivalent(xi))
    if not (A > 0.0 and (gap > 0.0 or B < 0.0)):
        return 0.0
    root = np.sqrt(max(B * B + A * max(gap, 0.0), 0.0))
    begin = gap / (B + root) if B > 0.0 else (root - B) / A
    return min(max(begin, 0.0), 1.0)


@compiled
def _add_damage(state, dp, old, middle, new, material):  # type: ignore[no-untyped-def]
    """Add a plastic step and its damage (2) by Simpson's rule; return the share until critical."""
    before = state[1]
    state[1] += dp
    active = min(dp, state[1] - material[THRESHOLD])
    if not active > 0.0:
        return 1.0
    for i in range(6):
        middle[i] = 0.5 * (old[i] + new[i])
    rate = damage_rate(old, state[0], material) + 4.0 * damage_rate(middle, state[0], material)
    rate = (rate + damage_rate(new, state[0], material)) / 6.0
    damage = rate * active
    if not state[0] + damage >= material[CRITICAL]:
        state[0] += damage
        return 1.0
    left = (material[CRITICAL] - state[0]) / damage
    state[0] = material[CRITICAL]
    return (state[1] - active + left * active - before) / dp


@compiled
def _plastic_step(xi, change, limit, K, flow):  # type: ignore[no-untyped-def]
    """Solve a step (3) from the yield surface: return its strain p, write its tensor to flow."""
    size = _equivalent(xi)
    if size > 0.0:  # rounding and damage have moved it off the yield surface
        change += (1.0 - limit / size) * xi
        xi *= limit / size
    A = _equivalent(change)
    start = max(_product(xi, change) / (limit * A), -1.0 + 1e-12)
    fade = np.exp(-A / limit)
    half = fade * fade * (1.0 - start) / (1.0 + start)  # square of the tangent
    end = (1.0 - half) / (1.0 + half)
    left = fade * (1.0 + end) / (1.0 + start)
    for i in range(6):
        ahead = limit * change[i] / A
        moved = end * ahead + left * (xi[i] - start * ahead) - xi[i]
        flow[i] = 1.5 / K * (change[i] - moved)
    return (A + limit * np.log((1.0 + start) / (1.0 + end))) / K


@compiled
def _product(x, y):  # type: ignore[no-untyped-def]
    direct = x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
    return 1.5 * (direct + 2.0 * (x[3] * y[3] + x[4] * y[4] + x[5] * y[5]))


@compiled
def effective_stress(state, start, target, t, material, shear, b, out):  # type: ignore[no-untyped-def]
    """Write the effective stress (1), Pa, at the share t of a straight path into ``out``."""
    nu, D = material[NU], state[0] * material[FEEDBACK]
    a = (1.0 + nu) / (3.0 * (1.0 - nu))
    for i in range(6):
        out[i] = start[i] + t * (target[i] - start[i])
    mean = _mean(out)
    for i in range(6):
        deviator = out[i] - (mean if i < 3 else 0.0)
        out[i] = (deviator - 2.0 * shear * (1.0 - b) * state[2 + i]) / (1.0 - b * D)
        if i < 3:
            out[i] += mean / (1.0 - a * D)


@compiled
def damage_rate(stress, damage, material):  # type: ignore[no-untyped-def]
    """Damage (Y / S)^s per unit of strain p, with the energy (4) of an effective stress, Pa."""
    young, nu, h = material[E], material[NU], material[CLOSURE]
    trace = stress[0] + stress[1] + stress[2]
    if h == 1.0:
        direct = stress[0] ** 2 + stress[1] ** 2 + stress[2] ** 2
        total = direct + 2.0 * (stress[3] ** 2 + stress[4] ** 2 + stress[5] ** 2)
        energy = ((1.0 + nu) * total - nu * trace * trace) / (2.0 * young)
    else:
        closed = h * ((1.0 - damage) / (1.0 - h * damage)) ** 2
        total = 0.0
        for value in _principal(stress):
            total += value * value * (1.0 if value > 0.0 else closed)
        volume = trace * trace * (1.0 if trace > 0.0 else closed)
        energy = ((1.0 + nu) * total - nu * volume) / (2.0 * young)
    return (max(energy, 0.0) / material[STRENGTH]) ** material[EXPONENT]


@compiled
def _principal(s):  # type: ignore[no-untyped-def]
    mean = _mean(s)
    x, y, z = s[0] - mean, s[1] - mean, s[2] - mean
    second = 0.5 * (x * x + y * y + z * z) + s[3] ** 2 + s[4] ** 2 + s[5] ** 2
    if second <= 1e-30 * mean * mean or second == 0.0:
        return mean, mean, mean
    third = x * (y * z - s[3] ** 2) - s[5] * (s[5] * z - s[3] * s[4])
    third += s[4] * (s[5] * s[3] - y * s[4])
    size = np.sqrt(second / 3.0)
    angle = np.arccos(min(max(0.5 * third / size**3, -1.0), 1.0)) / 3.0
    first = mean + 2.0 * size * np.cos(angle)
    last = mean + 2.0 * size * np.cos(angle + 2.0 * np.pi / 3.0)
    return first, 3.0 * mean - first - last, last
