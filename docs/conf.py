# SPDX-License-Identifier: BSD-3-Clause
"""How `make docs` turns the pages of this folder and the docstrings into a site."""

import re
import tomllib
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

ROOT = Path(__file__).parents[1]

project = "Piezo stage suite"
version = release = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
root_doc = "README"
extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
templates_path = ["templates"]

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3

default_role = "py:obj"
suppress_warnings = ["ref.python"]  # several packages have a class of that name
autodoc_member_order = "bysource"
toc_object_entries_show_parents = "hide"
autodoc_default_options = {
    "members": True,
    "ignore-module-all": True,
    "exclude-members": "set",  # which matplotlib adds to each kind of figure
}
napoleon_google_docstring = False
napoleon_use_ivar = True

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_theme_options = {
    "navbar_center": [],
    "footer_end": [],
}
html_title = project
html_additional_pages = {"index": "index.html"}  # which leads to the first page
html_show_sourcelink = False
html_show_copyright = False
html_copy_source = False


def add_navigation(app: Sphinx, name: str, content: list[str]) -> None:
    """Let the pages that each section of an index links to be the navigation below it."""
    if not name.endswith("README"):
        return
    head, *sections = re.split(r"^## ", content[0], flags=re.M)
    for section in sections or [head]:
        title = section.splitlines()[0].lstrip("# ")
        pages = dict.fromkeys(re.findall(r"\]\((\w[\w/]*)\.(?:md|rst)\)", section))
        lines = ["", "```{toctree}", f":caption: {title}", ":hidden:", "", *pages, "```", ""]
        content[0] += "\n".join(lines)


def unlink_words(app: Sphinx, page: nodes.document) -> None:
    """Leave the words in types, such as shape, without links to attributes of these names."""
    for link in list(page.findall(pending_xref)):
        if link["reftype"] == "class" and re.fullmatch("[a-z]+", link["reftarget"]):
            link.replace_self(link.children)


def typeset(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Write a formula as MathML, which browsers typeset without a script from elsewhere."""
    is_block = isinstance(node, nodes.math_block)
    formula = tex2mathml(node.astext(), as_block=is_block)
    translator.body.append(f"<p>{formula}</p>\n" if is_block else formula)
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Connect what this page adds to Sphinx."""
    app.add_html_math_renderer("mathml", (typeset, None), (typeset, None))
    app.connect("source-read", add_navigation)
    app.connect("doctree-read", unlink_words)
