"""Every stiff and extreme case of the table: converged, refused with a sentence, or failed."""

import signal
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib import import_module
from itertools import chain, product
from time import perf_counter
from typing import NamedTuple

import numpy as np

from multiscale.bench import STABILITY_FAMILIES, STABILITY_FILE
from multiscale.bench.measure import versions
from multiscale.errors import MultiscaleError
from multiscale.executors import call_on_one_thread, process_pool
from multiscale.schema import STABILITY, Dataset

OUTCOMES = ("failed", "refused", "converged")  # meanings of the flag outcome: 0, 1, 2
LONGEST = 1800  # seconds after which a case hangs


@dataclass(frozen=True)
class StabilityCase:
    """A function of its family with its arguments, and the largest allowed residual."""

    family: str
    parameters: tuple[tuple[str, float | str], ...]
    tolerance: float

    def __str__(self) -> str:
        values = (
            f"{name} = {value}" if isinstance(value, str) else f"{name} = {value:g}"
            for name, value in self.parameters
        )
        return ", ".join(values)


class Outcome(NamedTuple):
    """Flag of the outcome, verified residual, seconds, and the reason if there is no answer."""

    outcome: int
    residual: float = np.nan
    seconds: float = np.nan
    sentence: str = ""


def read_cases() -> list[StabilityCase]:
    """Return the cases of the table, in its order."""
    cases = []
    tables = tomllib.loads(STABILITY_FILE.read_text()).values()
    for family, table in chain.from_iterable(families.items() for families in tables):
        tolerance = table.pop("tolerance")
        for values in product(*table.values()):
            cases.append(StabilityCase(family, tuple(zip(table, values, strict=True)), tolerance))
    return cases


def check_stability(
    cases: list[StabilityCase],
    *,
    jobs: int = 1,
    report: Callable[[str], None] = lambda line: None,
    keep: Callable[[Dataset], None] = lambda dataset: None,
) -> Dataset:
    """Run cases in separate processes, with one thread for kernels."""
    outcomes: list[Outcome] = []
    for case, row in zip(cases, _run_all(cases, jobs), strict=True):
        outcomes.append(row)
        answer = row.sentence or f"({row.residual:.1e})"
        report(f"{case.family}: {case}: {OUTCOMES[row.outcome]} {answer}")
        keep(_join(cases, outcomes))
    return _join(cases, outcomes)


def _join(cases: list[StabilityCase], outcomes: list[Outcome]) -> Dataset:
    done = cases[: len(outcomes)]
    outcome, residual, seconds, sentence = zip(*outcomes, strict=True)
    return STABILITY.build(
        {
            "family": [case.family for case in done],
            "parameters": [str(case) for case in done],
            "tolerance": np.array([case.tolerance for case in done]),
            "outcome": np.array(outcome),
            "residual": np.array(residual),
            "wall_time": np.array(seconds),
            "sentence": list(sentence),
        },
        title="stiff and extreme cases",
        versions=versions("numpy", "scipy", "numba"),
        cases=len(cases),
    )


def _run_all(cases: list[StabilityCase], jobs: int) -> Iterator[Outcome]:
    """Run the cases in order; a case that kills its process does not stop the others."""
    remaining = list(cases)
    while remaining:
        with process_pool(jobs) as executor:
            futures = [executor.submit(call_on_one_thread, solve_case, case) for case in remaining]
            try:
                for future in futures:
                    yield future.result()
                    remaining.pop(0)
            except BrokenProcessPool:
                pass
        if remaining:  # run the next case in a separate process, to see whether it died
            yield _run_separately(remaining.pop(0))


def _run_separately(case: StabilityCase) -> Outcome:
    with process_pool(1) as executor:
        try:
            return executor.submit(call_on_one_thread, solve_case, case).result()
        except BrokenProcessPool:
            return Outcome(0, sentence="its process died")


def _give_up(*_: object) -> None:
    raise TimeoutError(f"no answer in {LONGEST} s")


def solve_case(case: StabilityCase) -> Outcome:
    """Solve a case in this process, within the time limit."""
    alarm = getattr(signal, "alarm", lambda seconds: None)  # without a limit on Windows
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _give_up)
    alarm(LONGEST)
    begin = perf_counter()
    try:
        module = import_module(f"multiscale.bench.{STABILITY_FAMILIES[case.family]}")
        residual = float(getattr(module, case.family)(**dict(case.parameters)))
    except MultiscaleError as error:
        return Outcome(1, seconds=perf_counter() - begin, sentence=str(error))
    except Exception as error:  # any other exception is a failure
        sentence = f"{type(error).__name__}: {error}"
        return Outcome(0, seconds=perf_counter() - begin, sentence=sentence)
    finally:
        alarm(0)
    seconds = perf_counter() - begin
    if residual <= case.tolerance:
        return Outcome(2, residual, seconds)
    return Outcome(0, residual, seconds, f"residual {residual:.1e} above {case.tolerance:g}")


def tabulate_stability(stability: Dataset) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows: outcomes and largest residual of every family, and of all."""
    families = stability["family"].values
    groups = {str(family): families == family for family in dict.fromkeys(families)}
    groups["all"] = np.ones(families.size, dtype=bool)
    rows = []
    for name, member in groups.items():
        counts = np.bincount(stability["outcome"].values[member], minlength=3)
        residual = stability["residual"].values[member & (stability["outcome"].values == 2)]
        worst = f"{residual.max():.1e}" if residual.size else ""
        rows.append((name, str(member.sum()), *(str(n) for n in counts[::-1]), worst))
    return ("family", "cases", *OUTCOMES[::-1], "largest residual"), rows
