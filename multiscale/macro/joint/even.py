"""A joint under even pressure, which is two blocks and a law in series."""

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from multiscale.laws import HystereticLaw, NormalLaw
from multiscale.macro.data_range import data_ends, load_shares
from multiscale.macro.joint.geometry import RoughJoint
from multiscale.macro.joint.joint_solver import check_preloads, joint_result, ratios, rough_joint
from multiscale.schema import Dataset

__all__ = ["press_joint"]

TOLERANCE = 1e-8
"""Error of the pressure at the gap that a law was inverted to, relative to the preload."""


def press_joint(
    joint: RoughJoint,
    law: NormalLaw | HystereticLaw,
    preloads: np.ndarray,
    *,
    samples: Sequence[NormalLaw | HystereticLaw] = (),
    extrapolate: bool = False,
) -> Dataset:
    r"""Press the joint, in closed form where its pressure is even; see :func:`rough_joint`.

    Parameters
    ----------
    joint, law, preloads, samples, extrapolate
        As for :func:`rough_joint`, which solves what has an eccentric force.

    Returns
    -------
    Dataset, as :func:`rough_joint` gives it

    Raises
    ------
    CaseError
        If a preload is not positive.

    Notes
    -----
    Between guided platens without friction, and without friction in the interface, an even
    pressure p and uniaxial stress satisfy all equations, and a pressure that falls with the gap
    allows no other solution. With the heights :math:`h_i` and moduli :math:`E_i` of the blocks
    along z (of an anisotropic block :math:`1/S_{zzzz}`), the initial gap :math:`g_0`, and gap
    :math:`g(p)` and stiffness :math:`K(p)` of the law,

    .. math::
        \frac1k = \frac1{K(p)} + \frac{h_1}{E_1} + \frac{h_2}{E_2}, \qquad
        a = p \Big(\frac{h_1}{E_1} + \frac{h_2}{E_2}\Big) - (g(p) - g_0).    \tag{1}
    """
    if joint.eccentricity is not None:
        return rough_joint(joint, law, preloads, samples=samples, extrapolate=extrapolate)
    begin = perf_counter()
    p = check_preloads(preloads)
    soft = joint.lower.compliance + joint.upper.compliance  # m/Pa
    normal = _loading(law)
    gap = normal.gap_at(p)
    residual = np.abs(normal.pressure(gap) / p - 1.0)
    good = residual <= TOLERANCE
    measured = {
        **_stiffness(law, p, soft),
        "approach": p * soft - (gap - normal.gap),
        "mean_gap": gap,
        "closed_fraction": np.ones(p.size),
    }
    values = {
        "preload": p,
        **{name: np.where(good, value, np.nan) for name, value in measured.items()},
        "converged": good.astype(int),
        "residual": residual,
        "wall_time": np.full(p.size, (perf_counter() - begin) / p.size),
    }
    rows = [_stiffness(sample, p, soft) for sample in samples]
    data = data_ends(law)
    shares = load_shares(p[:, None], np.ones(1), data)
    return joint_result(values, rows, 1.0 / soft, shares, data, extrapolate=extrapolate)


def _loading(law: NormalLaw | HystereticLaw) -> NormalLaw:
    """Law of the first loading."""
    return law.loading if isinstance(law, HystereticLaw) else law


def _stiffness(law: NormalLaw | HystereticLaw, p: np.ndarray, soft: float) -> dict[str, np.ndarray]:
    """Stiffness of the interface, and (1) on every branch of its law, Pa/m."""
    normal = _loading(law)
    K = normal.stiffness(normal.gap_at(p))
    branches = {name: 1.0 / (1.0 / (ratio * K) + soft) for name, ratio in ratios(law).items()}
    return {"interface_stiffness": K, **branches}
