"""Sphinx settings; `make docs` builds the pages."""

import importlib.metadata
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import generate  # noqa: E402
from docutils import nodes  # noqa: E402
from docutils.utils.math import latex2mathml  # noqa: E402
from sphinx.ext import autosummary  # noqa: E402

generate.write()

project = "tss_ros"
author = "tss_ros maintainers"
release = version = importlib.metadata.version("tss_ros")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
# Parts that pages include are no pages of their own.
exclude_patterns = ["_build", "_generated/*.md", "**/README.rst"]
default_role = "literal"

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

autosummary_generate = True
# A sentence does not end there.
autosummary.WELL_KNOWN_ABBREVIATIONS += ("Eq.", "Eqs.")
autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    # The others are nodes, which end when they are told to.
    "filename_pattern": r"plot_\w+\.py$",
    "ignore_pattern": r"__init__\.py|conftest\.py",
    "backreferences_dir": "_generated/backreferences",
    "doc_module": ("tss_ros",),
    "within_subsection_order": "generate.GalleryOrder",
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,
    "show_signature": False,
    "matplotlib_animations": True,
}

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "tss_ros"
templates_path = ["_templates"]
html_static_path = ["_static"]
html_css_files = ["tss.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "tss_ros"},
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}
html_sidebars = {"index": [], "tutorial": [], "architecture": []}
copyright = "tss_ros maintainers, Apache License 2.0"


def escape_bars(app, what, name, obj, options, lines):
    """Keep the bars of |rho| in docstrings from being read as reStructuredText."""
    lines[:] = ["".join(_outside_literals(line)) for line in lines]


def _outside_literals(line):
    for i, part in enumerate(line.split("``")):
        yield ("``" if i else "") + (part if i % 2 else part.replace("|", r"\|"))


def write_formula(self, node):
    """Write a formula as MathML, which browsers show without a script from elsewhere."""
    block = isinstance(node, nodes.math_block)
    self.body.append(latex2mathml.tex2mathml(node.astext(), as_block=block))
    raise nodes.SkipNode


def setup(app):
    """Connect the above; bars are escaped after numpydoc has read the docstring."""
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
    app.connect("autodoc-process-docstring", escape_bars, priority=900)
