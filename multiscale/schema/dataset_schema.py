"""Schemas: names, dimensions and units of datasets."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from multiscale.errors import SchemaError, listed
from multiscale.schema.shown import SHOWN

if TYPE_CHECKING:
    import numpy as np
    from xarray import Coordinates
    from xarray import Dataset as Dataset
else:  # a name for annotations, without the slow import
    Dataset = Any

COMPONENTS = ("n", "t1", "t2")
"""Labels of the dimension ``component``: the normal and the two tangents of the joint."""


@dataclass(frozen=True)
class Variable:
    """Dimensions, unit (UDUNITS spelling) and meaning of a variable."""

    dims: tuple[str, ...]
    units: str
    long_name: str
    flags: Sequence[str] = ()  # meanings of 0, 1, ...
    coordinate: bool = False  # whether its values label its dimension
    uncertain_part: str = ""  # the variable that the error of a stiffness in series comes from


@dataclass(frozen=True)
class PlainDataset:
    """Plain arrays of a dataset, which are cheaper to make, to send and to join."""

    values: Mapping[str, Any]  # an array for each variable
    attributes: Mapping[str, str | float | int] = field(default_factory=dict)


@dataclass(frozen=True)
class Schema:
    """Names, dimensions and units of a kind of dataset; ``news`` is what earlier versions lack.

    ``gone`` has the remedies for variables of earlier versions that no answer takes any more.
    """

    name: str
    version: int
    variables: Mapping[str, Variable]
    optional: Mapping[str, Variable] = field(default_factory=dict)
    news: str = ""
    gone: Mapping[str, str] = field(default_factory=dict)

    def with_samples(self, **names: Iterable[str]) -> "Schema":
        """Add the samples ``..._sample`` of optional variables, named for each dimension."""
        samples = {
            f"{name}_sample": Variable(
                (along, *mean.dims), mean.units, f"{mean.long_name}, samples"
            )
            for along, sampled in names.items()
            for name, mean in ((name, self.optional[name]) for name in sampled)
        }
        return replace(self, optional={**self.optional, **samples})

    def with_intervals(self, *names: str) -> "Schema":
        """Add the intervals of optional variables: of the mean law, and of one part."""
        meanings = {
            "mean_law": "95 % interval of the mean law",
            "one_part": "95 % interval of the next part, with few cells in its interface",
        }
        ends = {
            f"{name}_{kind}": Variable(
                ("limit", *answer.dims), answer.units, f"{answer.long_name}, {meaning}"
            )
            for name, answer in ((name, self.optional[name]) for name in names)
            for kind, meaning in meanings.items()
        }
        return replace(self, optional={**self.optional, **ends})

    def check(self, dataset: Dataset) -> None:
        """Raise if a variable is missing, is gone, or has other dimensions or units."""
        faults = [
            f"{name}: not supported any more; {remedy}"
            for name, remedy in self.gone.items()
            if name in dataset.variables
        ]
        for name, variable in {**self.variables, **self.optional}.items():
            if name not in dataset.variables:
                if name in self.variables:
                    faults.append(
                        f"{name}: missing; add it ({variable.long_name}, {variable.units}, "
                        f"dimensions {variable.dims})"
                    )
                continue
            given = dataset.variables[name]
            if given.dims != variable.dims:
                faults.append(
                    f"{name}: dimensions {given.dims}, expected {variable.dims}; rename or "
                    f"transpose them"
                )
            if given.attrs.get("units") != variable.units:
                faults.append(
                    f"{name}: units {given.attrs.get('units')!r}, expected {variable.units!r}; "
                    f"convert the values and set the attribute units"
                )
        if faults:
            raise SchemaError(
                f"not a {self.name!r} dataset (schema version {self.version}):\n  "
                + "\n  ".join(faults)
            )

    def build(self, values: Mapping[str, Any], **attributes: str | float | int) -> Dataset:
        """Build a dataset from plain arrays; dimensions, units and labels come from the schema."""
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
        """Concatenate arrays along the first dimension ``dim``; other arrays must be equal."""
        import numpy as np

        known, joined = {**self.variables, **self.optional}, {}
        along = {name for name, variable in known.items() if variable.dims[:1] == (dim,)}
        counts = [len(next(data.values[k] for k in data.values if k in along)) for data in datasets]
        names = dict.fromkeys(name for data in datasets for name in data.values)
        for name in sorted(names, key=along.__contains__):  # first the equal arrays
            arrays = [data.values.get(name) for data in datasets]
            given = [array for array in arrays if array is not None]
            first = np.asarray(given[0])
            if name in along:
                missing = np.full(first.shape[1:], np.nan)
                joined[name] = np.concatenate(
                    [
                        [missing] * count if array is None else array
                        for array, count in zip(arrays, counts, strict=True)
                    ]
                )
            elif all(np.array_equal(first, array) for array in given):
                joined[name] = first
            else:
                raise SchemaError(
                    f"{name} is not the same in all {self.name!r} datasets to be joined along "
                    f"{dim}; compute them for the same {name}, in a separate folder"
                )
        return PlainDataset(joined)

    def _describe(self, values: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
        """Add dimensions and attributes to arrays; return also the names of the coordinates."""
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
        return described, [name for name in values if known[name].coordinate]


@lru_cache
def _labels(sizes: tuple[tuple[str, int], ...]) -> "Coordinates":
    """Label dimensions; cached, as indexes take as long to make as the rest of a small dataset."""
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


def read_schemas(tables: dict[str, dict[str, Any]]) -> dict[str, Schema]:
    """Read the kinds of datasets from their tables; every key must have a meaning."""
    shared = {name: _described(name, group) for name, group in tables.pop("shared").items()}
    schemas: dict[str, Schema] = {}
    for name, keys in tables.items():
        version = keys.pop("version")
        if "like" in keys:  # the same variables under another name
            schemas[name] = replace(schemas[keys.pop("like")], name=name, version=version, news="")
        else:
            required = _described(name, keys.pop("variables"))
            optional = _described(name, keys.pop("optional", {}))
            for group in keys.pop("shared", ()):
                optional |= shared[group]
            plain = Schema(
                name, version, required, optional, keys.pop("news", ""), keys.pop("gone", {})
            )
            sampled = plain.with_samples(**keys.pop("samples", {}))
            schemas[name] = sampled.with_intervals(*keys.pop("intervals", ()))
        if keys:
            raise SchemaError(f"kind {name!r} of datasets has the unknown keys {listed(keys)}")
    return schemas


def _described(kind: str, rows: Mapping[str, list[Any]]) -> dict[str, Variable]:
    """Return the variables in rows of dimensions, unit, meaning, and further fields by name."""
    described = {}
    for name, row in rows.items():
        try:
            dims, unit, meaning, *more = row
            described[name] = Variable(tuple(dims.split()), unit, meaning, **dict(*more))
        except (TypeError, ValueError) as error:
            raise SchemaError(f"variable {name!r} of {kind!r} datasets: {error}") from None
    return described


def with_cautions(dataset: Dataset, *lines: str) -> Dataset:
    """Return a dataset with further lines in the attribute ``cautions``, without empty lines."""
    cautions = (str(dataset.attrs.get("cautions", "")), *lines)
    return dataset.assign_attrs(cautions="\n".join(filter(None, cautions)))


LOADING, UNLOADING, HOLDING = range(3)
"""Branches of the path of a cell, the flags of the variable ``branch``."""


def branch_of(load: "np.ndarray") -> "np.ndarray":
    """Return the branch of each step of a path."""
    import numpy as np

    load = np.maximum(np.asarray(load, dtype=float), 0.0)
    before = np.maximum.accumulate([0.0, *load[:-1]])
    above, below = (load > before * (1.0 + 1e-9)), (load < before * (1.0 - 1e-9))
    return np.select([above, below], [LOADING, UNLOADING], HOLDING)
