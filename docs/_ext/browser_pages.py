"""Pages that a browser opens by themselves, in the site.

Each is a file of its own, `pages/NAME.html`; a link to its source leads there. A picture with such a link, which a code
host shows, becomes the page itself.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

from maglev_mj.views.pages import FOLDER, NAMES, one_file

_FRAME = """<iframe class="browser-page" src="{url}" title="{title}"></iframe>
<script>{{
  const frame = document.currentScript.previousElementSibling;
  const tell = () => {{  // the scheme that the reader has chosen for the site
    const {{ theme = "auto" }} = document.body.dataset;
    frame.contentWindow.postMessage({{ scheme: theme === "auto" ? "light dark" : theme }}, "*");
  }};
  new MutationObserver(tell).observe(document.body, {{ attributeFilter: ["data-theme"] }});
  addEventListener("message", ({{ source, data }}) => {{
    if (source !== frame.contentWindow || !(data?.height > 0)) return;
    frame.style.height = `${{Math.ceil(data.height)}}px`;
    tell();
  }});
}}</script>"""


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the hooks. That of links runs before the one of files outside docs."""
    app.connect("doctree-read", link_pages, priority=50)
    app.connect("build-finished", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def link_pages(app: Sphinx, page: nodes.document) -> None:
    """Turn links to the sources of pages into links to the pages, and linked pictures into the pages."""
    if app.builder.format != "html":
        return
    folder = Path(app.env.doc2path(app.env.docname)).parent
    up = "../" * app.env.docname.count("/")
    for link in [*page.findall(addnodes.download_reference), *page.findall(addnodes.pending_xref)]:
        path = (folder / link["reftarget"]).resolve()
        if link.get("reftype") != "myst" or path.parent != FOLDER.resolve() or path.stem not in NAMES:
            continue
        url = f"{up}pages/{path.stem}.html"
        if picture := next(iter(link.findall(nodes.image)), None):
            frame = _FRAME.format(url=url, title=escape(picture.get("alt", "")))
            link.parent.replace_self(nodes.raw("", frame, format="html"))
        else:
            link.replace_self(nodes.reference("", "", *link.children, refuri=url))


def write_pages(app: Sphinx, error: Exception | None) -> None:
    """Write the pages beside the site's own."""
    if error is None and app.builder.format == "html":
        folder = Path(app.outdir, "pages")
        folder.mkdir(exist_ok=True)
        for name in NAMES:
            (folder / f"{name}.html").write_text(one_file(name), encoding="utf-8")
