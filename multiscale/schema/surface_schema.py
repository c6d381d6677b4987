"""Schema of the statistics of a measured surface."""

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["SURFACE_STATISTICS"]


def _number(units: str, long_name: str) -> Variable:
    return Variable((), units, long_name)


SURFACE_STATISTICS = Schema(
    name="surface_statistics",
    version=1,
    variables={
        "height": Variable(("y", "x"), "m", "height without trend, at some of the points"),
        "wavenumber": Variable(("bin",), "rad m-1", "wavenumber", coordinate=True),
        "bearing_share": Variable(
            ("level",), "1", "share of points at or above a height", coordinate=True
        ),
        "bearing_height": Variable(("level",), "m", "height above the mean"),
        "dimensions": _number("1", "2 for a map and 1 for a line scan"),
        "size": Variable(("direction",), "m", "edge lengths along x and y"),
        "rms_height": _number("m", "root mean square height"),
        "rms_slope": _number("1", "root mean square slope"),
        "longest_wave": _number("m", "wave beyond which a hundredth of the mean square height is"),
        "shortest_wave": _number("m", "wave below which a hundredth of the mean square slope is"),
        "longest_reliable": _number("m", "longest reliable wave"),
        "shortest_reliable": _number("m", "shortest reliable wave"),
        "skewness": _number("1", "skewness of the heights"),
        "kurtosis": _number("1", "kurtosis of the heights, 3 if they are Gaussian"),
        "peak_to_valley": _number("m", "highest less lowest height"),
        "nayak_parameter": _number("1", "Nayak's parameter of the reliable waves"),
        "filled_share": _number("1", "share of undefined points, which were filled"),
        "hurst_exponent": _number("1", "Hurst exponent of the self-affine fit"),
        "roll_off": _number("m", "wave above which the fit is flat"),
        "fitted_to": _number("m", "shortest wave of the fit"),
        "fit_level": _number("1", "density of the flat part, in the unit of the density"),
        "fit_deviation": _number("1", "rms deviation of the density from the fit, decades"),
        "lay_angle": _number("rad", "angle of the lay to the x axis"),
        "lay_ratio": _number("1", "rms slope across the lay over the slope along it"),
    },
    optional={
        "power_spectral_density": Variable(("bin",), "m4", "radially averaged spectral density"),
        "profile_density": Variable(("bin",), "m3", "spectral density of the line scan"),
    },
)
