# SPDX-License-Identifier: Apache-2.0
"""What the files of the project import when they are imported, and which packages its extras
bring; read from the files, so that it is the same whatever is installed.
"""

import ast
from functools import cache
from importlib.metadata import packages_distributions, requires

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from .commands import ROOT

OURS = ("coincid", "docs")  # packages


@cache
def source_of(module):
    """Return the file of a module of this project, or None."""
    package, *parts = module.split(".")
    folders = (ROOT / "docs",) if package == "docs" else (ROOT, ROOT / "src" / "coincid")
    for folder in folders:
        path = folder.joinpath(*parts)
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if parts and file.exists():
                return file
    return None


def package_of(path):
    """Return the package of a file, as the parts of its name."""
    parts = path.relative_to(ROOT).parts[:-1]
    if parts[0] == "src":
        return parts[1:]
    return parts if parts[0] == "docs" else ("coincid", *parts)


def imported(nodes, path):
    """Yield the modules that some statements of a file import."""
    package = package_of(path)
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        if not isinstance(node, ast.ImportFrom):
            continue
        base = node.module or ""
        if node.level:
            base = ".".join([*package[: len(package) - node.level + 1], *filter(None, [base])])
        yield base
        if base.startswith(OURS):
            yield from (f"{base}.{alias.name}" for alias in node.names)


@cache
def imported_by(path):
    """Return the modules that a file imports when it is imported itself."""
    return tuple(imported(ast.parse(path.read_text(encoding="utf-8")).body, path))


def others_behind(modules):
    """Return the packages of others that some modules import when they are imported, directly or
    through modules of ours.
    """
    others, todo, done = set(), list(modules), set()
    while todo:
        name = todo.pop()
        if name in done:
            continue
        done.add(name)
        if not name.startswith(OURS):
            others.add(name.partition(".")[0])
        elif path := source_of(name):
            todo += imported_by(path)
    return others


_distributions = cache(packages_distributions)


def distributions_of(module):
    """Return the names of the installed distributions that a module comes with."""
    return {canonicalize_name(name) for name in _distributions().get(module, ())}


def packages_of(extra):
    """Return the packages that the project and one of its extras bring."""
    wanted = {canonicalize_name(name) for name in ("coincid", "setuptools")}
    todo = [Requirement(f"coincid[{extra}]")]
    done = set()
    while todo:
        one = todo.pop()
        key = (canonicalize_name(one.name), *sorted(one.extras))
        if key in done:
            continue
        done.add(key)
        wanted.add(key[0])
        for line in requires(one.name) or ():
            more = Requirement(line)
            if more.marker is None or any(
                more.marker.evaluate({"extra": name}) for name in ("", *one.extras)
            ):
                todo.append(more)
    return wanted
