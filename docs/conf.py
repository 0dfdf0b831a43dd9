"""Settings of the documentation site: ``make docs`` builds it into ``build/docs``.

The pages are the Markdown files of this folder, the API reference is read from the docstrings, and the gallery runs
every example of ``examples/gallery``. Reports in ``results/`` are published with the site.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_extensions"))

import moc_opt  # noqa: E402 - the package that is documented

project, author, copyright = "moc_opt", "The moc_opt developers", "the moc_opt developers, Apache-2.0"
version = release = moc_opt.__version__

extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon", "sphinx.ext.viewcode",
    "sphinx_copybutton", "sphinx_design", "sphinx_gallery.gen_gallery", "figures", "links", "reports", "words",
]  # fmt: skip
exclude_patterns = ["_extensions", "gallery/**/*.ipynb", "gallery/**/*.py", "gallery/*.zip"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
suppress_warnings = ["config.cache"]

autodoc_typehints = "none"  # the signatures show them
autodoc_member_order = "bysource"
autosummary_generate = True
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_rtype = False
default_role = "code"

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r".*\.py",
    "capture_repr": ("_repr_html_", "__str__"),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "remove_config_comments": True,
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": (),
}

html_theme = "furo"
html_title = f"moc_opt {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"source_edit_link": None, "navigation_with_keys": True}
html_show_sourcelink = False
