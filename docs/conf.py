"""Sphinx configuration of the docs site: ``make docs`` builds it into ``build/docs``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))

from api_page import targets  # noqa: E402
from docstrings import is_markdown, markdown_to_rst  # noqa: E402
from site_pages import PROJECT, write_pages  # noqa: E402

import pwm_gym  # noqa: E402

project = "pwm_gym"
author = "The pwm_gym authors"
copyright = f"2026, {author}"
release = pwm_gym.__version__
version = release

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_static"]
default_role = "literal"  # docstrings have Markdown's single backticks
highlight_language = "text"  # blocks without a language are commands

myst_enable_extensions = ["colon_fence", "fieldlist"]
myst_heading_anchors = 3

autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
maximum_signature_line_length = 88
napoleon_numpy_docstring = False
napoleon_custom_sections = ["Version history"]
nitpicky = True  # a role that names nothing of the package is an error
nitpick_ignore_regex = [(r"py:.*", r"(?!pwm_gym\.).*")]

html_theme = "pydata_sphinx_theme"
html_title = "pwm_gym"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "navbar_align": "left",
    "show_toc_level": 2,
    "header_links_before_dropdown": 7,
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": []}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

_SHOWN: dict[str, str] = {}
"""Where something is defined -> under which name the reference shows it."""


def setup(app: Any) -> None:
    """Write the generated pages, and read docstrings and links as the repository has them."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir)))
    app.connect("builder-inited", lambda app: _SHOWN.update(targets()))
    app.connect("source-read", _links_to_the_root)
    app.connect("autodoc-process-docstring", _markdown_docstring, priority=100)  # before napoleon
    app.connect("missing-reference", _shown_elsewhere)


def _links_to_the_root(app: Any, docname: str, source: list[str]) -> None:
    """Files of the repository's root that are pages of the site."""
    for page, file in PROJECT.items():
        source[0] = source[0].replace(f"](../{file}", f"](project/{page}.md")


def _markdown_docstring(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Environments' docstrings are Markdown, as Gymnasium's are."""
    if is_markdown("\n".join(lines)):
        lines[:] = markdown_to_rst(lines)


def _shown_elsewhere(app: Any, env: Any, node: Any, contnode: Any) -> Any:
    """What docstrings and annotations call by the module that defines it."""
    target = _SHOWN.get(node.get("reftarget", ""))
    if node.get("refdomain") != "py" or target is None:
        return None
    domain = env.get_domain("py")
    return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node, contnode)
