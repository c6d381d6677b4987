"""Representative volumes of grains: compacted, compressed, and sheared between plates."""

from dataclasses import replace
from typing import Any

import numpy as np

from multiscale.errors import CaseError, ConvergenceError, require
from multiscale.macro.granulate.bodies import Grains, PlaneWall
from multiscale.macro.granulate.grain_motion import initial_state, least_period, step_grains
from multiscale.macro.granulate.model import ContactLaw, Model, Solver
from multiscale.macro.granulate.packings import place_loosely
from multiscale.macro.granulate.simulation import Record, network, simulate_grains
from multiscale.schema import MICRO_RESPONSE, Dataset, PlainDataset

REST_STRAIN, REST_STEPS = 1e-6, 20
"""Strain per step below which a cell is at rest, and the number of steps for which it must hold."""

LONGEST_SLIP, MOST_STEPS = 0.1, 20000
"""Way of a sheared plate in a step, over the diameter of its grains, and the limit of its steps."""

PRESSED_STEPS, STILL = 100, 0.05
"""Time of pressing in resolving steps, after which the plate rests if it moved by less than
``STILL`` mean diameters."""

PART, LEAST_STEP = 0.2, 0.1
"""Part of the room in a period that a grain may move in a step of pressing, and the least share of
the step that resolves rearrangements."""

SOLVED, UNSTEADY, FRAMES = 0.9, 0.05, 21
"""Share of solved steps and relative error of the mean pressure in steady shear; its frames."""

BODIES = "grains between two plates, of rigid spheres"


def compact(
    radii: np.ndarray,
    pressure: float,
    law: ContactLaw,
    *,
    planar: bool = False,
    density: float = 2600.0,
    max_steps: int = 2000,
    solver: Solver | None = None,
    seed: int = 0,
) -> Dataset:
    r"""Compact grains in a periodic cell, quasi-statically, until they carry the pressure.

    Parameters
    ----------
    radii : ndarray, shape (grains,), radii of the grains, m
    pressure : float, pressure on the cell, Pa; refused if it is not positive
    planar : bool, whether the grains are discs, 1 m thick, instead of spheres
    density : float, density of the grains, kg/m3
    solver : Solver, optional
    seed : int, seed of the loose packing at the start

    Returns
    -------
    Dataset
        Follows ``GRANULATE``; the last frame is the packing. Attributes: ``solid_fraction``,
        ``stress_error``, the relative difference of the mean stress after Love and Weber and the
        pressure, and ``failure``, empty if the cell is at rest.

    Notes
    -----
    Rigid grains of mass m without gravity have the time scale :math:`\sqrt{m / (p R)}`; a step is
    a fifth of it. Velocities are damped in every step, so that the motion is quasi-static. The cell
    has a finite inertia and follows the pressure, so that no incompatible strain is prescribed.
    """
    require("pressure", pressure, "(0, inf)", "Pa")
    require("max_steps", max_steps, "[1, inf)", integer=True)
    solver = solver or Solver(tolerance=1e-4, max_iterations=2000)
    # random order on a jittered lattice in a square or cubic cell
    radii = np.random.default_rng(seed).permutation(np.asarray(radii, dtype=float))
    edge = 2.3 * float(radii.max()) * int(np.ceil(len(radii) ** (1.0 / (2.0 if planar else 3.0))))
    high, thickness = np.array([edge, edge, np.inf]), 1.0 if planar else None
    grains = place_loosely(
        radii, np.zeros(3), high, density=density, thickness=thickness, seed=seed
    )
    edge *= 1.02
    period = (edge, np.inf, edge) if planar else (edge, edge, edge)
    step = _resolving_step(grains, pressure)
    model = Model(
        grains, (), law, (0.0, 0.0, 0.0), period, damping_rate=np.log(2.0) / step, pressure=pressure
    )

    # steps until the cell is at rest
    state, record = initial_state(model), Record(model)
    record.show(state)
    quiet = 0
    for _ in range(max_steps):
        state, done = step_grains(model, state, step, solver)
        record.add(state, done)
        fastest = float(np.abs(state.rate).max()) * step
        quiet = quiet + 1 if fastest < REST_STRAIN and done["n_contacts"] else 0
        if quiet == REST_STEPS:
            break
    record.show(state)
    if quiet < REST_STEPS:
        record.failure = (
            f"the cell still strains by {fastest:.1e} per step after {max_steps}; raise max_steps"
        )
    result = record.dataset()
    reached = -float(result["stress"].values[-1, model.free].mean())
    return result.assign_attrs(
        solid_fraction=float(grains.volume.sum()) / model.volume(state.period),
        stress_error=reached / pressure - 1.0,
    )


def _resolving_step(grains: Grains, pressure: float) -> float:
    """Return a step of a fifth of the time scale of rearrangements under a pressure, Pa, in s."""
    length = grains.thickness or float(grains.radius.mean())
    return 0.2 * float(np.sqrt(grains.mass.mean() / (pressure * length)))


def shear_layer(
    radii: np.ndarray,
    size: tuple[float, float],
    pressure: float,
    speed: float,
    law: ContactLaw,
    *,
    wall_friction: float | None = None,
    density: float = 2600.0,
    plate_mass: float = 1.0,
    solver: Solver | None = None,
    seed: int = 0,
) -> tuple[Model, float]:
    r"""Grains pressed between two plates (a third body), ready to be sheared.

    Parameters
    ----------
    radii, law, density, seed
        As in :func:`compact`.
    size : tuple of float, periods along x and y, m
    pressure, speed : float, pressure on the upper plate, Pa, positive, and its speed along x, m/s
    wall_friction : float, optional
        Friction coefficient of the plates; the coefficient of the grains if not given.
    plate_mass : float, mass of the upper plate in shear over the mass of the grains
    solver : Solver, optional, of the pressing

    Returns
    -------
    model : Model
        Grains at rest under the pressure; the first wall is the lower plate, the second moves.
    step : float, length of a step that resolves the rearrangements, s
    """
    require("pressure", pressure, "(0, inf)", "Pa")
    high = np.array([*size, np.inf])
    grains = place_loosely(radii, np.zeros(3), high, density=density, seed=seed)
    top = float((grains.position[:, 2] + grains.radius).max())
    area, mass = size[0] * size[1], float(grains.mass.sum())
    plates = (
        PlaneWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), friction=wall_friction),
        PlaneWall(
            (0.0, 0.0, 1.01 * top),
            (0.0, 0.0, -1.0),
            friction=wall_friction,
            mass=mass,
            force=pressure * area,
        ),
    )
    step = _resolving_step(grains, pressure)
    damping = 0.2 * np.log(2.0) / step
    model = Model(grains, plates, law, (0.0, 0.0, 0.0), (*size, np.inf), damping)
    position, height = _press(model, step, solver or Solver())
    loaded = replace(
        plates[1],
        point=(0.0, 0.0, height),
        velocity=(speed, 0.0, 0.0),
        mass=plate_mass * mass,
    )
    still = np.zeros_like(position)
    ready = grains.moved(position, still, still)
    return replace(model, grains=ready, walls=(plates[0], loaded), damping_rate=0.0), step


def _press(model: Model, step: float, solver: Solver) -> tuple[np.ndarray, float]:
    """Press a layer until its upper plate rests; return the centres and the height, m."""
    state = initial_state(model)
    height = state.point[1, 2]
    way = 2.0 * STILL * float(model.grains.radius.mean())
    room, pressed = float(state.period.min()) - least_period(model.grains.radius), 0.0
    for _ in range(MOST_STEPS):
        if pressed >= PRESSED_STEPS:
            if height - state.point[1, 2] < way:
                return state.position, float(state.point[1, 2])
            height, pressed = state.point[1, 2], 0.0
        # fast grains move by a part of the distance to their images, or the period is refused
        speed = float(np.linalg.norm(state.velocity[: model.grains.n, :3], axis=1).max())
        share = float(np.clip(PART * room / (step * speed), LEAST_STEP, 1.0)) if speed else 1.0
        state, _ = step_grains(model, state, share * step, solver)
        pressed += share
    raise ConvergenceError(
        f"the plate still sinks into the grains after {MOST_STEPS} steps; use fewer layers of "
        f"grains, or a larger area"
    )


def shear_response(
    radii: np.ndarray,
    size: tuple[float, float],
    pressures: np.ndarray,
    speeds: np.ndarray,
    law: ContactLaw,
    *,
    n_realisations: int = 3,
    n_steps: int | None = 400,
    distance: float = 10.0,
    **options: Any,
) -> Dataset:
    r"""Shear a layer of grains at several pressures and speeds.

    Parameters
    ----------
    radii, size, law
        As for :func:`shear_layer`.
    pressures, speeds : ndarray, shape (steps,)
        Pressures on the upper plate, Pa, and its speeds, m/s.
    n_steps : int, optional
        Number of time steps of each simulation; the second half is averaged. If None, the plate
        slides by the ``distance``.
    distance : float, way of the plate in mean diameters of the grains
    **options
        Of :func:`shear_layer`; ``solver`` also of the shear, and ``seed`` of the first realisation.

    Returns
    -------
    Dataset
        Follows ``MICRO_RESPONSE``, with the pressure and ``sliding_speed`` along ``step``. The
        traction acts on the plates, eqs (2)-(3) of the source with forces in place of tractions;
        ``mean_gap`` is the distance of the plates, and ``contact_fraction`` the share of the upper
        plate carried by grains. A step is ``converged`` if 90 % of its time steps are, and the
        grains carry the pressure within 5 % in the mean. The attribute ``ended`` has the reasons of
        other steps.

    Notes
    -----
    Rigid grains have no scale of time: the response depends on pressure and speed only by the
    inertial number :math:`I = (v / H)\, d \sqrt{\rho / p}` with the height :math:`H` of the layer,
    and holds at all p and v with the same :math:`v / \sqrt p`.
    """
    require("n_realisations", n_realisations, "[1, inf)", integer=True)
    first = options.pop("seed", 0)
    options |= {"n_steps": n_steps, "distance": distance}
    records = [
        shear_cells(radii, size, pressures, speeds, law, seed=first + k, **options)
        for k in range(n_realisations)
    ]
    ended = [str(record.attributes.get("ended", "")) for record in records]
    joined = MICRO_RESPONSE.join(records, "realisation")
    return MICRO_RESPONSE.build(joined.values, bodies=BODIES, ended="\n".join(filter(None, ended)))


def shear_cells(
    radii: np.ndarray,
    size: tuple[float, float],
    pressures: np.ndarray,
    speeds: np.ndarray,
    law: ContactLaw,
    *,
    n_steps: int | None = None,
    distance: float = 10.0,
    **options: Any,
) -> PlainDataset:
    """Shear one packing at several pressures and speeds; see :func:`shear_response`."""
    p, v = np.broadcast_arrays(
        np.atleast_1d(np.asarray(pressures, float)), np.atleast_1d(np.asarray(speeds, float))
    )
    if n_steps is not None:
        require("n_steps", n_steps, "[1, inf)", integer=True)
    ended, rows = list[str](), list[dict[str, Any]]()
    area = size[0] * size[1]
    # rigid grains rest in the same places under any pressure
    pressed, _ = shear_layer(radii, size, p[0], v[0], law, **options)
    for pressure, speed in zip(p, v, strict=True):
        require("pressure", pressure, "(0, inf)", "Pa")
        lower, upper = pressed.walls
        assert isinstance(upper, PlaneWall)
        moved = replace(upper, velocity=(speed, 0.0, 0.0), force=pressure * area)
        model, count = replace(pressed, walls=(lower, moved)), n_steps
        step = _resolving_step(model.grains, pressure)
        if count is None:
            step, count = shear_steps(model.grains, pressure, speed, distance)
        row, reason = _shear(model, pressure, area, (count, step), options.get("solver"))
        rows.append(row)
        if reason:
            ended.append(f"{pressure:.4g} Pa and {speed:.4g} m/s: {reason}")
    values: dict[str, Any] = {name: np.array([[row[name] for row in rows]]) for name in rows[0]}
    values |= {"nominal_pressure": p, "sliding_speed": v}
    values["branch"] = np.zeros(p.size, int)  # steps are independent
    return PlainDataset(values, {"ended": "; ".join(ended)} if ended else {})


def shear_steps(
    grains: Grains, pressure: float, speed: float, distance: float
) -> tuple[float, int]:
    """Return length, s, and number of the steps in which a plate slides some mean diameters.

    Raises
    ------
    CaseError
        If grains under their pressure rearrange in so short steps that the plate hardly slides.
    """
    require("speed", speed, "(0, inf)", "m/s")
    diameter = 2.0 * float(grains.radius.mean())
    step = min(_resolving_step(grains, pressure), LONGEST_SLIP * diameter / speed)
    count = int(np.ceil(distance * diameter / (speed * step)))
    if count > MOST_STEPS:
        factor = (count / MOST_STEPS) ** 2
        raise CaseError(
            f"grains do not flow steadily before {distance:g} diameters, for which the plate at "
            f"{speed:.3g} m/s takes {count:.2g} steps that resolve the grains, and {MOST_STEPS} "
            f"is the limit; use {factor**0.5:.2g} times the speed, or {factor:.2g} times less "
            f"pressure: only the speed over the root of the pressure is relevant"
        )
    return step, count


def _shear(
    model: Model, pressure: float, area: float, steps: tuple[int, float], solver: Solver | None
) -> tuple[dict[str, Any], str]:
    """Shear a layer; return its means over the second half, and why they are not steady."""
    count, step = steps
    motion = simulate_grains(model, count * step, step, solver=solver, n_frames=FRAMES)
    late, upper = slice(motion.sizes["step"] // 2, None), model.walls[1]
    force = motion["wall_force"].values[late, 1].mean(axis=0)  # of the grains on the plate
    height = motion["wall_position"].values[:, 1, 2]
    plate, disc = model.grains.n + 1, np.pi * model.grains.radius**2
    covered = []
    for frame in range(motion.sizes["frame"] // 2, motion.sizes["frame"]):
        ends, _, _ = network(motion, frame)
        covered.append(float(disc[ends[ends[:, 1] == plate, 0]].sum()) / area)
    solved, pressed = float(motion["converged"].values[late].mean()), force[2] / area
    reason = str(motion.attrs["failure"])
    if not reason and not solved > SOLVED:
        reason = f"{100.0 * (1.0 - solved):.3g} % of the steps missed the tolerance of contacts"
    if not reason and not abs(pressed / pressure - 1.0) < UNSTEADY:
        reason = (
            f"the grains carry {pressed:.3g} Pa in the mean and do not flow steadily: the plate "
            f"bounces or falls; slide farther, or slower"
        )
    row = {
        "displacement_jump": [
            height[-1] - upper.point[2],
            upper.velocity[0] * float(motion["time"][-1]),
            0.0,
        ],
        "traction": -force[[2, 0, 1]] / area,
        "mean_gap": height[late].mean(),
        "contact_fraction": min(1.0, float(np.mean(covered))),
        "converged": int(not reason),
        "active_set_iterations": 0,
        "linear_iterations": int(motion["iterations"].sum()),
        "wall_time": float(motion["wall_time"].sum()),
    }
    return row, reason


def biaxial_cell(
    radii: np.ndarray,
    pressure: float,
    strain_rate: float,
    law: ContactLaw,
    *,
    planar: bool = False,
    density: float = 2600.0,
    solver: Solver | None = None,
    seed: int = 0,
) -> tuple[Model, float]:
    r"""Compact grains in a periodic cell under a pressure, for a compression test along z.

    Parameters
    ----------
    radii, law, planar, density, seed
        As for :func:`compact`.
    pressure : float
        Pressure of the isotropic compaction, and on the sides of the cell during the test, Pa. In a
        cell of spheres it is the mean of the two lateral stresses.
    strain_rate : float, rate of the logarithmic axial strain, compression positive, 1/s
    solver : Solver, optional

    Returns
    -------
    model : Model, model to pass to :func:`multiscale.macro.granulate.simulate_grains`
    step : float, length of a step that resolves the rearrangements, s

    Raises
    ------
    CaseError
        If the pressure is not positive or the rate is negative.
    ConvergenceError
        If the grains are not at rest under the pressure.

    Notes
    -----
    The grains follow the mean strain, with deviations due to their contacts, and their velocities
    are halved in every step: the response is quasi-static where the inertial number
    :math:`I = \dot\varepsilon \sqrt{m / (p R)}` is at most 1e-3 (for discs, R is the thickness).
    """
    require("strain_rate", strain_rate, "[0, inf)", "1/s")
    rigid = replace(law, compliance=0.0)  # compliant contacts creep without end
    packing = compact(
        radii, pressure, rigid, planar=planar, density=density, solver=solver, seed=seed
    )
    if packing.attrs["failure"]:
        raise ConvergenceError(f"the compaction before the test failed: {packing.attrs['failure']}")
    grains = Grains(
        packing["position"].values[-1],
        packing["radius"].values,
        density,
        thickness=1.0 if planar else None,
    )
    x, y, z = packing["period"].values[-1].tolist()
    step = _resolving_step(grains, pressure)
    model = Model(
        grains,
        (),
        law,
        (0.0, 0.0, 0.0),
        (x, y, z),
        damping_rate=float(np.log(2.0)) / step,
        pressure=pressure,
        strain_rate=(None, None, -strain_rate),
    )
    return model, step


def biaxial_curve(result: Dataset) -> Dataset:
    r"""Return stress ratio and volumetric strain against axial strain.

    Parameters
    ----------
    result : Dataset, simulation of a :func:`biaxial_cell`; follows ``GRANULATE``

    Returns
    -------
    Dataset
        Along ``step``: ``axial_strain`` and ``volumetric_strain``, logarithmic, compression
        positive, ``stress_ratio`` q/p and ``mobilised_friction`` :math:`\sin \phi`, dimensionless.

    Notes
    -----
    With the axial stress :math:`\sigma_1` and the mean lateral stress :math:`\sigma_3`, compression
    positive,

    .. math::
        q / p = \frac{\sigma_1 - \sigma_3}{(\sigma_1 + 2 \sigma_3) / 3} \text{ for spheres},
        \quad \frac{\sigma_1 - \sigma_3}{\sigma_1 + \sigma_3} \text{ for discs}, \qquad
        \sin \phi = \frac{\sigma_1 - \sigma_3}{\sigma_1 + \sigma_3}.    \tag{1}
    """
    import xarray as xr

    planar = "thickness" in result.attrs
    stress, strain = -result["stress"].values, -result["strain"].values
    axial, lateral = stress[:, 2], stress[:, 0] if planar else stress[:, :2].mean(axis=1)
    mean = 0.5 * (axial + lateral) if planar else (axial + 2.0 * lateral) / 3.0
    difference = 0.5 * (axial - lateral) if planar else axial - lateral
    with np.errstate(invalid="ignore", divide="ignore"):  # NaN in a cell without stress
        values = {
            "axial_strain": (strain[:, 2], "axial strain"),
            "volumetric_strain": (strain.sum(axis=1), "volumetric strain"),
            "stress_ratio": (difference / mean, "stress ratio q/p"),
            "mobilised_friction": ((axial - lateral) / (axial + lateral), "sine of the angle"),
        }
    return xr.Dataset(
        {
            name: ("step", value, {"units": "1", "long_name": meaning})
            for name, (value, meaning) in values.items()
        },
        coords={"step": result["step"]},
    )
