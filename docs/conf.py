"""Sphinx's settings for the documentation: `make docs`."""

import sys
import tomllib
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

_about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "maglev_mj"
author = "the maglev_mj authors"
copyright = author
html_title = project
repository_url = _about["urls"]["Repository"]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "browser_pages",  # pages that run in the browser
    "repository_links",  # other files outside docs
    "public_names",  # the reference of public names
    "command_pages",  # the reference of commands
]
exclude_patterns = ["_build", "_contents.md", "_ext", "jupyter_execute", "**.ipynb_checkpoints"]
default_role = "py:obj"  # `name` in a docstring links to the name, where it is public
suppress_warnings = ["ref.python"]  # a type's name in a signature that two rooms have
smartquotes_action = "D"  # dashes alone; quotes stay as typed
highlight_language = "text"  # an indented block is typed or printed

myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath", "html_image"]
nb_execution_mode = "off"  # outputs are stored, and `make docs` checks them

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"
napoleon_custom_sections = [("Attributes", "params_style"), ("Class attributes", "params_style")]
napoleon_use_rtype = False
copybutton_exclude = ".linenos, .gp, .go"  # prompts and output of an example

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options: dict[str, list[str]] = {"top_of_page_buttons": []}
linkcheck_ignore = [rf"{repository_url}.*"]  # published with the repository


def setup(app: Sphinx) -> None:
    """Register the language of the bytes in the protocol's page, and the contents of the site."""
    app.add_lexer("golden", TextLexer)
    app.connect("source-read", add_contents)


def add_contents(app: Sphinx, page: str, source: list[str]) -> None:
    """Append the tables of contents to the first page, which a code host shows without them."""
    if page == "index":
        source[0] += "\n" + (ROOT / "docs" / "_contents.md").read_text(encoding="utf-8")
