"""Sphinx configuration of the docs site: ``make docs`` builds it into ``build/docs``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from docutils import nodes

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))

from api_page import targets  # noqa: E402
from docstrings import escape_bars, is_markdown, markdown_to_rst  # noqa: E402
from site_pages import PROJECT, sections, toctree, write_pages  # noqa: E402

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
suppress_warnings = ["ref.python"]  # an attribute "steps" of several classes, and annotations such as "slice"
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
_SECTIONS: dict[str, list[str]] = {}
"""Page -> the pages below it."""
_COLON = "\0"


def setup(app: Any) -> None:
    """Write the generated pages, and read docstrings and links as the repository has them."""
    write_pages()
    _SECTIONS.update(sections())
    _SHOWN.update(targets())
    app.connect("env-get-outdated", lambda *_: [*_SECTIONS])  # what is below them is not in their files
    app.connect("source-read", _as_a_page)
    app.connect("autodoc-process-docstring", _before_napoleon, priority=100)
    app.connect("autodoc-process-docstring", _after_napoleon, priority=900)
    app.connect("missing-reference", _shown_elsewhere)


def _as_a_page(app: Any, docname: str, source: list[str]) -> None:
    """Links to files of the repository's root that are pages of the site, and the pages below this one."""
    for page, file in PROJECT.items():
        source[0] = source[0].replace(f"](../{file}", f"](project/{page}.md")
    if docname in _SECTIONS:
        source[0] += toctree(_SECTIONS[docname])


def _before_napoleon(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Turn Markdown to reStructuredText, and hide colons of an attribute's text, which napoleon takes for a type's."""
    lines[:] = markdown_to_rst(lines) if is_markdown("\n".join(lines)) else [escape_bars(line) for line in lines]
    if what in ("attribute", "data", "property"):
        end = lines.index("") if "" in lines else len(lines)
        lines[:end] = [line.replace(":", _COLON) for line in lines[:end]]


def _after_napoleon(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = [line.replace(_COLON, ":") for line in lines]


def _shown_elsewhere(app: Any, env: Any, node: Any, contnode: Any) -> Any:
    """What docstrings and annotations call by the module that defines it."""
    if node.get("refdomain") != "py":
        return None
    target = _SHOWN.get(node["reftarget"])
    if target is not None:
        domain = env.get_domain("py")
        return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node, contnode)
    return (
        None if isinstance(contnode, nodes.literal) else contnode
    )  # an annotation names what the reference leaves out
