"""Observations in the response of cells: gaps, areas, spring back and friction."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import LOADING, MICRO_RESPONSE, UNLOADING, Dataset, with_cautions
from multiscale.units import readable
from multiscale.upscaling.observations import Observations, arrange, error_scale, observe
from multiscale.upscaling.sampling import Control

HIGHEST_GAP = 20.0
"""Mean gap over the rms height above which units are wrong, or only a spike is in contact."""

LIGHT, DEEPEST = 0.05, 5.0
"""Contact fraction up to which pressing does not change the heights, and depth of valleys, over the
rms height, that only scratched surfaces exceed."""

_FILE_ATTRIBUTES = frozenset(
    {"schema", "schema_version", "Conventions", "source", "history", "environment"}
)

ROUND_OFF = 1e-6
"""Mean gap over the rms height, by the tolerance of solvers, where all of a surface touches."""


def normal_observations(response: Dataset, control: Dataset | None = None) -> Observations:
    """Return the mean gaps of a response at rising pressures, without failed steps."""
    gaps = _observe_response("gap", response, "mean_gap", control)
    response = with_cautions(response, *_odd_gaps(response, gaps))
    return replace(gaps, attributes=inherited(response))


def area_observations(response: Dataset, control: Dataset | None = None) -> Observations:
    """Return the contact fractions of a response; see :func:`normal_observations`."""
    areas = _observe_response("contact_fraction", response, "contact_fraction", control)
    a, counted = areas.values, areas.counted
    wrong = counted & ~((a >= 0.0) & (a <= 1.0))
    if np.any(wrong):
        raise CaseError(
            f"a contact fraction lies between 0 and 1, got {a[wrong][0]:.3g}; divide an area by "
            f"the nominal area, and a percentage by 100"
        )
    # changes of the fraction that chance does not explain
    both = counted[:, 1:] & counted[:, :-1]
    n = both.sum(axis=0)
    change = np.where(both, np.diff(a, axis=1), 0.0)
    mean = change.sum(axis=0) / np.maximum(n, 1)
    spread = np.sqrt(np.sum(np.where(both, change - mean, 0.0) ** 2, axis=0) / np.maximum(n, 1))
    falls = (n >= 3) & (mean < -5.0 * spread / np.sqrt(np.maximum(n - 1, 1)) - 1e-3)
    if np.any(falls):
        j = int(np.argmax(falls))
        p = areas.pressure
        raise CaseError(
            f"the contact fraction falls by {-mean[j]:.2g} from {p[j]:.3g} to {p[j + 1]:.3g} Pa in "
            f"all realisations, which pressing cannot cause; check the order of the steps, or "
            f"select one loading branch"
        )
    return areas


def _observe_response(
    quantity: str, response: Dataset, variable: str, control: Dataset | None
) -> Observations:
    """Select usable steps and realisations; pressures rising."""
    MICRO_RESPONSE.check(response)
    counted, pressure = usable_steps(response)
    values = np.where(counted & (pressure > 0.0), response[variable].to_numpy(), np.nan)
    seen = arrange(quantity, (pressure,), values, inherited(response))
    p = seen.pressure
    if p.size < 3:
        raise CaseError(
            f"a law needs at least 3 pressures with a converged realisation, got {p.size} "
            f"of {pressure.size}; solve more steps or find out why they failed"
        )
    if not np.all(np.diff(p) > 1e-9 * p[1:]):
        raise CaseError(
            "a nominal pressure occurs twice in the response; a law is fitted to one loading "
            "branch, so select its steps first"
        )
    if control is None:
        return seen
    numbers = response["realisation"].to_numpy()[np.isfinite(values).any(axis=1)]
    both = Control.of(seen.values, paired_first(control, numbers, variable, p))
    mean = seen.mean if both is None else both.mean
    return replace(seen, control=both, scale=error_scale(quantity, (p,), mean))


def paired_first(
    control: Dataset, numbers: np.ndarray, variable: str, pressure: np.ndarray
) -> np.ndarray:
    """Return values of cheap cells at pressures, (cells, pressures), the given numbers first."""
    loading = loading_branch(control)
    solved = loading["nominal_pressure"].to_numpy()
    at = np.array([int(np.argmin(np.abs(solved - p))) for p in pressure])
    if far := [p for p, j in zip(pressure, at, strict=True) if abs(solved[j] - p) > 1e-6 * p]:
        raise CaseError(
            f"the control cells were not pressed under {far[0]:.4g} Pa, a pressure of the cells; "
            f"press both at the same pressures"
        )
    cheap_numbers = loading["realisation"].to_numpy()
    if missing := sorted({*numbers.tolist()} - {*cheap_numbers.tolist()}):
        raise CaseError(
            f"the control has no cells of the realisations {missing}, so they cannot be paired; "
            f"solve it on the same surfaces, with the same numbers"
        )
    paired = [int(np.flatnonzero(cheap_numbers == k)[0]) for k in numbers]
    rows = np.array([*paired, *np.flatnonzero(~np.isin(cheap_numbers, numbers))])
    values = np.where(loading["converged"] == 1, loading[variable].to_numpy(), np.nan)
    return np.asarray(values[np.ix_(rows, at)])


def usable_steps(response: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the usable steps of each realisation, and the pressure of every step, Pa."""
    normal = -response["traction"].sel(component="n").to_numpy()
    counted = response["converged"].to_numpy() == 1
    values = {"mean_gap": response["mean_gap"].to_numpy(), "normal traction": normal}
    values["contact_fraction"] = response["contact_fraction"].to_numpy()
    for name, value in values.items():
        wrong = np.argwhere(counted & ~np.isfinite(value))
        if wrong.size:
            k, j = wrong[0]
            raise CaseError(
                f"realisation {k}, step {j}: {name} is {value[k, j]} although converged is 1; "
                f"set converged to 0 for a step that failed, or solve it again"
            )
    _check_heights(response, values["mean_gap"], counted)
    total = counted.sum(axis=0)
    mean = np.where(counted, normal, 0.0).sum(axis=0) / np.maximum(total, 1)
    if "nominal_pressure" not in response.variables:
        return counted, mean
    pressure = np.asarray(response["nominal_pressure"].to_numpy(), dtype=float)
    wrong = (total > 0) & (np.abs(mean - pressure) > 0.05 * np.abs(pressure))
    if np.any(wrong):
        j = int(np.argmax(wrong))
        raise CaseError(
            f"the averaged traction of {mean[j]:.3g} Pa contradicts the nominal pressure of "
            f"{pressure[j]:.3g} Pa at step {j}; both are in Pa, and a pressure is minus the normal "
            f"traction"
        )
    return counted, pressure


def up_to_limit(response: Dataset, law: Dataset) -> Dataset:
    """Return the steps of a response up to the pressure at which a law ends."""
    if "pressure_limit" not in law.attrs:
        return response
    limit = (1.0 + 1e-6) * float(law.attrs["pressure_limit"])
    return response.isel(step=np.flatnonzero(usable_steps(response)[1] <= limit))


def join_pressures(first: Dataset, second: Dataset) -> Dataset:
    """Return the steps of two loading branches of the same cells, by rising pressure."""
    import xarray as xr

    shared = [name for name in first if name in second and "step" in first[name].dims]
    both = xr.concat([first[shared], second[shared]], "step", combine_attrs="override")
    order = np.argsort(both["nominal_pressure"].to_numpy(), kind="stable")
    both = both.isel(step=order).assign_coords(step=range(order.size))
    rest = first[[name for name in first if "step" not in first[name].dims]]
    lines = {
        name: [line for data in (first, second) for line in data.attrs.get(name, "").splitlines()]
        for name in ("cautions", "ended")
    }
    texts = {name: "\n".join(dict.fromkeys(each)) for name, each in lines.items() if each}
    return rest.merge(both, combine_attrs="override").assign_attrs(texts)


def loading_branch(response: Dataset) -> Dataset:
    """Return the steps of a response with a pressure that was not reached before."""
    return response.isel(step=np.flatnonzero(response["branch"] == LOADING))


def unloading_observations(response: Dataset, control: Dataset | None = None) -> Observations:
    """Return the spring back of a loaded and unloaded response from its largest pressures."""
    MICRO_RESPONSE.check(response)
    counted, pressure = usable_steps(response)
    gap = np.where(counted, response["mean_gap"].to_numpy(), np.nan)
    branch, steps = response["branch"].to_numpy(), np.arange(pressure.size)
    top = np.maximum.accumulate(np.where(branch == LOADING, steps, 0))
    down = np.flatnonzero((branch == UNLOADING) & (pressure > 0.0))
    if down.size == 0:
        raise CaseError(
            "no step of the response unloads, so the unloading is unknown; add "
            "steps at lower pressures after the largest pressure"
        )
    recovery = gap[:, down] - gap[:, top[down]]
    conditions = (pressure[down], pressure[top[down]])
    observed = observe("recovery", conditions, recovery, **inherited(response))
    if control is None:
        return observed
    numbers = response["realisation"].to_numpy()[np.isfinite(recovery).any(axis=1)]
    low, high = (paired_first(control, numbers, "mean_gap", p) for p in observed.conditions)
    return replace(observed, control=Control.of(observed.values, low - high))


def inherited(response: Dataset) -> dict[str, Any]:
    """Return the attributes of the surface in a response, of types that netCDF accepts."""
    plain = {
        name: value.item() if isinstance(value, np.number) else value
        for name, value in response.attrs.items()
        if name not in _FILE_ATTRIBUTES
    }
    return {name: value for name, value in plain.items() if isinstance(value, str | int | float)}


def _check_heights(response: Dataset, gap: np.ndarray, counted: np.ndarray) -> None:
    """Refuse mean gaps above ``HIGHEST_GAP`` rms heights, which no surface supports."""
    if "rms_height" not in response.variables:
        return
    height = response["rms_height"].to_numpy()[:, None]
    wrong = np.argwhere(counted & (gap > HIGHEST_GAP * height))
    if wrong.size:
        k, j = wrong[0]
        raise CaseError(
            f"realisation {k}, step {j}: the mean gap of {gap[k, j]:.3g} m is "
            f"{gap[k, j] / height[k, 0]:.3g} times the rms height of {height[k, 0]:.3g} m, and "
            f"it is at most about 5 rms heights on real summits; convert both to m, or remove "
            f"spikes from the map"
        )


def _odd_gaps(response: Dataset, gaps: Observations) -> Iterator[str]:
    """Write cautions on mean gaps that contradict heights and contact fractions, by (1)."""
    if "rms_height" not in response.variables:
        return
    steps = response.isel(step=gaps.order)
    area = steps["contact_fraction"].where(steps["converged"] == 1).mean("realisation").to_numpy()
    share = gaps.mean / float(response["rms_height"].mean())
    p = [readable(f"{pressure:.3g} Pa") for pressure in gaps.pressure]
    # heights of rms h that end at g, in a share A of the area, and at -v, by Cantelli, and by
    # Bhatia and Davis: g <= h sqrt(1/A - 1), g >= h² / v (1); h without load, or in light contact
    most = np.sqrt(1.0 / np.where(area > 0.0, area, np.nan) - 1.0)
    if np.any(share > most + ROUND_OFF):
        j = int(np.nanargmax(share / np.maximum(most, ROUND_OFF)))
        yield (
            f"the mean gap of {share[j]:.3g} rms heights at {p[j]} is larger than {most[j]:.3g}, "
            f"the largest possible with contact on {100.0 * area[j]:.3g} % of the area: "
            f"give gaps and rms heights in m"
        )
    light = np.flatnonzero(area <= LIGHT)
    if light.size and share[light].min() < 1.0 / DEEPEST:
        j = int(light[np.argmin(share[light])])
        yield (
            f"the mean gap of {share[j]:.3g} rms heights at {p[j]} needs valleys deeper than "
            f"{1.0 / max(share[j], 1e-9):.3g} rms heights, since the contact area is small: if the "
            f"surface has no such valleys, give gaps and rms heights in m"
        )


def friction_observations(response: Dataset) -> Observations:
    r"""Return the friction coefficients of a response that slides steadily.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``: a sheared layer of grains with ``sliding_speed`` along
        ``step``, or cells with friction, at the steps where all their contact slips.

    Returns
    -------
    Observations
        Of ``"friction_coefficient"``: :math:`|t_T| / p` for each realisation and step that
        converged, at its pressure and speed. The speed of cells is the change of the jump over the
        change of the time, or zero without times.

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
    """Return the mean speed of the realisations that slide in a step, m/s; zero without times."""
    if "time" not in response.variables:
        return np.zeros(counted.shape[1])
    moved = np.diff(response["displacement_jump"].to_numpy()[..., 1:], axis=1, prepend=0.0)
    length = np.where(counted, np.linalg.norm(moved, axis=-1), 0.0).sum(axis=0)
    duration = np.diff(np.asarray(response["time"].to_numpy(), dtype=float), prepend=0.0)
    total = np.maximum(counted.sum(axis=0), 1) * np.where(duration > 0.0, duration, np.inf)
    return np.asarray(length / total)
