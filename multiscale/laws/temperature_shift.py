"""Temperature shift of relaxation times."""

from multiscale.errors import CaseError

__all__ = ["wlf_shift"]


def wlf_shift(temperature: float, reference: float, c1: float = 17.44, c2: float = 51.6) -> float:
    r"""Return the shift factor of relaxation times by Williams, Landel and Ferry.

    .. math:: \log_{10} a_T = -\frac{c_1 (T - T_r)}{c_2 + T - T_r}

    Parameters
    ----------
    temperature, reference : float, temperature :math:`T` and reference temperature :math:`T_r`, K
    c1, c2 : float
        Constants :math:`c_1`, dimensionless, and :math:`c_2`, K; the defaults hold for many
        polymers with the glass transition as reference.

    Returns
    -------
    float, ratio :math:`a_T` of the relaxation times at T and at the reference, dimensionless

    Raises
    ------
    CaseError
        If :math:`T \le T_r - c_2`.

    References
    ----------
    .. [1] M. L. Williams, R. F. Landel and J. D. Ferry, J. Am. Chem. Soc. 77 (1955) 3701-3707,
       doi:10.1021/ja01619a008.

    Examples
    --------
    >>> wlf_shift(293.0, 293.0)
    1.0
    >>> wlf_shift(313.0, 293.0) < 1e-3
    True
    """
    above = temperature - reference
    if not c2 + above > 0.0:
        raise CaseError(
            f"the shift factor is not defined at {temperature:g} K, {-above:g} K below its "
            f"reference; stay less than {c2:g} K below it"
        )
    return float(10.0 ** (-c1 * above / (c2 + above)))
