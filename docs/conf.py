"""Settings of the documentation site; scripts/docs builds it."""

import os
import re
from typing import Any

import accelsurf

project = "accelsurf"
author = "The accelsurf developers"
copyright = "the accelsurf developers, BSD-3-Clause"
version = release = accelsurf.__version__

extensions = [
    "myst_nb",  # pages in Markdown, and notebooks
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
]
# The list of reference pages is for those who read the repository; the site has its own in api/index.
exclude_patterns = ["_build", "gallery", "reference/README.md", "examples/*.ipynb"]
suppress_warnings = [
    "config.cache",  # the settings of the gallery hold functions, which cannot be cached
]

# Python files are the gallery's; figures, images and JSON are linked from the pages.
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb", ".rst": "restructuredtext"}
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

# Notebooks are kept without outputs and run at each build; one that fails fails the build.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True

autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

# An example that fails fails the build.
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": r"/plot_",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 5,
}
os.environ.setdefault("MPLBACKEND", "Agg")

templates_path = ["_templates"]
html_theme = "pydata_sphinx_theme"
html_title = "accelsurf"
html_static_path: list[str] = []
html_show_sourcelink = False
html_theme_options = {
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "article_footer_items": [],
    "footer_start": ["copyright"],
    "footer_end": ["sphinx-version"],
}


def _escape_norms(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escape the bars of |grad psi| in docstrings, which reStructuredText would read as a substitution."""
    lines[:] = [re.sub(r"(?<![\\`|])\|(?![`|])", r"\\|", line) for line in lines]


def setup(app: Any) -> None:
    """Connect what changes docstrings."""
    app.connect("autodoc-process-docstring", _escape_norms)
