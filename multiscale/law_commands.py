"""Commands that fit an interface law, and that write it for other codes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from multiscale.errors import CaseError
from multiscale.options import check_dataset_file, load_with, out_option
from multiscale.printing import print_lines, print_table, warn_of
from multiscale.units import to_si

if TYPE_CHECKING:
    import numpy as np

    from multiscale.pipeline.showing import Rows
    from multiscale.upscaling.specimens import Prediction

PREDICTED = 5  # number of pressures of a prediction that are chosen in the range of the data


def fit_command(
    response: Annotated[
        Path,
        typer.Argument(help="Response to fit; or a table .csv of measured stiffnesses or gaps."),
    ],
    out: Annotated[Path, out_option("Law to write.")] = Path("interface_law.nc"),
    family: Annotated[
        str,
        typer.Option(
            help="convex_decreasing (the default of a response), exponential or power; of a table "
            "the best admissible family if not given."
        ),
    ] = "",
    shear: Annotated[
        Path | None, typer.Option(help="Response of sheared cells, for friction.")
    ] = None,
    sliding: Annotated[
        Path | None, typer.Option(help="Response of sliding cells, for friction.")
    ] = None,
    pressure: Annotated[
        list[str] | None,
        typer.Option(help='Pressure such as "5 MPa" at which the law of a table is printed.'),
    ] = None,
    measured: Annotated[
        str, typer.Option(help="Case of the cells with tables `measured` that calibrate the law.")
    ] = "",
) -> None:
    """Fit the interface law to a response, or to a table of measurements."""
    check_dataset_file(out)
    if response.suffix.lower() != ".csv":
        if pressure:
            raise CaseError(f"--pressure needs a table .csv, got {response}")
        _fit_response(response, out, family or "convex_decreasing", shear, sliding, measured)
        return
    if shear or sliding or measured:
        raise CaseError(
            f"{response}: --shear, --sliding and --measured belong to a response, not to a table"
        )
    _fit_table(response, out, family, [to_si(text, "Pa") for text in pressure or ()])


def _fit_table(table: Path, out: Path, family: str, pressures: list[float]) -> None:
    import numpy as np

    from multiscale.io import save_law
    from multiscale.upscaling import best_family, fit_law, predict, read_observations
    from multiscale.upscaling.specimens import with_specimen_budget
    from multiscale.upscaling.tables import quantity_of

    observations = read_observations(table, quantity_of(table))
    chosen = family or best_family(observations)[0]
    law = with_specimen_budget(fit_law(observations, family=chosen), observations)
    low, high = (float(law.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    pressure = np.array(pressures or np.geomspace(low, high, PREDICTED))
    predictions = predict(law, observations, pressure)
    cautions = [*law.attrs["cautions"].splitlines(), *predictions.unknown]
    outside = pressure[(pressure < 0.999 * low) | (pressure > 1.001 * high)]
    if outside.size:
        listed = ", ".join(f"{1e-6 * p:.4g}" for p in outside)
        cautions.append(f"pressures of {listed} MPa lie outside the data; the law extrapolates")
    save_law(law, out)
    warn_of(cautions)
    n, points = observations.n_realisations, observations.pressure.size
    name = "mean_gap" if observations.quantity == "gap" else "stiffness"
    error = law["error_half_width"].sel(quantity=name, error_term="fit").max().item()
    fit = f"{100.0 * error:.2g} % error" if np.isfinite(error) else "unknown error"
    title = (
        f"{chosen}{'' if family else ' (the best family)'}: {n} specimen{'s' * (n > 1)} at "
        f"{points} pressures, {fit} of the fit between pressures"
    )
    print_table(title, *_tabulate(name, pressure, predictions))
    typer.echo(f"law: {out}")


def _tabulate(name: str, pressure: "np.ndarray", prediction: "Prediction") -> "Rows":
    """Head and rows of predictions at pressures, Pa, with their intervals."""
    import xarray as xr

    from multiscale.pipeline.showing import Table

    ends = ("limit", "step")
    values = {
        "nominal_pressure": ("step", pressure),
        name: ("step", prediction.value),
        f"{name}_mean_law": (ends, prediction.mean_law),
        f"{name}_next": (ends, prediction.next_specimen),
    }
    heads = {f"{name}:next": "next specimen, 95 %"}
    columns = ("nominal_pressure", *(f"{name}{form}" for form in ("", ":mean_law", ":next")))
    return Table(columns, heads).rows(xr.Dataset(values))


def _fit_response(
    response: Path, out: Path, family: str, shear: Path | None, sliding: Path | None, measured: str
) -> None:
    """Fit a law to cells, which the measurements of a case may calibrate, and print it."""
    from multiscale.io import open_dataset, open_response, save_law
    from multiscale.pipeline.calibrated_law import calibrate_case, calibration_tables
    from multiscale.pipeline.runner import job_in
    from multiscale.schema import SHEAR_RESPONSE, SLIDING_RESPONSE
    from multiscale.upscaling import fit_branches
    from multiscale.upscaling.branches import describe_shear

    case = load_with("measured", measured) if measured else None
    options: dict[str, Any] = {}
    if case is not None:
        fit = case.law
        options = {"apart": fit.apart, "n_terms": fit.terms, "n_samples": fit.samples}
    law = fit_branches(
        open_response(response),
        shear=None if shear is None else open_dataset(shear, SHEAR_RESPONSE),
        sliding=None if sliding is None else open_dataset(sliding, SLIDING_RESPONSE),
        family=family,
        **options,
    )
    if case is not None:
        law = calibrate_case(case, law, job_in(out.parent)).law
    save_law(law, out)
    warn_of(law.attrs["cautions"].splitlines())
    for calibration in calibration_tables(law):
        print_table(*calibration)
    if case is not None:
        typer.echo(f"{law.attrs['effective_draws']:.3g} independent draws")
    typer.echo(law.attrs["branches"])
    print_lines(describe_shear(law))


def export_command(
    law: Annotated[Path, typer.Argument(help="Interface law to export.")],
    out: Annotated[
        Path, typer.Argument(help="File to write: .inp for Abaqus and CalculiX, or a .csv table.")
    ],
    friction: Annotated[
        str, typer.Option(help="abaqus or calculix: write friction and stick stiffness for it.")
    ] = "",
    stick_pressure: Annotated[
        str,
        typer.Option(help='Pressure at which the stick stiffness is written, such as "20 MPa".'),
    ] = "",
    conductance: Annotated[
        str, typer.Option(help="abaqus or calculix: write the thermal conductance for it.")
    ] = "",
    leakage: Annotated[
        bool, typer.Option("--leakage", help="Write hydraulic apertures, to a .csv table.")
    ] = False,
    face_to_face: Annotated[
        bool,
        typer.Option(
            "--face-to-face", help="Table that CalculiX 2.20 reads with TYPE=SURFACE TO SURFACE."
        ),
    ] = False,
    name: Annotated[str, typer.Option(help="Name of the surface interaction.")] = "ROUGH",
    tolerance: Annotated[float, typer.Option(help="Error of the pressure between points.")] = 0.01,
    length_unit: Annotated[str, typer.Option(help="Unit of lengths in the file.")] = "mm",
    pressure_unit: Annotated[str, typer.Option(help="Unit of pressures in the file.")] = "MPa",
) -> None:
    """Write an interface law for other finite-element codes."""
    from multiscale.io import open_law, try_to_write
    from multiscale.upscaling import write_law_table, write_pressure_overclosure
    from multiscale.upscaling.reading import refuse_band

    dataset = open_law(law)
    try_to_write(out)
    if out.suffix == ".csv":
        if friction or conductance or face_to_face:
            raise CaseError(
                f"--friction, --conductance and --face-to-face are written to an .inp file, got "
                f"{out}"
            )
        write_law_table(
            dataset, out, length_unit=length_unit, pressure_unit=pressure_unit, leakage=leakage
        )
        refusal = refuse_band(dataset)
        warn_of([f"the table has no band: {refusal}"] if refusal else [])
    elif leakage:
        raise CaseError(f"--leakage is written to a .csv table, got {out}")
    elif out.suffix == ".inp":
        write_pressure_overclosure(
            dataset,
            out,
            name=name,
            length_unit=length_unit,
            pressure_unit=pressure_unit,
            tolerance=tolerance,
            friction_for=friction or None,  # type: ignore[arg-type]  # which refuses another code
            stick_pressure=to_si(stick_pressure, "Pa") if stick_pressure else None,
            conductance_for=conductance or None,  # type: ignore[arg-type]  # as friction_for
            face_to_face=face_to_face,
        )
    else:
        raise CaseError(f"a law is exported to a file with the ending .inp or .csv, got {out}")
    typer.echo(f"written: {out}")
