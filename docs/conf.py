"""The site: guide, theory, gallery, reference.  `nox -s docs` builds it."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version as installed
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
# Pages are executed in processes of their own, which read this.
os.environ |= {
    "IPYTHONDIR": str(HERE / "_ipython"),
    "COLUMNS": "100",  # of the tables that commands print
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYDEVD_DISABLE_FILE_VALIDATION": "1",
}

project = "pilotid"
author = "The pilotid contributors"
copyright = author
version = release = installed("pilotid")

extensions = [
    "mathml",
    "methods",
    "names",
    "offline",
    "outside",
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinxcontrib.bibtex",
    "sphinx_copybutton",
]
exclude_patterns = ["_build", "_ipython", "_ext", "_templates"]
templates_path = ["_templates"]
nitpicky = True
nitpick_ignore_regex = [
    # Other packages are named, not linked: the build reads no network.
    (r"py:.*", r"(numpy|np|scipy|matplotlib|pandas|control|collections|typing)\..*"),
    # Words of numpydoc's types that are no names.
    (r"py:class", r"(optional|array|arrays|default.*|shape.*|of|or|\d+)"),
]

# Pages: Markdown, whose code cells are executed; one that fails ends the build.
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 4
myst_dmath_double_inline = True
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 240
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_code_prompt_show = "Show the code of this figure"
nb_code_prompt_hide = "Hide the code of this figure"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}  # these would come from the network

# Reference: signatures and numpydoc docstrings.
autosummary_generate = True
autodoc_typehints = "none"  # the docstrings say what a signature cannot: shapes and units
autodoc_member_order = "bysource"
default_role = "py:obj"  # a name in backticks in a docstring is a link to its entry
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "unsrt"
bibtex_reference_style = "author_year"

html_theme = "furo"
html_title = f"pilotid {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
copybutton_exclude = ".linenos, .gp"
copybutton_prompt_text = ""

linkcheck_timeout = 20
linkcheck_workers = 2
linkcheck_anchors = False
