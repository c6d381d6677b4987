"""Friction out of responses that slide."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import MICRO_RESPONSE, Dataset
from multiscale.upscaling.observations import Observations, observe
from multiscale.upscaling.response_observations import inherited, usable_steps

__all__ = ["friction_observations"]


def friction_observations(response: Dataset) -> Observations:
    r"""Friction coefficients of a response that slides steadily.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``: a sheared layer of grains with ``sliding_speed`` along
        ``step``, or cells with friction, whose steps count where all their contact slips.

    Returns
    -------
    Observations
        Of ``"friction_coefficient"``: :math:`|t_T| / p` for each realisation and step that
        converged, at its pressure and speed. Cells slide at the change of the jump over the
        change of the time; without times their friction has no rate, and the speed is zero.

    Raises
    ------
    CaseError
        If nothing slides.
    """
    MICRO_RESPONSE.check(response)
    counted, pressure = usable_steps(response)
    traction = response["traction"].to_numpy()
    if "sliding_speed" in response.variables:
        speed = np.asarray(response["sliding_speed"].to_numpy(), dtype=float)
    elif "slip_fraction" in response.variables:
        slipping = np.asarray(response["slip_fraction"].to_numpy(), dtype=float)
        counted &= slipping == 1.0
        if not np.any(counted):
            raise CaseError(
                f"friction is observed where all contact slips, but at most "
                f"{100.0 * np.nanmax(slipping):.2g} % of it does; slide farther"
            )
        speed = _speeds(response, counted)
    else:
        raise CaseError(
            "the response has neither sliding_speed nor slip_fraction: friction is observed where "
            "a cell slides steadily"
        )
    coefficient = np.linalg.norm(traction[..., 1:], axis=-1) / np.abs(traction[..., 0])
    steps = counted.any(axis=0)
    return observe(
        "friction_coefficient",
        (pressure[steps], speed[steps]),
        np.where(counted, coefficient, np.nan)[:, steps],
        **inherited(response),
    )


def _speeds(response: Dataset, counted: np.ndarray) -> np.ndarray:
    """Mean speed of the realisations that slide in a step, m/s; zero without times."""
    if "time" not in response.variables:
        return np.zeros(counted.shape[1])
    moved = np.diff(response["displacement_jump"].to_numpy()[..., 1:], axis=1, prepend=0.0)
    length = np.where(counted, np.linalg.norm(moved, axis=-1), 0.0).sum(axis=0)
    duration = np.diff(np.asarray(response["time"].to_numpy(), dtype=float), prepend=0.0)
    total = np.maximum(counted.sum(axis=0), 1) * np.where(duration > 0.0, duration, np.inf)
    return np.asarray(length / total)
