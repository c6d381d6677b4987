"""What a bench measured, with the machine and the versions that it was measured with."""

import os
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from multiscale.bench.measure import THREADS
from multiscale.schema import WORK_PRECISION

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["load_average", "record", "versions"]


def record(
    rows: Sequence[Mapping[str, float | str]],
    histories: Mapping[str, np.ndarray] | None = None,
    *,
    title: str,
    versions: str,
    load_before: float,
    threads: int = THREADS,
    cautions: Iterable[str] = (),
    **attributes: str | float,
) -> "xr.Dataset":
    """Join measured runs into a dataset.

    Parameters
    ----------
    rows : sequence of mapping
        One for each run, all with the same names: variables of ``WORK_PRECISION`` along ``run``.
    histories : mapping of str to ndarray, optional
        Variables along ``sample``.
    title : str
        What was compared.
    versions : str
        Of the codes, from :func:`versions`.
    load_before : float
        Of the machine, from :func:`load_average`, before the first run.
    threads : int
        That a run could use.
    cautions : iterable of str
        One sentence each.
    **attributes
        Further attributes of the dataset.

    Returns
    -------
    Dataset
        Follows ``WORK_PRECISION``.
    """
    return WORK_PRECISION.build(
        {name: np.array([row[name] for row in rows]) for name in rows[0]} | dict(histories or {}),
        title=title,
        versions=versions,
        threads=threads,
        cores=os.cpu_count() or 1,
        load_before=load_before,
        load_after=load_average(),
        cautions="\n".join(cautions),
        **attributes,
    )


def load_average() -> float:
    """Return the number of processes that ran or waited to, mean of the last minute."""
    return os.getloadavg()[0]


def versions(*packages: str) -> str:
    """Name the versions of this package and of those others that are installed."""
    return ", ".join(
        f"{name} {version(name)}"
        for name in ("multiscale", *packages)
        if find_spec(name) is not None
    )
