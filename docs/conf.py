"""The documentation: what Sphinx builds from this folder, the notebooks and the docstrings.

`make docs` builds it into build/docs/html without a network: no page loads anything from elsewhere.
A warning, a link within the project that leads nowhere among them, ends the build.
"""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

import matplotlib as mpl

from exact_mdp.analysis.pages.page import ADVICE

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

project = "exact-mdp"
author = "the exact-mdp authors"
release = version = version_of(project)
copyright = f"{author}; {ADVICE}"  # at the foot of every page

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "public_names",
    "commands",
    "gallery",
    "plain_text",
    "whole",
]
exclude_patterns = ["conf.py", "extensions", "gallery/*/*.py", "**/.ipynb_checkpoints"]
# The type of a parameter is linked where it is a class here, and is a word elsewhere.
suppress_warnings = ["ref.python"]

# ---- pages -------------------------------------------------------------------------------------

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
smartquotes = False  # --option keeps its two hyphens
highlight_language = "text"  # a block without a language is a command line or a formula

# ---- tutorials and gallery -----------------------------------------------------------------------

nb_execution_mode = "off"  # the notebooks hold their outputs
nb_ipywidgets_js: dict[str, dict[str, str]] = {}  # no script from elsewhere
mpl.use("Agg")

# ---- reference: docstrings in plain text ---------------------------------------------------------

default_role = "literal"  # `name` in a docstring is code
autodoc_typehints = "none"  # the docstring names the types
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False

# ---- look ----------------------------------------------------------------------------------------

html_theme = "pydata_sphinx_theme"
html_title = project
html_static_path = ["look"]
html_css_files = ["pages.css"]
html_sidebars: dict[str, list[str]] = {"index": [], "gallery/index": []}  # nothing is below them
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # a summary is fetched, which a page opened from a file may not do
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "navbar_persistent": ["search-button"],
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "navigation_with_keys": False,
}
