"""Configuration of the documentation; `make docs` builds it."""

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

import hexopt

HERE = Path(__file__).parent
# The extensions of this documentation, and the studies: pages run parts of these.
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

project = "hexopt"
author = "the hexopt authors"
project_copyright = "2026, the hexopt authors"
version = release = hexopt.__version__

# No intersphinx, and no MathJax: this builds, and is read, without a network.
extensions = [
    "executed",
    "mathml",
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_ext", "gallery"]
templates_path = ["_templates"]
# `name` in a docstring links to what has that name, and is plain code where nothing has.
default_role = "py:obj"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Types stand in the docstrings, in words.
autodoc_typehints = "none"
toc_object_entries_show_parents = "hide"
# The class template shows the members; numpydoc would list them a second time.
numpydoc_show_class_members = False
# Checks by their codes, such as {"GL08"} (no docstring); each failure then is a warning, which is an error.
numpydoc_validation_checks: set[str] = set()
python_maximum_signature_line_length = 88

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "auto_gallery",
    "filename_pattern": r"\.py$",  # every example is run, whatever its name
    "within_subsection_order": "FileNameSortKey",
    "reset_modules": ("matplotlib", "gallery_style.reset"),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "image_srcset": ["2x"],
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
}

html_theme = "pydata_sphinx_theme"
html_title = "hexopt"
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["hexopt.css"]
html_sidebars = {"**": ["sidebar-pages"]}
html_theme_options = {
    "logo": {"text": "hexopt"},
    "navbar_center": [],  # the pages stand in the sidebar
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
}


def check_public_names(app: Sphinx) -> None:
    """Warn of each public name that api.rst does not show."""
    shown = re.findall(
        r"^ +(\w+)$",
        (Path(app.srcdir) / "api.rst").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    for name in sorted(
        {name for name in hexopt.__all__ if not name.startswith("_")}.difference(shown)
    ):
        logging.getLogger(__name__).warning("api.rst does not show hexopt.%s", name)


def setup(app: Sphinx) -> None:
    """Register the check."""
    app.connect("builder-inited", check_public_names)
