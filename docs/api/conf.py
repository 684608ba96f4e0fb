# SPDX-License-Identifier: BSD-3-Clause
"""How `make api` turns the docstrings of the packages into pages."""

from numpydoc.xref import DEFAULT_LINKS

project = "Piezo stage suite"
extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc"]
templates_path = ["templates"]
default_role = "py:obj"
autodoc_member_order = "bysource"
toc_object_entries_show_parents = "hide"
autodoc_default_options = {"members": True, "ignore-module-all": True}
numpydoc_show_class_members = False
numpydoc_xref_param_type = True
numpydoc_xref_ignore = {"of", "or", "shape", "to"}
# Those of Python and NumPy lie elsewhere; without a network they are no links.
numpydoc_xref_aliases = dict(zip(DEFAULT_LINKS, DEFAULT_LINKS, strict=True))
html_theme = "bizstyle"
html_show_copyright = False
html_copy_source = False
