"""Two elastic blocks pressed together through a rough interface, under uniform pressure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.laws.interface_law import GapLaw
from multiscale.macro.data_range import data_ends, load_shares, with_load_shares
from multiscale.schema import MACRO_RESULT, Dataset

TOLERANCE = 1e-8  # error of the pressure at the gap of an inverted law, relative to the preload


@dataclass(frozen=True)
class Block:
    """Elastic block of a joint.

    Parameters
    ----------
    height : float, height, m
    youngs_modulus : float, Pa
    poissons_ratio : float, dimensionless
    effective : AnisotropicElastic, optional
        Elasticity of the block with cavities or cracks, in place of its moduli; see :func:`soften`.
    """

    height: float
    youngs_modulus: float
    poissons_ratio: float
    effective: AnisotropicElastic | None = None

    @property
    def law(self) -> Elastic | AnisotropicElastic:
        """Elasticity of the block."""
        return self.effective or Elastic(self.youngs_modulus, self.poissons_ratio)

    @property
    def shear_compliance(self) -> float:
        """Displacement under a uniform shear along its face without bending, m/Pa: h/G."""
        return 2.0 * (1.0 + self.poissons_ratio) * self.height / self.youngs_modulus

    @property
    def compliance(self) -> float:
        """Shortening under a uniform pressure along z and no other stress, m/Pa."""
        if self.effective is None:
            return self.height / self.youngs_modulus
        return self.height * float(np.linalg.inv(self.effective.stiffness)[2, 2])

    def __post_init__(self) -> None:
        require("height of a block", self.height, "(0, inf]", "m")
        require("youngs_modulus of a block", self.youngs_modulus, "(0, inf]", "Pa")
        require("poissons_ratio of a block", self.poissons_ratio, "(-1, 0.5)")


@dataclass(frozen=True)
class RoughJoint:
    """Two blocks between frictionless platens, joined by a rough frictionless interface.

    The lower block (side 1) stands on a fixed platen. A rigid platen on the upper block (side 2)
    is guided along z and carries the force, pressure times section; a force off the centre gives a
    pressure without closed form, of an :class:`~multiscale.macro.Assembly` with a
    :class:`~multiscale.macro.Platen`.

    Parameters
    ----------
    section : tuple of float, lengths of the nominal contact along x and y, m
    lower, upper : Block, side 1 and side 2
    """

    section: tuple[float, float]
    lower: Block
    upper: Block

    def __post_init__(self) -> None:
        if not min(self.section) > 0.0:
            raise CaseError(f"section must have positive lengths (m), got {self.section}")

    @property
    def area(self) -> float:
        """Nominal contact area, m²."""
        return self.section[0] * self.section[1]


def soften(block: Block, stiffness: float | np.ndarray) -> Block:
    """Return a block with less stiffness.

    Parameters
    ----------
    block : Block, sound, or softened before
    stiffness : float or ndarray
        A factor of its stiffness, above 0 and up to 1, such as 1 - D, the same in all directions.
        Or, in place of its moduli, the tensor of a representative volume in the axes of the joint,
        shape (6, 6), Pa.
    """
    if isinstance(stiffness, np.ndarray):
        return replace(block, effective=AnisotropicElastic(stiffness))
    if not 0.0 < stiffness <= 1.0:
        raise CaseError(
            f"the stiffness factor of a block must be above 0 and at most 1, got {stiffness:g}; a "
            f"block without stiffness cannot support a joint"
        )
    share = float(stiffness)
    return replace(
        block,
        youngs_modulus=share * block.youngs_modulus,
        effective=block.effective and block.effective.scaled(share),
    )


def press_joint(
    joint: RoughJoint,
    law: GapLaw,
    preloads: np.ndarray,
    *,
    samples: Sequence[GapLaw] = (),
    extrapolate: bool = False,
) -> Dataset:
    r"""Press a joint and return its normal stiffness at every preload, in closed form.

    Parameters
    ----------
    law : GapLaw, in its first loading
    preloads : ndarray, shape (steps,), nominal pressures :math:`p > 0`, Pa: force over section
    samples : sequence of GapLaw
        Bootstrap samples of the law; each gives a row of ``joint_stiffness_sample``.
    extrapolate : bool
        Whether steps far outside the data of the law have the values that the law extrapolates; see
        :func:`~multiscale.macro.data_range.with_load_shares`.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``. ``joint_stiffness`` is the tangent :math:`\mathrm{d}p /
        \mathrm{d}a`, Pa/m, and ``solid_stiffness`` the stiffness of the same blocks bonded to each
        other. Where the inversion of the law failed, the step is NaN with ``converged`` 0; far
        outside the data of the law it is NaN with ``known`` 0. A law with an unloading branch also
        gives ``unloading_stiffness``, for small cycles of the preload below its value.

    Notes
    -----
    Between guided platens without friction, and without friction in the interface, a uniform
    pressure p and uniaxial stress satisfy all equations; the solution is unique because the
    pressure falls with the gap. With the heights :math:`h_i` and moduli :math:`E_i` of the blocks
    along z (of an anisotropic block :math:`1/S_{zzzz}`), the initial gap :math:`g_0`, and gap
    :math:`g(p)` and stiffness :math:`K(p)` of the law,

    .. math::
        \frac1k = \frac1{K(p)} + \frac{h_1}{E_1} + \frac{h_2}{E_2}, \qquad
        a = p \Big(\frac{h_1}{E_1} + \frac{h_2}{E_2}\Big) - (g(p) - g_0).    \tag{1}
    """
    begin = perf_counter()
    p = np.asarray(preloads, dtype=float)
    if not np.all((p > 0.0) & np.isfinite(p)):
        raise CaseError(f"preloads must be positive and finite (Pa), got {p}")

    # gap at each preload, and (1)
    compliance = joint.lower.compliance + joint.upper.compliance  # m/Pa
    normal = law.first_loading
    gap = normal.gap_at(p)
    residual = np.abs(normal.pressure(gap) / p - 1.0)
    converged = residual <= TOLERANCE
    measured = {
        **_stiffness(law, p, compliance),
        "approach": p * compliance - (gap - normal.gap),
        "mean_gap": gap,
        "closed_fraction": np.ones(p.size),
    }

    # stiffness of the bootstrap samples
    rows = [_stiffness(sample, p, compliance) for sample in samples]
    sampled = {
        f"{name}_sample": np.array([row[name] for row in rows])
        for name in (rows[0] if rows else ())
    }
    values = {
        "preload": p,
        **{name: np.where(converged, value, np.nan) for name, value in measured.items()},
        **sampled,
        "converged": converged.astype(int),
        "residual": residual,
        "wall_time": np.full(p.size, (perf_counter() - begin) / p.size),
    }

    # share of the load outside the data of the law
    ends = data_ends(law)
    shares = load_shares(p[:, None], np.ones(1), ends)
    result = with_load_shares(
        MACRO_RESULT.build(values), shares[..., None], np.array([ends]), extrapolate=extrapolate
    )
    solid = np.full(p.size, 1.0 / compliance)  # independent of the law
    return MACRO_RESULT.assign(result, {"solid_stiffness": solid})


def _stiffness(law: GapLaw, p: np.ndarray, compliance: float) -> dict[str, np.ndarray]:
    """Stiffness of the interface, and (1) on every branch of its law, Pa/m."""
    normal = law.first_loading
    K = normal.stiffness(normal.gap_at(p))
    stiffness = {"interface_stiffness": K, "joint_stiffness": 1.0 / (1.0 / K + compliance)}
    if law.unloading_ratio is not None:
        unloading = 1.0 / (law.unloading_ratio * K)
        stiffness["unloading_stiffness"] = 1.0 / (unloading + compliance)
    return stiffness
