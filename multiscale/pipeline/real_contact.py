"""Mean pressure on the real contact area of cells, and the flow of the softer body."""

from collections.abc import Sequence

import numpy as np

from multiscale.pipeline.case_cells import surface_modulus
from multiscale.pipeline.tables.rough_bodies import TABOR
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import MACRO_RESULT, MICRO_RESPONSE, Dataset, with_cautions
from multiscale.units import readable
from multiscale.upscaling import Uncertainty, area_from_dataset, cell_share
from multiscale.upscaling.budget import has_budget, known_terms
from multiscale.upscaling.reading import TABLE

ELASTIC = 0.01  # mean real pressure over the contact modulus above which most metals flow
ABOVE = 1.1  # mean real pressure over the hardness above which there is a caution


def real_pressure(pressure: np.ndarray, contact_fraction: np.ndarray) -> np.ndarray:
    """Mean pressure on the real contact area, Pa; NaN where nothing touches."""
    touching = np.where(contact_fraction > 0.0, contact_fraction, np.nan)
    return np.asarray(pressure / touching)


def contact_source(
    law: Dataset, pressure: np.ndarray, answers: np.ndarray, of: str = ""
) -> Uncertainty:
    """Return the contact fraction of a law as a source of error of ``answers``, bool."""
    data, half_width = np.log(law["fit_pressure"].to_numpy()), {}
    for term in known_terms(law):
        errors = law.sel(quantity="contact_fraction", error_term=term)
        wrong = np.hypot(errors["error_half_width"].to_numpy(), errors["error_bias"].to_numpy())
        half_width[term] = np.interp(np.log(pressure), data, wrong)
    rate = answers[:, None] * np.ones(pressure.size)
    return Uncertainty(name="contact fraction", of=of, half_width=half_width, rate=rate)


def with_real_pressure(case: Case, response: Dataset) -> Dataset:
    """Return a response with its mean real pressure, a sentence on the flow, and cautions."""
    p = response["nominal_pressure"].to_numpy()
    good, area = response["converged"].to_numpy() == 1, response["contact_fraction"].to_numpy()
    real = np.where(good, real_pressure(p, area), np.nan)
    mean = real_pressure(p * good.sum(axis=0), np.where(good, area, 0.0).sum(axis=0))
    largest = float(np.nanmax(mean, initial=0.0))
    flow, hardness, caution = _flow(case), case.hardness, ""
    reached = f"the mean real pressure reaches {readable(f'{largest:.3g} Pa')}"
    if hardness is None:
        modulus = surface_modulus(case)
        if largest > ELASTIC * modulus and not case.elastic:
            caution = (
                f"{reached}, {largest / modulus:.2g} of the contact modulus, in an elastic model; "
                f"most metals flow at lower pressures: give the hardness, or set elastic = true "
                f"for a body that does not flow"
            )
    else:
        flow += f" The mean real pressure reaches {largest / hardness:.2f} of that hardness."
        if largest > ABOVE * hardness:
            caution = (
                f"{reached}, {largest / hardness:.2f} of the hardness of the softer body: it "
                f"hardens, or the grid does not resolve its contact"
            )
    response = MICRO_RESPONSE.assign(response, {"real_pressure": real})
    return with_cautions(response, caution).assign_attrs(behaviour=flow)


def _flow(case: Case) -> str:
    if case.hardness is None:
        return "The answer is elastic, as no body has a hardness."
    alike = case.body_1.surface_hardness == case.body_2.surface_hardness
    number = 1 + case.bodies.index(case.softer) if case.softer else 0
    which = "both bodies" if alike else f"body_{number}, the softer body"
    hardness = f"the hardness of {1e-9 * case.hardness:g} GPa of {which}"
    if case.yield_stress is None:
        return f"The local pressure is limited to {hardness}; otherwise the bodies are elastic."
    return (
        f"The composite body flows above a yield stress of "
        f"{1e-9 * case.yield_stress:.4g} GPa: {hardness} over {TABOR}, minus the part of hardening."
    )


def behaviour(dataset: Dataset) -> list[str]:
    """Return the sentence on the flow of a response or law with flow."""
    return [str(dataset.attrs["behaviour"])] if "behaviour" in dataset.attrs else []


def negative_gap(gap: np.ndarray, law: Dataset) -> list[str]:
    """Explain a negative mean gap, m, of a law; nothing if all gaps are positive."""
    if not np.any(gap < 0.0):
        return []
    if law.attrs.get("family") == TABLE:
        return ["The mean gap is zero at first contact: it is the negative overclosure."]
    return [
        "The mean gap is the mean distance from the deformed surface to the obstacle: it is "
        "negative if the overlap of points at the limit of the hardness, where they would flow, "
        "exceeds the gap of the others, or if a law is extrapolated."
    ]


def zero_of_gap(law: Dataset) -> list[str]:
    """Caution that a law of measured stiffnesses has no zero of the gap."""
    if law.attrs.get("quantity") != "normal_stiffness":
        return []
    largest = 1e-6 * float(law.attrs["pressure_max"])
    return [f"gaps are relative to the gap at {largest:.4g} MPa, as only stiffness was measured"]


def unknown_cells(law: Dataset) -> list[str]:
    """Report that a law with the error of cells lacks their size; nothing if it is of a table."""
    of_cells = has_budget(law) and law.attrs.get("family") != TABLE
    return ["The law does not contain the size of its cells."] if of_cells else []


def with_contact(result: Dataset, law: Dataset) -> Dataset:
    """Return the result of rough joints with real contact, if the law has it, and facts."""
    facts, area = behaviour(law), result["point_area"].to_numpy()
    if "cell_size" in law.attrs:
        number = result["point_joint"].to_numpy()
        edge = min(np.sqrt(area[number == joint].sum()) for joint in np.unique(number))
        facts.append(cell_share(float(law.attrs["cell_size"]), float(edge)))
    else:
        facts += unknown_cells(law)
    joints = np.unique(result["point_joint"].to_numpy()).size
    carried, touching = _carried(result, [law] * joints).sum(axis=2)
    if not np.isnan(touching).all():
        values = {
            "contact_fraction": touching / area.sum(),
            "real_pressure": real_pressure(carried, touching),
        }
        result = MACRO_RESULT.assign(result, values)
    return result.assign_attrs(facts="\n".join(facts))


def with_interface_contact(result: Dataset, laws: Sequence[Dataset | None]) -> Dataset:
    """Return a result with the mean real pressure of interfaces, NaN where the law has no area."""
    real = real_pressure(*_carried(result, laws))
    if np.isnan(real).all():
        return result
    return MACRO_RESULT.assign(result, {"interface_real_pressure": real})


def _carried(result: Dataset, laws: Sequence[Dataset | None]) -> np.ndarray:
    """Return load, N, and real contact area, m², shape (2, steps, joints); NaN without an area."""
    area, pressure = result["point_area"].to_numpy(), -result["traction"].to_numpy()[..., 0]
    number, sound = result["point_joint"].to_numpy(), 1.0 - result["point_damage"].to_numpy()
    carried = np.full((2, len(pressure), len(laws)), np.nan)
    for joint, law in enumerate(laws):
        if law is not None and "area_pressure" in law:
            inside = number == joint
            p, known = np.maximum(pressure[:, inside], 0.0), np.isfinite(pressure[:, inside])
            local = area_from_dataset(law).contact_fraction(np.where(known, p, 0.0) / sound[inside])
            carried[0, :, joint] = p @ area[inside]
            carried[1, :, joint] = np.where(known, sound[inside] * local, np.nan) @ area[inside]
    return carried
