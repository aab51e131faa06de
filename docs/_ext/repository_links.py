"""Links of a page to files outside the site."""

from __future__ import annotations

from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the hook.

    It runs before Sphinx's own, which copies linked files for download.
    """
    app.add_config_value("repository_url", "", "env")
    app.connect("doctree-read", link_repository, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def link_repository(app: Sphinx, page: nodes.document) -> None:
    """Turn links to files outside docs into repository URLs."""
    folder = Path(app.env.doc2path(app.env.docname)).parent
    links = [*page.findall(addnodes.download_reference), *page.findall(addnodes.pending_xref)]
    for link in links:
        if link.get("reftype") != "myst" or link["reftarget"] in app.env.found_docs:
            continue
        name, _, anchor = link["reftarget"].partition("#")
        path = (folder / name).resolve()
        if link.get("refdomain") == "doc":  # a page, without its suffix
            path, anchor = path.with_suffix(".md"), link.get("reftargetid") or ""
        if name and path.exists() and path.is_relative_to(ROOT):  # otherwise Sphinx warns
            kind = "tree" if path.is_dir() else "blob"
            url = f"{app.config.repository_url}/{kind}/main/{path.relative_to(ROOT).as_posix()}"
            found = nodes.reference("", "", *link.children, refuri=f"{url}#{anchor}" if anchor else url)
            link.replace_self(found)
