"""The documentation site: `make docs` builds it, with every warning an error.

Nothing on a page comes from another host: furo uses the system's fonts, formulas are MathML, and
no script is loaded from outside. `make docs-cells` runs the commands and code on the pages, and
keeps what they print for the site (docs/_ext/kept_cells.py).
"""

import os
import sys
import tomllib
from pathlib import Path

import numpy.typing

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
import kept_cells  # noqa: E402

project = "thigmo"
author = "the thigmo developers"
project_copyright = author
version = release = tomllib.loads((HERE.parent / "pyproject.toml").read_text())["project"][
    "version"
]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "closed",
    "console",
    "generated",
    "kept_cells",
    "mathml",
]
exclude_patterns = ["_build", "_made", "_ext", "results"]
smartquotes = False  # options begin with two hyphens
html_theme = "furo"
html_title = "thigmo"
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["thigmo.css"]
html_theme_options = {"navigation_with_keys": True}

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 4
myst_update_mathjax = False

nb_execution_mode = "cache"  # docs-cells begins with an empty one
nb_execution_cache_path = str(kept_cells.NOTEBOOKS)
nb_execution_excludepatterns = [] if kept_cells.EXECUTES else kept_cells.unexecuted_pages()
nb_execution_in_temp = True
nb_execution_timeout = 300  # s, of one cell
nb_merge_streams = True
nb_ipywidgets_js = {}  # otherwise loaded from other hosts
# Kernels inherit it: pages show what a terminal of this width shows, wherever they are built.
os.environ["COLUMNS"] = "88"
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_format = "short"
# Pages name numpy's alias, not the union that it stands for.
numpy.typing.ArrayLike = type("ArrayLike", (), {"__module__": "numpy.typing"})
autodoc_preserve_defaults = True
