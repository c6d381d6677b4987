"""Answers of joints under preload and shear: their error budget, tables, sentences and figures."""

from collections.abc import Iterator

import numpy as np

from multiscale.macro.substructures import LoadPath
from multiscale.pipeline import showing
from multiscale.pipeline.body_budget import CycleAnswers, FirstOrder, JointAnswers, answer_at
from multiscale.pipeline.real_contact import with_contact
from multiscale.pipeline.stage import Section
from multiscale.pipeline.stages.joint import HEADS, STIFFNESS, STIFFNESSES, budget_sections
from multiscale.pipeline.structure_stage import PathAnswers, ReadyBodies
from multiscale.plotting import joint_pictures
from multiscale.plotting.figure import on_axes
from multiscale.schema import MACRO_RESULT, Dataset
from multiscale.upscaling import limits, over_steps, with_budget, with_intervals
from multiscale.upscaling.budget import interval_errors

AT_PRELOADS = (*STIFFNESSES, "tangential_stiffness", "real_pressure")
IN_CYCLES = ("cycle_slip", "cycle_loss", "secant_stiffness")
AT_END = {"cycle_slip": "slipping_load", "cycle_loss": "cycle_energy"}
"""Answers that have an error budget: at the preloads, in the cycles of every preload and amplitude,
and names of the answers of the last cycle at the end of the path."""

TABLE = showing.Table(
    (
        "preload",
        *STIFFNESS[:3],
        "slipping_load",
        "tangential_stiffness:±",
        *STIFFNESS[3:],
        "slip_fraction",
        "open_fraction",
        "real_pressure:±",
    ),
    HEADS | {"tangential_stiffness": "tangential, no slip", "slipping_load": "sliding force"},
    answer="approach",
)
"""Answers of the joints at their preloads."""

CYCLES = showing.Table(
    (
        "cycle_preload",
        "cycle_shear",
        *(f"{name}{form}" for name in IN_CYCLES[::-1] for form in ("", ":both")),
    ),
    {"cycle_shear": "amplitude", "secant_stiffness": "secant stiffness"},
    answer="cycle_loss",
    at=2,
    along=("level", "amplitude"),
)
"""Answers of the closed cycles at every preload and amplitude."""

STIFF = (
    "At a preload of {preload} the joint has a normal stiffness of {joint_stiffness:±} and, before "
    "it slips, a tangential stiffness of {tangential_stiffness:±}."
)
LOSES = (
    "A cycle of shear between {most} and -{most} MPa dissipates {cycle_energy:±}; at its ends, "
    f"{showing.SLIP}."
)
"""Sentences of the answer: at a preload, and in the last cycle."""


def _complete(result: Dataset, ready: ReadyBodies) -> Dataset:
    """Add the real contact of the joints, which share one law."""
    law = ready.jointed.laws[0]
    assert law is not None  # the law of a joint is never stated
    return with_contact(result, law)


def _facts(result: Dataset, ready: ReadyBodies) -> Iterator[str]:
    pressed, sheared = (1e6 * area for area in ready.parts.path.forces)  # mm²
    preloads = ready.jointed.case.statics.preloads
    forces = ", ".join(f"{1e-9 * pressed * preload:.4g}" for preload in preloads)
    yield f"The preloads are pressures on {pressed:.4g} mm², forces of {forces} kN."
    yield (
        f"Stiffness is pressure or shear over the displacement of its face: 1 MPa/µm is "
        f"{pressed:.4g} N/µm of preload, and {sheared:.4g} N/µm of shear."
    )


def _answer(result: Dataset) -> Iterator[str]:
    known = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    if not known.size:
        return
    view = showing.View(result)
    yield from view.sentences(result.isel(step=known[-1]), STIFF)
    if "cycle_energy" in result:
        most = f"{1e-6 * float(np.abs(result['shear']).max()):.3g}"
        yield from view.sentences(result.isel(step=-1, cycle=-1), LOSES, most=most)
    yield from showing.list_missing(result)


def _sections(result: Dataset) -> Iterator[Section]:
    caption = [
        "Zones and pressure are seen along the normal of the first joint, at the last amplitude "
        "with an answer. A point slides if contacts with more than half of its pressure "
        "slide, and is open below 1 % of the mean pressure. Lines are outlines of the bodies."
    ]
    figures = {name: on_axes(plot) for name, plot in joint_pictures(result).items()}
    yield Section("Joint", caption, figures=figures)
    if "cycle_loss" in result:
        cycles = [
            "At each preload the shear has a closed cycle of each amplitude, in rising order. "
            "The secant stiffness is the shear over the displacement of the sheared face between "
            "both ends of a cycle. Bands are the 95 % intervals of the mean law and of one part."
        ]
        yield Section("Cycles of shear", cycles, *CYCLES.rows(result))
    yield from budget_sections(result)


def _pressed(result: Dataset) -> Dataset:
    sheared = np.flatnonzero(result["shear"].to_numpy())
    return result.isel(step=slice(sheared[0])) if sheared.size else result


def _compared(result: Dataset) -> Dataset:
    """Return the answers at the preloads and of cycles, with the slip at the end of the path."""
    slip = [name for name in result if str(name).startswith("slipping_load")]
    result = result.drop_vars("bolt_force", errors="ignore")  # the preloads
    if not result["shear"].any():
        return result.drop_vars(slip)
    return _pressed(result).assign({name: result[name].isel(step=-1) for name in slip})


def _with_errors(result: Dataset, path: LoadPath, first_order: FirstOrder) -> JointAnswers:
    """Return the answers of joints at their preloads, then in the cycles of every amplitude."""
    known = result["known"].to_numpy() == 1
    rests = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    names = [name for name in AT_PRELOADS if name in result]  # real pressure may be missing
    read = {name: answer_at(name) for name in names}
    joints = tuple(np.unique(result["point_joint"].to_numpy()).astype(int).tolist())
    real = {"real_pressure": joints} if "real_pressure" in result else {}
    level, amplitude = np.zeros((2, 0), dtype=int)
    if "cycle_loss" in result and result["converged"].to_numpy().all():
        level, amplitude = np.nonzero(result["cycle_loss"].to_numpy() > 0.0)  # others do not slip
    cycles = None
    if level.size:
        cycles = CycleAnswers(
            {name: answer_at(name, level, amplitude) for name in IN_CYCLES},
            "cycle_slip",
            "cycle_loss",
            level,  # a preload is the step of its number
            _slip_slope(result)[level, amplitude],
            result["loss_density"].to_numpy()[level, amplitude],
            path.amplitude_steps,
        )
    ended = bool(level.size) and bool(known[-1])
    ended = ended and bool(result["cycle_loss"].to_numpy()[-1, -1] > 0.0)

    def place(result: Dataset, budget: Dataset) -> Dataset:
        """Add the intervals of every cycle, and of the last cycle at the last step."""
        values, errors = {}, interval_errors(budget)
        for row, name in enumerate(map(str, budget["quantity"].values)):
            for kind, error in errors.items() if name in IN_CYCLES else ():
                half = np.full(result[name].shape, np.nan)
                half[level, amplitude] = error[row, -level.size :]
                values[f"{name}_{kind}"] = limits(result[name].to_numpy(), half)
        result, at = MACRO_RESULT.assign(result, values), rests[known[rests]]
        columns = [*range(at.size), *([-1] if ended else [])]
        at = np.append(at, known.size - 1) if ended else at
        names = [name for name in map(str, budget["quantity"].values) if name not in IN_CYCLES[2:]]
        selected = budget.isel(step=columns).sel(quantity=names)
        selected = selected.assign_coords(quantity=[AT_END.get(name, name) for name in names])
        return with_intervals(with_budget(result, over_steps(selected, at, known.size)))

    return JointAnswers(read, real, rests, place, cycles, first_order)


def _slip_slope(result: Dataset) -> np.ndarray:
    """Logarithmic slope of the slipping share over the amplitude, shape (levels, amplitudes)."""
    share, shear = result["cycle_slip"].to_numpy(), result["cycle_shear"].to_numpy()
    with np.errstate(divide="ignore", invalid="ignore"):  # NaN where nothing slips
        if shear.size > 1:
            return np.asarray(np.gradient(np.log(share), np.log(shear), axis=1))
        at = np.log([result[name].to_numpy()[-2:] for name in ("slipping_load", "shear")])
        return np.full(share.shape, np.ptp(at[0]) / np.ptp(at[1]))


JOINT_ANSWERS = PathAnswers(
    question="How stiff are the joints, where do they slip, and what does a cycle dissipate?",
    complete=_complete,
    facts=_facts,
    with_errors=_with_errors,
    tabulate=lambda result: TABLE.rows(_pressed(result)),
    sentences=_answer,
    sections=_sections,
    compared=_compared,
)
