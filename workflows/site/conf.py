"""Settings of the documentation site; ``build.py`` collects its pages and calls Sphinx."""

import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging

from multiscale import __version__

project = "multiscale"
author = "The multiscale developers"
copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "sphinx_gallery.gen_gallery"]
root_doc = "workflows/site/index"
exclude_patterns = ["workflows/guides"]
suppress_warnings = ["config.cache"]  # the functions below are not settings

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc shows the types
add_module_names = False

sphinx_gallery_conf = {
    "examples_dirs": "workflows/guides",
    "gallery_dirs": "guides",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "abort_on_example_error": True,
    "min_reported_time": 1e9,
    "show_signature": False,
    "remove_config_comments": True,
    "image_scrapers": ("matplotlib",),
    "reset_modules": ("matplotlib",),
}

html_theme = "pydata_sphinx_theme"
html_title = "multiscale"
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["style.css"]
html_css_files = ["style.css"]
html_sidebars = {f"workflows/site/{page}": [] for page in ("index", "start", "theory", "glossary")}
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": False,
}


def setup(app: Sphinx) -> None:
    """Write formulas as MathML, which browsers show without scripts, and check references."""
    app.add_html_math_renderer(
        "mathml", inline_renderers=(write_inline, None), block_renderers=(write_block, None)
    )
    app.connect("missing-reference", warn_of_missing)


def to_mathml(formula: str, **options: str) -> str:
    """Convert a formula and its number."""
    number = re.search(r"\\tag\{(.*?)\}", formula)
    plain = re.sub(r"\\tag\{.*?\}|\\[Bb]igg?[lr]?(?=\\)", "", formula).strip()
    if ("&" in plain or "\\\\" in plain) and "\\begin" not in plain:
        plain = f"\\begin{{aligned}}{plain}\\end{{aligned}}"
    try:
        mathml = convert(plain, **options)
    except Exception as error:
        logging.getLogger(__name__).warning("%s cannot be shown: %r", plain, error)
        return plain
    return mathml + (f"<span>({number[1]})</span>" if number else "")


def write_inline(translator: nodes.NodeVisitor, node: nodes.Element) -> None:
    """Write a formula of a line."""
    translator.body.append(to_mathml(node.astext()))
    raise nodes.SkipNode


def write_block(translator: nodes.NodeVisitor, node: nodes.Element) -> None:
    """Write formulas on separate lines."""
    for formula in filter(str.strip, node.astext().split("\n\n")):
        translator.body.append(f'<div class="math">{to_mathml(formula, display="block")}</div>')
    raise nodes.SkipNode


def warn_of_missing(app: Sphinx, env: object, node: nodes.Element, content: nodes.Element) -> None:
    """Warn of a name in a page that the reference lacks, but not in docstrings."""
    if str(node.get("refdoc", "")).startswith(("workflows/site", "microcases")):
        logging.getLogger(__name__).warning(
            "%s is not in the reference", node.get("reftarget"), location=node
        )
