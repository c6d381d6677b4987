r"""Two-scale fatigue under reversed uniaxial stress, damage leaving the stress as it is.

With the fatigue limit :math:`\sigma_f` as yield stress of the inclusion, the modulus
:math:`K = 3G(1-b) + C` and :math:`b = 2(4-5\nu)/(15(1-\nu))`, the inclusion flows by
:math:`2 (S_a - \sigma_f)/K` in each half cycle. Without hardening its deviatoric stress stays on
the yield surface while the stress of the volume, a third of which is the mean stress, runs from
:math:`2\sigma_f - S_a` to :math:`S_a`.

References
----------
.. [1] J. Lemaitre, J. P. Sermage and R. Desmorat, Int. J. Fract. 97 (1999) 67: the
   model.
"""

import numpy as np


def plastic_strain_per_cycle(
    amplitude: float,
    youngs_modulus: float,
    poissons_ratio: float,
    fatigue_limit: float,
    hardening: float = 0.0,
) -> float:
    r"""Plastic strain in a cycle, :math:`4 \langle S_a - \sigma_f \rangle / K`; stresses in Pa."""
    nu = poissons_ratio
    b = 2.0 * (4.0 - 5.0 * nu) / (15.0 * (1.0 - nu))
    K = 3.0 * youngs_modulus / (2.0 * (1.0 + nu)) * (1.0 - b) + hardening
    return 4.0 * max(0.0, amplitude - fatigue_limit) / K


def damage_per_cycle(
    amplitude: float,
    youngs_modulus: float,
    poissons_ratio: float,
    fatigue_limit: float,
    damage_strength: float,
) -> float:
    r"""Damage in a cycle without hardening and closure, exponent 1.

    .. math::
        \frac{\Delta p}{2 E S} \Big[ \tfrac23 (1+\nu)\, \sigma_f^2
        + \tfrac{1-2\nu}{3}\, \frac{S_a^3 - (2\sigma_f - S_a)^3}{6 (S_a - \sigma_f)} \Big]
    """
    dp = plastic_strain_per_cycle(amplitude, youngs_modulus, poissons_ratio, fatigue_limit)
    if dp == 0.0:
        return 0.0
    mean = amplitude**3 - (2.0 * fatigue_limit - amplitude) ** 3
    mean /= 6.0 * (amplitude - fatigue_limit)
    shape = 2.0 / 3.0 * (1.0 + poissons_ratio) * fatigue_limit**2
    shape += (1.0 - 2.0 * poissons_ratio) / 3.0 * mean
    return dp * shape / (2.0 * youngs_modulus * damage_strength)


def reversed_life(plastic: float, damage: float, threshold: float, critical: float) -> float:
    """Cycles to rupture from plastic strain and damage per cycle; infinite without flow."""
    return threshold / plastic + critical / damage if plastic > 0.0 else np.inf
