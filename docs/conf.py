"""Sphinx configuration. Pages below `reference/` and `estimators/` are written by `_ext/generated.py` at each build."""

import hashlib
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "boresight"
author = "the boresight authors"
version = release = installed_version("boresight")
html_title = "boresight"

extensions = [
    "generated",
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_ext", "_static", "README-draft.md"]
smartquotes = False  # they turn the two hyphens of an option into a dash

myst_enable_extensions = ["attrs_block", "attrs_inline", "colon_fence", "deflist", "fieldlist"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
# Executed notebooks are kept as long as the code and the catalogue that they ran with.
_code = hashlib.sha256()
for _folder in ("campaign", "estimators", "renderers", "reports", "scenarios"):
    for _file in sorted(HERE.parent.joinpath(_folder).rglob("*")):
        if _file.suffix in {".py", ".yaml"}:
            _code.update(_file.read_bytes())
nb_execution_cache_path = str(HERE.parent / "build" / "jupyter-cache" / _code.hexdigest()[:16])
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True

autodoc_typehints = "none"  # numpydoc docstrings state types where they matter; signatures stay short
autosummary_generate = True
numpydoc_show_class_members = False

# A prompt, and what a command prints, are not copied.
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True

html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
html_css_files = ["boresight.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_copyright = False
html_theme_options = {
    "navbar_align": "left",
    "header_links_before_dropdown": 9,
    "show_toc_level": 1,
    "navigation_with_keys": False,
    "footer_start": ["sphinx-version"],
    "footer_end": ["theme-version"],
    "secondary_sidebar_items": ["page-toc"],
}
