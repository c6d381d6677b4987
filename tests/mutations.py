"""Mutations of the source, and the tests that find them.

    python tests/mutations.py [MODULE ...] [--each N] [--seed N] [--page FILE]

from the root of a checkout changes operators, comparisons, signs and constants of the modules below
in a copy of the checkout, each separately, runs the tests of the module, and prints every mutation
that no test finds. ``EQUIVALENT`` lists those that change no answer, with the reason. A mutation
with which the tests do not end counts as timed out, which on a busy machine kills nothing.
``--page workflows/mutations.md`` writes the counts. The tests take minutes for each module, so that
the checks of a change leave them out.
"""

import argparse
import ast
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from random import Random
from shutil import copytree
from tempfile import TemporaryDirectory
from time import perf_counter

ROOT = Path(__file__).parents[1]
COPIED = ("multiscale", "tests", "microcases", "workflows")

TESTS = {
    "convergence": "tests/test_convergence.py tests/test_refused_calls.py",
    "units": "tests/test_units.py",
    "io.csv_tables": "tests/upscaling/test_bad_input.py tests/upscaling/test_tables.py",
    "io.images": "tests/io/test_images.py",
    "surfaces.fourier": "tests/surfaces",
    "surfaces.statistics": "tests/surfaces",
    "laws.normal": "tests/laws",
    "laws.asperities": "tests/laws",
    "laws.sliders": "tests/laws",
    "laws.pressure_functions": "tests/laws",
    "laws.bulk.rubber": "tests/laws",
    "numerics.krylov": "tests/numerics",
    "numerics.newton": "tests/macro/continuum tests/numerics",
    "nonsmooth.coulomb": "tests/nonsmooth",
    "nonsmooth.lcp_problem": "tests/nonsmooth",
    "nonsmooth.friction_problem": "tests/nonsmooth",
    "fe.elasticity": "tests/fe tests/macro/test_vibration.py tests/macro/continuum",
    "fe.faces": "tests/fe",
    "micro.elastic.compliance": (
        "tests/micro/elastic/test_layered.py tests/micro/elastic/test_flat_cell.py "
        "tests/micro/elastic/test_slope_expansion.py"
    ),
    "micro.damage.fatigue": "tests/micro/damage/test_fatigue.py",
    "micro.damage.cracks": "tests/micro/damage/test_cracks.py",
    "micro.damage.sections": "tests/micro/damage/test_sections.py tests/test_refused_calls.py",
    "upscaling.budget": "tests/report/test_unknown_error.py tests/upscaling/test_budget.py",
    "upscaling.scales": "tests/upscaling/test_scales.py",
    "upscaling.regression": "tests/upscaling/test_tables.py tests/upscaling/test_fit.py",
    "upscaling.calibration": "tests/upscaling/test_calibration.py",
    "upscaling.prior": "tests/upscaling/test_calibration.py",
    "upscaling.transport": "tests/upscaling/test_transport.py",
    "macro.data_range": "tests/macro/test_data_range.py",
    "macro.links.statics": "tests/macro/test_link_statics.py tests/test_refused_calls.py",
    "macro.links.dynamics": "tests/macro/test_links.py tests/verification/test_dynamics.py",
    "macro.granulate.packings": (
        "tests/macro/granulate/test_packings.py tests/macro/granulate/test_motion.py"
    ),
    "macro.vibration.modes": "tests/macro/test_vibration.py",
    "macro.substructures.cut_interfaces": (
        "tests/macro/substructures/test_cut_joints.py tests/macro/substructures/test_methods.py "
        "tests/macro/test_non_matching.py"
    ),
    "pipeline.showing": (
        "tests/pipeline/test_intervals.py tests/report tests/plotting/test_single_steps.py"
    ),
    "pipeline.plans.knobs": "tests/pipeline/test_planner.py",
    "plotting.lines": "tests/plotting",
    "report.page": "tests/report",
    "bench.measure": "tests/bench/test_measure.py",
    "schema.dataset_schema": "tests/io/test_datasets.py",
}
"""Modules of every package, and the tests that guard each."""

EQUIVALENT = {
    "compliance:159: 2.0 * np.pi -> 2.0 / np.pi": "the unit of wavenumbers cancels",
    "packings:199: 1.0 -> 1.5": "discs stand in the plane y = 0 of a box of any depth",
    "not given.endswith(unit)) -> given is None and unit not in _PREFIXED and "
    "(not given.endswith(unit))": "pint converts units that the table of prefixes lacks",
    "1e-12 * across -> 1e-12 / across": "a bound against division by rounding",
    "1.25 -> 1.875": "a margin of a fitted band",
    "np.abs(shape.tension).max -> np.abs(shape.tension).min": (
        "a bound of rounding, below the tolerance of these structures"
    ),
    "abs(origin) or 1.0 -> abs(origin) and 1.0": "the unit of a coordinate of the fit",
    "n <= SMALL -> n > SMALL": "full and sparse factors of the same matrix",
    "arm[:, 0] - np.sum(arm[:, 0] * n, axis=1, keepdims=True) * n -> "
    "arm[:, 0] + np.sum(arm[:, 0] * n, axis=1, keepdims=True) * n": (
        "a linear map of the plane of a facet leaves the order of its corners"
    ),
    "position[near] - position[:, None] -> position[near] + position[:, None]": (
        "gradients of planes do not depend on the origin"
    ),
}
"""Ends of the lines of mutations that change no answer, and why."""

OUTCOMES = ("killed", "equivalent", "timed out", "survived")

OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
NAMES = {"minimum": "maximum", "maximum": "minimum", "min": "max", "max": "min"}
SKIPPED = (ast.Raise, ast.JoinedStr, ast.arguments, ast.AnnAssign)
FACTOR = 1.5  # of a mutated constant
SMALLEST = 1e-6  # constant that is mutated; smaller values guard against rounding


def main() -> int:
    """Print the mutations that survive, and return their number."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", help="modules, without the name of the package")
    parser.add_argument("--each", type=int, default=3, help="mutations of a module")
    parser.add_argument("--seed", type=int, default=0, help="of the choice of mutations")
    parser.add_argument("--page", type=Path, help="page of counts to write")
    arguments = parser.parse_args()
    outcomes: list[tuple[str, str]] = []
    with TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in COPIED:
            copytree(ROOT / name, copy / name)
        for name in ("pyproject.toml", "README.md"):
            (copy / name).write_bytes((ROOT / name).read_bytes())
        for module in arguments.modules or TESTS:
            for line, outcome in mutate(copy, module, arguments.each, arguments.seed):
                outcomes.append((line, outcome))
                sys.stdout.write(f"{outcome:10} {line}\n")
                sys.stdout.flush()
    counts = Counter(outcome for _, outcome in outcomes)
    sys.stdout.write(", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES) + "\n")
    if arguments.page:
        arguments.page.write_text(write_page(outcomes), encoding="utf-8")
    return counts["survived"]


def write_page(outcomes: list[tuple[str, str]]) -> str:
    """Write the counts of each package, the survivors, and the reasons of the equivalent."""
    rooms: dict[str, Counter[str]] = {}
    for line, outcome in outcomes:
        rooms.setdefault(re.split(r"[.:]", line)[0], Counter())[outcome] += 1
    rooms["all"] = sum(rooms.values(), Counter())
    rows = [("package", "mutations", *OUTCOMES), ["---"] * (2 + len(OUTCOMES))]
    rows += [
        (name, str(n.total()), *(str(n[key]) for key in OUTCOMES)) for name, n in rooms.items()
    ]
    lines = [
        "# Mutations",
        "",
        "Changed operators, comparisons, signs and constants, each separately,",
    ]
    lines += [
        f"under the tests of their modules. (`python tests/mutations.py`, {date.today()})",
        "",
    ]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    for outcome in OUTCOMES[1:]:
        listed = [line for line, seen in outcomes if seen == outcome]
        lines += ["", f"{outcome.capitalize()}:", ""] if listed else []
        lines += [f"- `{line}`{reason_of(line)}" for line in listed]
    return "\n".join([*lines, ""])


def reason_of(line: str) -> str:
    """Return why a mutation changes no answer, after a colon; empty if it may change one."""
    return next((f": {why}" for end, why in EQUIVALENT.items() if line.endswith(end)), "")


def mutate(copy: Path, module: str, each: int, seed: int) -> Iterator[tuple[str, str]]:
    """Yield the lines of some mutations of a module, and the outcome of their tests."""
    file = copy / "multiscale" / f"{module.replace('.', '/')}.py"
    source, stamp = file.read_text(encoding="utf-8"), file.stat()
    begin = perf_counter()
    if not passes(copy, TESTS[module]):
        raise SystemExit(f"{TESTS[module]}: fails without any mutation")
    limit = 60.0 + 5.0 * (perf_counter() - begin)  # s
    count = len(list(places(ast.parse(source))))
    for chosen in sorted(Random(f"{module} {seed}").sample(range(count), min(each, count))):
        tree = ast.parse(source)
        node = list(places(tree))[chosen]
        before = ast.unparse(node)
        change(node)
        line = f"{module}:{node.lineno}: {before} -> {ast.unparse(node)}"
        file.write_text(ast.unparse(tree), encoding="utf-8")
        passed = passes(copy, TESTS[module], limit)
        file.write_text(source, encoding="utf-8")
        os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))  # compiled kernels stay valid
        known = "equivalent" if reason_of(line) else "survived"
        yield line, "timed out" if passed is None else known if passed else "killed"


def passes(copy: Path, tests: str, limit: float | None = None) -> bool | None:
    """Whether tests pass in a copy; None beyond a limit of seconds."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    try:
        ended = subprocess.run(
            [*command, *tests.split()], cwd=copy, timeout=limit, capture_output=True, check=False
        )
    except subprocess.TimeoutExpired:
        return None
    return ended.returncode == 0


def places(tree: ast.AST, inside: bool = False) -> Iterator[ast.expr]:
    """Yield the expressions of functions that a mutation can change."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, SKIPPED):
            continue
        within = inside or isinstance(node, ast.FunctionDef)
        if within and isinstance(node, ast.expr) and can_change(node):
            yield node
        yield from places(node, within)


def can_change(node: ast.expr) -> bool:
    """Whether an expression has an operator, sign, constant or name that is mutated."""
    match node:
        case ast.BinOp(left=left, right=right, op=op):
            return type(op) in OPERATORS and not any(map(is_text, (left, right)))
        case ast.Compare(ops=[op]) | ast.BoolOp(op=op):
            return type(op) in OPERATORS
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return not isinstance(operand, ast.Constant)
        case ast.Constant(value=float(value)):
            return abs(value) > SMALLEST
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return name in NAMES
    return False


def is_text(node: ast.expr) -> bool:
    """Whether an operand is text or a sequence, of which + makes a longer sequence."""
    texts = (ast.JoinedStr, ast.List, ast.Tuple)
    return isinstance(node, texts) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def change(node: ast.expr) -> None:
    """Mutate an expression in place."""
    match node:
        case ast.BinOp() | ast.BoolOp():
            node.op = OPERATORS[type(node.op)]()
        case ast.Compare():
            node.ops = [OPERATORS[type(node.ops[0])]()]
        case ast.UnaryOp():
            node.op = ast.UAdd()
        case ast.Constant():
            node.value = FACTOR * node.value
        case ast.Attribute():
            node.attr = NAMES[node.attr]
        case ast.Name():
            node.id = NAMES[node.id]


if __name__ == "__main__":
    sys.exit(main())
