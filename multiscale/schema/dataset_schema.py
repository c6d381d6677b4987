"""What a schema is: names, dimensions and units of a dataset."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from multiscale.errors import SchemaError
from multiscale.schema.shown import SHOWN

if TYPE_CHECKING:
    from xarray import Coordinates, Dataset
else:  # which takes long to load, where nothing but an annotation needs it
    Dataset = Any

__all__ = [
    "BUDGET",
    "COMPONENTS",
    "SENSITIVITY",
    "Dataset",
    "PlainDataset",
    "Schema",
    "Variable",
    "with_cautions",
]

COMPONENTS = ("n", "t1", "t2")
"""Labels of the dimension ``component``: the normal and the two tangents of the joint."""


@dataclass(frozen=True)
class Variable:
    """Dimensions, unit (UDUNITS spelling) and meaning of one variable.

    Flags are the meanings of 0, 1, ...; a required variable may be a coordinate. A stiffness of
    parts in series has its whole error from one of them, the variable ``uncertain_part``.
    """

    dims: tuple[str, ...]
    units: str
    long_name: str
    flags: tuple[str, ...] = ()
    coordinate: bool = False
    uncertain_part: str = ""


@dataclass(frozen=True)
class PlainDataset:
    """What a dataset is built from: cheaper to make, to send and to join than the dataset."""

    values: Mapping[str, Any]  # one array per variable
    attributes: Mapping[str, str | float | int] = field(default_factory=dict)


@dataclass(frozen=True)
class Schema:
    """Names, dimensions and units of one kind of dataset.

    Parameters
    ----------
    name, version
        Written into every file; :mod:`multiscale.io` refuses another version.
    variables : mapping of str to Variable, what must be there
    optional : mapping of str to Variable
        What may be there, and then in this form. Coordinates are listed here too.
    news : str
        What the last version has that earlier ones lack; told where an earlier one is refused.
    """

    name: str
    version: int
    variables: Mapping[str, Variable]
    optional: Mapping[str, Variable] = field(default_factory=dict)
    news: str = ""

    def with_samples(self, **names: Iterable[str]) -> "Schema":
        """Add the samples ``..._sample`` of optional variables, named for each dimension."""
        samples = {
            f"{name}_sample": Variable((along, *one.dims), one.units, f"{one.long_name}, samples")
            for along, own in names.items()
            for name, one in ((name, self.optional[name]) for name in own)
        }
        return replace(self, optional={**self.optional, **samples})

    def with_intervals(self, *names: str) -> "Schema":
        """Add the intervals of optional variables: of the mean law, and of one part."""
        told = {
            "mean_law": "95 % interval of the mean law",
            "one_part": "95 % interval of the next part, whose interface holds few cells",
        }
        ends = {
            f"{name}_{kind}": Variable(("limit", *one.dims), one.units, f"{one.long_name}, {what}")
            for name, one in ((name, self.optional[name]) for name in names)
            for kind, what in told.items()
        }
        return replace(self, optional={**self.optional, **ends})

    def check(self, dataset: Dataset) -> None:
        """Raise if a variable is missing or has other dimensions or units."""
        faults = []
        for name, variable in {**self.variables, **self.optional}.items():
            if name not in dataset.variables:
                if name in self.variables:
                    faults.append(
                        f"{name}: missing; add it ({variable.long_name}, {variable.units}, "
                        f"dimensions {variable.dims})"
                    )
                continue
            found = dataset.variables[name]
            if found.dims != variable.dims:
                faults.append(
                    f"{name}: dimensions {found.dims}, expected {variable.dims}; rename or "
                    f"transpose them"
                )
            if found.attrs.get("units") != variable.units:
                faults.append(
                    f"{name}: units {found.attrs.get('units')!r}, expected {variable.units!r}; "
                    f"convert the values and set the attribute units"
                )
        if faults:
            raise SchemaError(
                f"not a {self.name!r} dataset (schema version {self.version}):\n  "
                + "\n  ".join(faults)
            )

    def build(self, values: Mapping[str, Any], **attributes: str | float | int) -> Dataset:
        """Make a dataset from plain arrays; dimensions, units and labels come from the schema."""
        import xarray as xr

        described, coordinates = self._describe(values)
        sizes: dict[str, int] = {}
        for variable in described.values():
            sizes |= variable.sizes
        labels = _labels(tuple((dim, size) for dim, size in sizes.items() if dim not in described))
        dataset = xr.Dataset(described, labels, attributes).set_coords(coordinates)
        self.check(dataset)
        return dataset

    def assign(self, dataset: Dataset, values: Mapping[str, Any]) -> Dataset:
        """Add variables to a dataset; dimensions and units come from the schema."""
        described, coordinates = self._describe(values)
        return dataset.assign(described).set_coords(coordinates)

    def plain(self, dataset: Dataset) -> PlainDataset:
        """Return the variables of a dataset as plain arrays, with its attributes."""
        known = {**self.variables, **self.optional}
        values = {name: dataset[name].values for name in known if name in dataset.variables}
        return PlainDataset(values, dataset.attrs)

    def join(self, datasets: Sequence[PlainDataset], dim: str) -> PlainDataset:
        """Join arrays whose first dimension is ``dim``; the others are the same in all datasets.

        An array that a dataset lacks is NaN there. What is joined has no attributes.
        """
        import numpy as np

        known, joined = {**self.variables, **self.optional}, {}
        along = {name for name, variable in known.items() if variable.dims[:1] == (dim,)}
        counts = [len(next(one.values[k] for k in one.values if k in along)) for one in datasets]
        names = dict.fromkeys(name for one in datasets for name in one.values)
        for name in sorted(names, key=along.__contains__):  # first those that all share
            found = [one.values.get(name) for one in datasets]
            given = [one for one in found if one is not None]
            first = np.asarray(given[0])
            if name in along:
                lacking = np.full(first.shape[1:], np.nan)
                joined[name] = np.concatenate(
                    [
                        [lacking] * count if one is None else one
                        for one, count in zip(found, counts, strict=True)
                    ]
                )
            elif all(np.array_equal(first, one) for one in given):
                joined[name] = first
            else:
                raise SchemaError(
                    f"{name} is not the same in all {self.name!r} datasets to be joined along "
                    f"{dim}; compute them for the same {name}, in a folder of their own"
                )
        return PlainDataset(joined)

    def _describe(self, values: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
        """Give arrays their dimensions and attributes, and tell which of them label dimensions."""
        import numpy as np
        import xarray as xr

        known = {**self.variables, **self.optional}
        described = {}
        for name, value in values.items():
            if name not in known:
                raise SchemaError(f"a {self.name!r} dataset has no variable {name!r}")
            variable = known[name]
            attrs: dict[str, Any] = {"units": variable.units, "long_name": variable.long_name}
            if name in SHOWN:
                attrs |= {"long_name": SHOWN[name].label, "comment": variable.long_name}
            flags = ("failed", "converged") if name == "converged" else variable.flags
            if flags:
                attrs |= {"flag_values": [*range(len(flags))], "flag_meanings": " ".join(flags)}
            data = np.asarray(value)
            plain = data.dtype.kind in PLAIN
            described[name] = xr.Variable(variable.dims, data, attrs, fastpath=plain)
        along = [
            name
            for name in values
            if known[name].coordinate or (name in self.optional and name in COORDINATES)
        ]
        return described, along


@lru_cache
def _labels(sizes: tuple[tuple[str, int], ...]) -> "Coordinates":
    """Label dimensions; indexes take as long to make as the rest of a small dataset."""
    import numpy as np
    import pandas as pd
    import xarray as xr

    indexes = {}
    for dim, size in sizes:
        label = np.array(COMPONENTS[:size]) if dim == "component" else np.arange(size)
        indexes[dim] = xr.indexes.PandasIndex(pd.Index(label), dim, label.dtype)
    variables = {dim: index.create_variables()[dim] for dim, index in indexes.items()}
    return xr.Coordinates(variables, indexes)


PLAIN = "biufU"
"""Kinds of arrays that need no conversion, for which xarray would import dask and pint."""

COORDINATES = frozenset(
    {
        "nominal_pressure",
        "sliding_distance",
        "sliding_speed",
        "temperature",
        "rms_height",
        "rms_slope",
        "nayak_parameter",
        "preload",
        "load_factor",
        "method",
        "scene",
        "time",
        "law",
    }
)
"""Physical values that label a dimension without being its index."""

BUDGET = {
    "error_half_width": Variable(
        ("quantity", "error_term", "step"),
        "1",
        "half-width of the 95 % interval of the error over the value, about its bias",
    ),
    "error_bias": Variable(
        ("quantity", "error_term", "step"), "1", "part of the error whose sign is known, estimated"
    ),
    "error_total": Variable(
        ("quantity", "step"),
        "1",
        "sampling, fit and the terms given together, NaN if one is not known",
    ),
}
"""Errors that laws and results carry."""

SENSITIVITY = {
    "sensitivity": Variable(
        ("parameter", "quantity", "step"),
        "1",
        "relative change of the answer if a parameter is larger by its half-width, to first order",
    )
}
"""What results carry of parameters with a half-width of their own."""


def with_cautions(dataset: Dataset, *lines: str) -> Dataset:
    """Return a dataset whose attribute ``cautions`` has further lines; empty ones are left out."""
    found = (str(dataset.attrs.get("cautions", "")), *lines)
    return dataset.assign_attrs(cautions="\n".join(filter(None, found)))
