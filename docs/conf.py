"""The site that `make docs` builds; Sphinx reads this file. Nothing is loaded from the network."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "site"), str(HERE.parent / "src")]
# Executed pages call `snapo` and read this checkout, wherever they run.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["PYTHONPATH"] = str(HERE.parent / "src")
os.environ["PYDEVD_DISABLE_FILE_VALIDATION"] = "1"

import snapo  # noqa: E402

project = "snapo"
version = release = snapo.__version__
copyright = "snapo, Apache-2.0"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "mathml",
    "case_tables",
    "public_names",
    "outside",
    "streams",
]
exclude_patterns = ["site", "README.md"]
html_theme = "pydata_sphinx_theme"
html_title = f"snapo {version}"
html_static_path = ["site/style"]
html_css_files = ["snapo.css"]
html_theme_options = {
    "navigation_with_keys": True,
    "show_toc_level": 2,
    "show_prev_next": True,
    "header_links_before_dropdown": 8,
    "footer_start": ["copyright"],
    "footer_end": [],
}
# Every page but those without a chapter has the pages of its chapter at its side.
html_sidebars = {page: [] for page in ("index", "404", "getting_started", "faq", "troubleshooting")}
html_show_sourcelink = False

# Plain Markdown with equations; headings are targets of links.
myst_enable_extensions = ["dollarmath", "attrs_inline"]
myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]

# Pages with code cells run once for each change of theirs; a mistake in a cell ends the build.
nb_execution_mode = "cache"
nb_execution_timeout = 600
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_ipywidgets_js = {}

# Docstrings: a single backtick is code.
default_role = "literal"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
