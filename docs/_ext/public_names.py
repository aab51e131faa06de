"""Reference pages of the public names, from docstrings.

One for each package, and one for the modules beside them.
"""

from __future__ import annotations

import ast
import pkgutil
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from inspect import getdoc, getsource, isclass, isroutine, signature, unwrap
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from command_pages import as_rst, table, title, write
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.inspect import stringify_signature

import maglev_mj

_FOLDER = "reference/api"
_INTERNAL = {"__main__", "colours", "lazy", "process", "terminal", "versions"}
_INTERNAL |= {"cli", "display", "hand_devices", "net", "viewer", "web"}  # programs: their reference is the commands'
_BESIDE = "modules"
"""Page of the modules beside the packages."""

_COLUMNS, _WIDTHS = ("Name", "Summary"), (30, 70)
_SHORT = 60
"""Characters of a value that is shown."""

Homes: TypeAlias = dict[int | str, tuple[str, str]]
"""Page and path of each object."""

_paths: dict[str, str] = {}
"""Path of each name that only one object has."""


class Name(NamedTuple):
    """A public name.

    Attributes:
        module: Module that gives it.
        name: Its name there.
        found: The object.
    """

    module: str
    name: str
    found: Any

    @property
    def path(self) -> str:
        """Name from the package on."""
        return f"{self.module}.{self.name}"

    @property
    def is_data(self) -> bool:
        """True for a value, which does not know its name."""
        named = isclass(self.found) or isroutine(self.found)
        return not (named and str(unwrap(self.found).__module__).startswith("maglev_mj."))

    @property
    def key(self) -> int | str:
        """Key that two names of one object share."""
        return self.path if self.is_data else id(unwrap(self.found))

    @property
    def package(self) -> str:
        """Package of its source."""
        return str(self.module if self.is_data else unwrap(self.found).__module__).split(".")[1]

    @property
    def directive(self) -> str:
        """Directive that documents it."""
        if isclass(self.found):
            return "autoexception" if issubclass(self.found, BaseException) else "autoclass"
        return "autodata" if self.is_data else "autofunction"


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the generator of the pages and its hooks."""
    app.connect("config-inited", write_pages)
    app.connect("autodoc-process-signature", keep_annotations)
    app.connect("autodoc-process-docstring", keep_colon, priority=499)  # before napoleon
    app.connect("missing-reference", link_name)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_pages(app: Sphinx, _: object) -> None:
    """Write the pages of packages and modules, and the index."""
    folder = Path(app.srcdir, _FOLDER)
    folder.mkdir(exist_ok=True)
    packages = [one.name for one in pkgutil.iter_modules(maglev_mj.__path__) if one.ispkg]
    given = {package: _names(f"maglev_mj.{package}") for package in packages if package not in _INTERNAL}
    for name in _names("maglev_mj"):  # one that its own package does not give
        if name.package in given and name.key not in {one.key for one in given[name.package]}:
            given[name.package].append(name)
    given[_BESIDE] = [name for module in _modules("maglev_mj") for name in _names(module)]
    homes = _homes(given)
    known = [(path.rpartition(".")[2], path) for _, path in homes.values()]
    uses = Counter(bare for bare, _ in known)
    _paths.update({bare: path for bare, path in known if uses[bare] == 1})
    pages = {page: _page(page, names, homes) for page, names in given.items()}
    for page, lines in {**pages, "index": _index(given, homes)}.items():
        write(folder / f"{page}.rst", lines)


def keep_annotations(app: Sphinx, what: str, _: str, found: Any, *more: Any) -> tuple[str, str] | None:
    """Return a signature with types as written.

    For a class it is that of `__init__`.
    """
    try:
        made = signature(found)
    except (TypeError, ValueError):  # no callable, or one of the interpreter's
        return None
    unbound = what == "method" and next(iter(made.parameters), "") == "self"
    words = list(made.parameters.values())[unbound:]
    arguments, arrow, returned = stringify_signature(made.replace(parameters=words)).partition(" -> ")
    return arguments, returned if arrow and what != "class" else ""


def keep_colon(app: Sphinx, what: str, _: str, found: object, options: object, lines: list[str]) -> None:
    """Keep text before a colon in a value's description.

    Napoleon would take it for a type.
    """
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]  # a comment: the first line has no colon then


def link_name(app: Sphinx, env: Any, link: Any, shown: Any) -> Any:
    """Return a link for another package's name, or None."""
    if link.get("refdomain") == "py" and (path := _paths.get(link["reftarget"])) is not None:
        return env.domains.python_domain.resolve_xref(env, link["refdoc"], app.builder, "obj", path, link, shown)
    return None


def _modules(package: str) -> list[str]:
    found = pkgutil.iter_modules(import_module(package).__path__)
    return [f"{package}.{one.name}" for one in found if not one.ispkg and one.name not in _INTERNAL]


def _names(module: str) -> list[Name]:
    """Return the names of a module.

    For a package without names of its own those of its modules.
    """
    loaded = import_module(module)
    if not hasattr(loaded, "__all__") and hasattr(loaded, "__path__"):
        return [name for inner in _modules(module) for name in _names(inner)]
    public = getattr(loaded, "__all__", None) or _described(module)
    names = [Name(module, name, getattr(loaded, name)) for name in public]
    return [one._replace(module=_source(module, one.name)) if one.is_data else one for one in names]


def _described(module: str) -> list[str]:
    """Return the classes, functions and described values of a module without an underscore."""
    nodes, found = ast.parse(getsource(import_module(module))).body, []
    for node, after in zip(nodes, [*nodes[1:], None]):
        described = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.append(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and described:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found += [target.id for target in targets if isinstance(target, ast.Name)]
    return sorted({name for name in found if not name.startswith("_")})  # an overloaded one is there several times


def _source(module: str, name: str) -> str:
    """Return the module that defines and describes a value."""
    stub = Path(f"{import_module(module).__file__}i")  # of a package's face
    source = stub.read_text(encoding="utf-8") if stub.exists() else getsource(import_module(module))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and any(one.name == name for one in node.names):
            return _source(str(node.module), name)
    return module


def _homes(given: Mapping[str, Sequence[Name]]) -> Homes:
    """Return page and path of each object.

    The page is that of its own package, if that gives it.
    """
    names = [(page, one) for page, names in given.items() for one in names]
    own = {one.key: (page, one.path) for page, one in names if one.package == page}
    return {one.key: (page, one.path) for page, one in names} | own


def _page(page: str, names: Sequence[Name], homes: Homes) -> Iterator[str]:
    package = None if page == _BESIDE else import_module(f"maglev_mj.{page}")
    yield from title("Modules beside the packages" if package is None else f"maglev_mj.{page}", "=")
    if package is not None:
        yield as_rst(str(getdoc(package)))
    yield from _summaries(names, homes)
    for module, group in groupby(names, lambda name: name.module):
        if not hasattr(package, "__all__"):
            yield from title(module, "-")
            yield as_rst(str(getdoc(import_module(module))).partition("\n")[0])
        for name in group:
            if homes[name.key] == (page, name.path):
                yield from ("", f".. {name.directive}:: {name.path}")
                if isclass(name.found):
                    yield "   :members:"
                elif name.is_data and len(repr(name.found)) > _SHORT:
                    yield "   :no-value:"


def _index(given: Mapping[str, Sequence[Name]], homes: Homes) -> Iterator[str]:
    yield from title("Python API", "=")
    yield as_rst(
        "`import maglev_mj` gives the names of the tutorials and how-to pages; further names are in its packages."
    )
    keys = {name.name: name.key for name in _names("maglev_mj")}
    for group in re.split(r"\n\n(?=\S.*:\n\n)", str(getdoc(maglev_mj)))[1:]:
        head, _, listed = group.partition(":\n\n")
        yield from title(head, "-")
        named = re.findall(r"^ +(\w+) +(.+)$", listed, re.MULTILINE)
        yield from table(_COLUMNS, [(_link(name, homes[keys[name]]), as_rst(text)) for name, text in named], _WIDTHS)
    yield from title("Packages", "-")
    rows = []
    for page in given:
        about = "Modules beside the packages." if page == _BESIDE else str(getdoc(import_module(f"maglev_mj.{page}")))
        rows.append((f":doc:`{page}`", as_rst(about.partition("\n")[0])))
    yield from table(("Package", "Content"), rows, _WIDTHS)
    yield from ("", ".. toctree::", "   :hidden:", "", *(f"   {page}" for page in given))


def _summaries(names: Sequence[Name], homes: Homes) -> Iterator[str]:
    rows = []
    for name in names:
        rows.append((_link(name.name, homes[name.key]), as_rst(_text(name).partition("\n")[0])))
    yield from table(_COLUMNS, rows, _WIDTHS)


def _text(name: Name) -> str:
    """Return a name's docstring; that of a value follows it."""
    if name.is_data:
        return "\n".join(ModuleAnalyzer.for_module(name.module).find_attr_docs().get(("", name.name), []))
    return str(getdoc(name.found))


def _link(name: str, home: tuple[str, str]) -> str:
    return f":py:obj:`{name} <{home[1]}>`"
