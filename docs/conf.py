"""The documentation site. `make docs` builds it into build/docs: warnings are errors, and no network is needed.

The source folder is the project's, so that a link between README.md, docs/ and benchmarks/ is the same relative path in
the site and on a git host.
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "site"))  # the extensions below

from friction_estimator import __version__  # noqa: E402

project = "friction_estimator"
author = copyright = "friction_estimator developers"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "decision_list",
    "generated",
    "house_docstrings",
    "reachable",
]
root_doc = "docs/index"
source_suffix = {".md": "markdown"}
include_patterns = ["*.md", "docs/**", "benchmarks/**", "bags/*.md", "test/hard/*.md"]
exclude_patterns = [
    ".*",
    "build",
    "install",
    "log",
    "demo_out",
    "friction_estimator",
    "benchmarks/out",
    "docs/generated",
]
highlight_language = "text"

myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # CHANGELOG.md and pages of figures begin where it suits them

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings state shapes and units
napoleon_attr_annotations = False  # and so of attributes
default_role = "literal"  # of single backquotes in docstrings
add_module_names = False
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"friction_estimator {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["_root"]  # index.html, which leads to docs/index.html
html_copy_source = False
html_show_sphinx = False
