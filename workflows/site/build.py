"""Build the documentation site from the Markdown, guides and docstrings of the sources.

    python workflows/site/build.py -o site [--results FOLDER] [--no-guides]

from the root of a checkout with ``pip install '.[docs]'`` writes ``site/index.html``. ``--results``
is the folder of a run of ``ground_steel`` for the guides; without it the case is run with
``--quick``. ``--no-guides`` shows the guides without their output. Warnings are errors.
"""

import argparse
import re
import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from sphinx.cmd.build import build_main
from typer.main import get_command

from multiscale import cli
from multiscale.schema import SCHEMAS

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "surfaces",
    "laws",
    "micro",
    "micro.damage",
    "upscaling",
    "nonsmooth",
    "macro",
    "macro.bodies",
    "macro.continuum",
    "macro.granulate",
    "macro.joint",
    "macro.links",
    "macro.substructures",
    "macro.vibration",
    "pipeline",
    "plotting",
    "report",
    "io",
)
"""Packages of the reference, from the surfaces to the page."""
START = "workflows/site/index.html"


def main() -> int:
    """Build the site, and return the status of Sphinx."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("site"))
    parser.add_argument("--results", type=Path, help="folder of a run of ground_steel")
    parser.add_argument("--no-guides", action="store_true", help="do not run the guides")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        pages = Path(folder, "pages")
        collect(pages)
        if not arguments.no_guides:
            bring_results(pages / "workflows" / "guides", arguments.results)
        options = ["-W", "--keep-going", "-q", "-j", "auto", "-d", str(Path(folder, "doctrees"))]
        options += ["-D", f"plot_gallery={int(not arguments.no_guides)}"]
        settings = ["-c", str(pages / "workflows" / "site")]
        status = build_main([*options, *settings, "-b", "html", str(pages), str(arguments.out)])
    refresh = f'<meta http-equiv="refresh" content="0; url={START}">'
    (arguments.out / "index.html").write_text(refresh, encoding="utf-8")
    return status


def bring_results(guides: Path, results: Path | None) -> None:
    """Copy the run of the guides to the folder that they read."""
    if results is None:
        cli.app(
            ["run", "ground_steel", "--quick", "-q", "-o", str(guides / "results")],
            standalone_mode=False,
        )
    else:
        shutil.copytree(results, guides / "results")


def collect(pages: Path) -> None:
    """Copy the Markdown with the files that it links, and write the generated pages."""
    for name in ("microcases", "workflows"):
        shutil.copytree(ROOT / name, pages / name, ignore=shutil.ignore_patterns("__pycache__"))
    for file in pages.rglob("*.md"):
        text = file.read_text(encoding="utf-8").replace("```csv", "```text")
        file.write_text(re.sub(r"\]\([\w./]*guides/(\w+)\.py\)", r"](/guides/\1.rst)", text))
    guides = sorted((pages / "workflows" / "guides").glob("*.py"))
    heads = [head_of(file.read_text(encoding="utf-8")) for file in guides]
    (guides[0].parent / "GALLERY_HEADER.rst").write_text(list_guides(guides, heads))
    for file in guides:
        file.write_text(in_cells(file.read_text(encoding="utf-8")), encoding="utf-8")
    changes = (ROOT / "multiscale" / "CHANGELOG.md").read_text(encoding="utf-8")
    (pages / "changelog.md").write_text(changes, encoding="utf-8")
    reference = pages / "reference"
    reference.mkdir()
    for package in PACKAGES:
        (reference / f"{package}.rst").write_text("\n".join(describe_package(package)))
    (reference / "datasets.md").write_text("\n".join(describe_datasets()), encoding="utf-8")
    (reference / "command_line.md").write_text("\n".join(describe_commands()), encoding="utf-8")


# guides


def head_of(guide: str) -> tuple[str, str, str]:
    """Return title, subtitle and further text of the docstring of a guide."""
    head, _, rest = guide.split('"""')[1].partition("\n\n")
    title, _, subtitle = " ".join(head.split()).partition(": ")
    return title, subtitle[:1].upper() + subtitle[1:], rest


def list_guides(files: list[Path], heads: list[tuple[str, str, str]]) -> str:
    """Return the head of the page of the guides, with their questions."""
    lines = ["Guides", "======", "", "Scripts of comments and code, with their output.", ""]
    lines += [".. list-table::", ""]
    for file, (_, _, rest) in zip(files, heads, strict=True):
        question = " ".join(rest.split("Question: ")[1].split("\n\n")[0].split())
        question = f"{question[0].upper()}{question[1:]}"
        lines += [f"   * - :doc:`/guides/{file.stem}`", f"     - {question}"]
    return "\n".join(lines) + "\n"


def in_cells(guide: str) -> str:
    """Return a guide with its comments as cells of text, between its code."""
    title, subtitle, rest = head_of(guide)
    code = guide.split('"""', 2)[2].replace("Path(__file__).parents[1]", "Path.cwd().parent")
    head = f'"""\n{title}\n{"=" * len(title)}\n\n{subtitle}\n\n{as_literal(rest)}"""'
    cells = re.sub(r"(?<=\n\n)(?=# )", "# %%\n", code)
    table = re.compile(r"^#\n((?:#   .*\n(?:#\n(?=#   ))?)+)", flags=re.MULTILINE)
    return head + table.sub(r"#\n# ::\n#\n\1", cells)


def as_literal(text: str) -> str:
    """Return text with a mark before its indented lines with commands."""
    return re.sub(r"\n\n(?=    )", "\n\n::\n\n", text)


# reference


def describe_package(package: str) -> Iterator[str]:
    """Yield the page of the exported names of a package."""
    module = import_module(f"multiscale.{package}")
    title = f"multiscale.{package}"
    yield from (title, "=" * len(title), "", f".. automodule:: {title}", "")
    yield from (f".. currentmodule:: {title}", "")
    for name in sorted(dir(module), key=str.lower):
        item = getattr(module, name)
        home = getattr(item, "__module__", "")
        if name.startswith("_") or not home.startswith("multiscale") or in_another(package, name):
            continue
        kind = "autoclass" if isinstance(item, type) else "autofunction"
        yield from (f".. {kind}:: {name}", *["   :members:"] * isinstance(item, type), "")


def in_another(package: str, name: str) -> bool:
    """Whether the page of an earlier package has a name."""
    earlier = PACKAGES[: PACKAGES.index(package)]
    return any(name in dir(import_module(f"multiscale.{other}")) for other in earlier)


def describe_datasets() -> Iterator[str]:
    """Yield the page of the datasets, from their schemas."""
    yield "# Datasets\n"
    yield "NetCDF files in SI units; variables without a mark are in every file of the kind.\n"
    for name, schema in SCHEMAS.items():
        yield f"## {name}\n\nVersion {schema.version}.\n"
        yield "| variable | dimensions | unit | meaning |\n| --- | --- | --- | --- |"
        for variables, mark in ((schema.variables, ""), (schema.optional, " (optional)")):
            for key, variable in variables.items():
                dims = ", ".join(variable.dims)
                yield f"| `{key}`{mark} | {dims} | {variable.units} | {variable.long_name} |"
        yield ""


def describe_commands() -> Iterator[str]:
    """Yield the page of the command line, from its options."""
    yield "# Command line\n"
    for name, command in get_command(cli.app).commands.items():
        yield f"## multiscale {name}\n\n{command.help}\n"
        yield "| argument or option | default | meaning |\n| --- | --- | --- |"
        for option in command.params:
            names = ", ".join(f"`{text}`" for text in option.opts)
            names = names if option.param_type_name == "option" else f"`{option.name}`"
            default = option.default if isinstance(option.default, int | float | str | Path) else ""
            shown = "" if default is False or default == "" else f"`{default}`"
            yield f"| {names} | {shown} | {getattr(option, 'help', '') or ''} |"
        yield ""


if __name__ == "__main__":
    sys.exit(main())
