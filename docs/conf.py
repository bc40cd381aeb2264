"""How Sphinx builds the pages. `make docs` runs it; `make docs GALLERY=1` runs the example scripts as well."""

import importlib.util
import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE)]

import generated  # noqa: E402

project = "spectral-ct"
author = "the spectral-ct contributors"
release = version = next(
    line.split('"')[1]
    for line in (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines()
    if line.startswith("version")
)

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_click",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
if importlib.util.find_spec("sphinx-mathjax-offline"):  # formulas without a network
    extensions.append("sphinx-mathjax-offline")
exclude_patterns = ["_build"]
templates_path = ["_templates"]
suppress_warnings = ["config.cache"]  # functions in sphinx_gallery_conf cannot be pickled
nitpicky = False
smartquotes = False  # two hyphens of an option must stay two hyphens

# Markdown
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4

# Docstrings
autosummary_generate = True
autodoc_typehints = "none"  # shapes and units stand in the docstrings
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# Pages
toc_object_entries_show_parents = "hide"
html_theme = "pydata_sphinx_theme"
html_title = "spectral-ct"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": ["sphinx-version"],
}
html_sidebars = {"outside/readme": []}
html_context = {"default_mode": "light"}

# Example scripts become pages. They run, in their quick form, only where the environment has GALLERY=1: about four
# minutes on two cores. They run on copies, because they write scans and figures beside themselves.
EXAMPLES = HERE / "_build" / "examples"


def copy_examples() -> None:
    """Copy the scripts, their scenes and the heading of the gallery."""
    shutil.rmtree(EXAMPLES, ignore_errors=True)
    EXAMPLES.mkdir(parents=True)
    for pattern in ("plot_*.py", "*.yaml"):
        for path in (ROOT / "examples").glob(pattern):
            shutil.copy2(path, EXAMPLES / path.name)
    shutil.copy2(HERE / "_static" / "gallery_header.txt", EXAMPLES / "GALLERY_HEADER.rst")


generated.copy_outside()
copy_examples()
sphinx_gallery_conf = {
    "examples_dirs": str(EXAMPLES),
    "gallery_dirs": "tutorials/gallery",
    "plot_gallery": bool(os.environ.get("GALLERY")),
    "filename_pattern": r"plot_",
    "reset_argv": generated.QuickArguments(),
    "image_scrapers": ("matplotlib", generated.WrittenPictures(EXAMPLES)),
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "write_computation_times": False,
}


def setup(app) -> None:
    """Register the directive of scene keys, and what mends links and docstrings."""
    app.add_directive("scene-keys", generated.SceneKeys)
    app.connect("source-read", generated.lead_links)
    app.connect("autodoc-process-docstring", generated.describe_below_names, priority=400)  # before numpydoc
