"""What a page says of the roughness of measured bodies, from the map to the cells."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["list_cutoffs", "tabulate_roughness"]

HEAD = (
    "measured",
    "rms height (µm)",
    "rms slope",
    "longest wave (µm)",
    "shortest wave (µm)",
    "filled (%)",
)


def tabulate_roughness(response: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text: each measured body as map, windows and cells; none if none.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``.
    """
    rows: list[tuple[str, ...]] = []
    for body in response["body"].values if "body" in response.dims else ():
        one = response.sel(body=body)
        windows = ", ".join(f"{100.0 * share:.2g}" for share in one["filled_share"].values)
        filled = {"map": f"{100.0 * float(one['map_filled_share']):.2g}", "windows": windows}
        for stage in map(str, one["stage"].values):
            at = one.sel(stage=stage)
            rows.append(
                (
                    f"{body} {stage}",
                    f"{1e6 * float(at['body_rms_height']):.3g}",
                    f"{float(at['body_rms_slope']):.3g}",
                    f"{1e6 * float(at['body_longest_wave']):.3g}",
                    f"{1e6 * float(at['body_shortest_wave']):.3g}",
                    filled.get(stage, ""),
                )
            )
    return HEAD, rows


def list_cutoffs(response: "xr.Dataset") -> list[str]:
    """Say of each measured body which waves its cells leave out."""
    return [
        f"The cells of {body} keep the waves down to {response.attrs[f'cutoff_{body}']}."
        for body in (response["body"].values if "body" in response.dims else ())
    ]
