# SPDX-License-Identifier: Apache-2.0
"""What a program of the project depends on: source files, data files and packages, read from the
sources alone.

A program depends on its own module, on every module that is imported from there (also inside
functions), on the data files that these modules name, and on the versions of the packages that
they import. Nothing is imported to find this out, so it takes a fraction of a second, and no
machine and no installed package changes the answer.

A module names a data file of its room by a string that is the file's name, the name of the
folder in which it lies, or the suffix with which it differs from the module's own name. It names
a module or a package by a string, too, if the string is `coincid.ROOM.NAME`, the file name of a
module beside it, or the package's name in a lock file.

The modules are those of the package `coincid`, and the programs that only make pages,
`docs.studies.NAME`.
"""

import ast
import json
import re
import sys
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from functools import cache, cached_property
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from attrs import frozen

from ..model.shared.errors import InputError
from ..model.shared.files import whole_file
from ..model.shared.sources import IGNORED, PROJECT, digest

PACKAGE = Path("src") / PROJECT  # its rooms are links to folders of the checkout
PAGES = "docs"  # the package of the programs that only make pages, which no installation has
STUDIES = Path(PAGES) / "studies"
LOCKS = "requirements*.lock"
# packages by the name that is imported, if it differs from the name in the lock file
DISTRIBUTIONS = {
    "PIL": "pillow",
    "cocotb_tools": "cocotb",
    "coriolis": "coriolis-eda",
    "mpl_toolkits": "matplotlib",
    "serial": "pyserial",
    "systemrdl": "systemrdl-compiler",
    "vcd": "pyvcd",
}
OPTIONAL = {"pandas"}  # gives results another form, and changes no number
STEM_MIN = 4  # characters that a pattern of file names must begin with
FORMAT = "3"  # of what is kept; another one when `Facts` or their meaning changes
NAME_MAX = 60  # characters of a name; longer strings name nothing


@frozen
class Facts:
    """What one module says. imports: modules. packages: imported names. texts: strings, and
    patterns with *. digest: of its code.
    """

    imports: frozenset[str]
    packages: frozenset[str]
    texts: frozenset[str]
    digest: str


@frozen
class Closure:
    """Everything that a program depends on. modules, packages: by name. data: files. All are
    sorted.
    """

    modules: tuple[str, ...]
    data: tuple[Path, ...]
    packages: tuple[str, ...]


class Sources:
    """The sources of a checkout. root: the folder of pyproject.toml. cache: a file in which
    `keep` leaves what was read.
    """

    def __init__(self, root: Path, cache: Path | None = None) -> None:
        self.root = root
        self._cache = cache
        self._facts: dict[str, Facts] = {}
        self._names: dict[str, str] = {}
        self._files: dict[str, set[Path]] = {}
        self._before: dict[str, list[Any]] = _load(cache) if cache else {}

    @cached_property
    def modules(self) -> dict[str, Path]:
        """Return name -> path of all modules of the project."""
        found = {
            PROJECT: self.root / PACKAGE / "__init__.py",
            PAGES: self.root / PAGES / "__init__.py",
        }
        for path in (self.root / PACKAGE).glob("[!_]*.py"):
            found[f"{PROJECT}.{path.stem}"] = path
        for folder in self._rooms:
            for path in sorted(folder.rglob("*.py")):
                found[self._name(path)] = path
        return found

    def _name(self, path: Path) -> str:
        """Return the name of the module in a file of a room."""
        parts = [*path.relative_to(self.root).with_suffix("").parts]
        if parts[0] != PAGES:
            parts.insert(0, PROJECT)
        if parts[-1] == "__init__":
            parts.pop()
        return ".".join(parts)

    @cached_property
    def data(self) -> dict[str, list[Path]]:
        """Return name -> paths of all files of the rooms that are no modules."""
        found: dict[str, list[Path]] = {}
        for folder in self._rooms:
            for path in sorted(folder.rglob("*")):
                if path.is_file() and path.suffix != ".py" and not IGNORED & set(path.parts):
                    found.setdefault(path.name, []).append(path)
        return found

    @cached_property
    def _folders(self) -> set[str]:
        return {file.parent.name for files in self.data.values() for file in files}

    @cached_property
    def versions(self) -> dict[str, str]:
        """Return name -> version of the packages in all lock files."""
        found = {}
        for lock in sorted(self.root.glob(LOCKS)):
            for name, version in re.findall(
                r"^([\w.-]+)==(\S+)", lock.read_text(encoding="utf-8"), re.MULTILINE
            ):
                found[_plain(name)] = version
        return found

    @property
    def _rooms(self) -> list[Path]:
        """Return the folders of all modules, except for the package's own."""
        found = [self.root / STUDIES]
        for path in (self.root / PACKAGE).iterdir():
            if path.is_dir() and path.name not in IGNORED:
                found.append(self.root / path.name)
        return sorted(found)

    def facts(self, module: str) -> Facts:
        """Return what a module says."""
        if module not in self._facts:
            self._facts[module] = self._read(module)
        return self._facts[module]

    def closure(self, *programs: str, without: Iterable[str] = ()) -> Closure:
        """Return what modules depend on. without: modules or packages of modules that are left
        out. Raises `InputError`.
        """
        left_out = tuple(without)
        found: set[str] = set()
        pending = list(programs)
        while pending:
            module = pending.pop()
            if module in found or any(inside(module, other) for other in left_out):
                continue
            if module not in self.modules:
                raise InputError(f"{module}: is no module of the project")
            found.add(module)
            pending += self.facts(module).imports
            package = module.rpartition(".")[0]
            pending += [package] if package else []
        data: set[Path] = set()
        packages: set[str] = set()
        for module in found:
            data |= self._named_files(module)
            packages |= self._distributions(module)
        return Closure(tuple(sorted(found)), tuple(sorted(data)), tuple(sorted(packages)))

    def digest(self, closure: Closure, *more: str | Path) -> str:
        """Return a digest of the content of a closure, and of more files and texts."""
        parts: list[str | bytes] = []
        for module in closure.modules:
            parts += [module, self.facts(module).digest]
        for path in closure.data:
            parts += [str(path.relative_to(self.root)), path.read_bytes()]
        for name in closure.packages:
            parts += [name, self.versions[name]]
        for each in more:
            parts.append(each.read_bytes() if isinstance(each, Path) else each)
        return digest(*parts)

    def _read(self, module: str) -> Facts:
        path = self.modules[module]
        text = path.read_text(encoding="utf-8")
        name = digest(FORMAT, module, text)
        if name not in self._before:
            facts = self._parsed(module, text)
            self._before[name] = [
                sorted(facts.imports),
                sorted(facts.packages),
                sorted(facts.texts),
                facts.digest,
            ]
        imports, packages, texts, code = self._before[name]
        self._names[module] = name
        return Facts(frozenset(imports), frozenset(packages), frozenset(texts), code)

    def keep(self) -> None:
        """Leave what was read in the file `cache`, so that the next process need not read it."""
        if self._cache:
            with whole_file(self._cache, "w") as file:
                json.dump({name: self._before[name] for name in sorted(self._names.values())}, file)

    def _parsed(self, module: str, text: str) -> Facts:
        path = self.modules[module]
        tree = ast.parse(text)
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        named = set(_imported(tree, package))
        imports = set()
        packages = set()
        for base, name in named:
            if base.split(".")[0] not in (PROJECT, PAGES):
                packages.add(base.split(".")[0])
            elif f"{base}.{name}" in self.modules:
                imports.add(f"{base}.{name}")
            else:
                imports.add(base)
        texts = frozenset(_texts(tree))
        imports |= texts & self.modules.keys() - {PROJECT, PAGES}
        beside = {f"{package}.{text.removesuffix('.py')}" for text in texts if text.endswith(".py")}
        imports |= beside & self.modules.keys()
        return Facts(frozenset(imports), frozenset(packages), texts, digest(_code(text, tree)))

    def _named_files(self, module: str) -> set[Path]:
        """Return the data files that a module names."""
        if module not in self._files:
            self._files[module] = self._found_files(module)
        return self._files[module]

    def _found_files(self, module: str) -> set[Path]:
        path = self.modules[module]
        found: set[Path] = set()
        for text in self.facts(module).texts:
            name = path.stem + text if text.startswith(".") else text.rpartition("/")[2]
            everywhere = self.data.get(name, [])
            beside = [file for file in everywhere if file.parent == path.parent]
            found |= set(beside or everywhere)
            if name in self._folders:
                folder = path.parent / name
                found |= {
                    file for files in self.data.values() for file in files if file.parent == folder
                }
            if text.find("*") >= STEM_MIN:
                found |= {
                    file
                    for files in self.data.values()
                    for file in files
                    if file.parent == path.parent and fnmatch(file.name, text)
                }
        return found

    def _distributions(self, module: str) -> set[str]:
        """Return the locked packages that a module imports or names. Raises `InputError` for one
        that no lock file has.
        """
        facts = self.facts(module)
        found = {_plain(text) for text in facts.texts} & self.versions.keys()
        for name in facts.packages - sys.stdlib_module_names:
            distribution = _plain(DISTRIBUTIONS.get(name, name))
            if distribution in OPTIONAL:
                continue
            if distribution not in self.versions:
                raise InputError(f"{module}: imports {name}, which no lock file has")
            found.add(distribution)
        return found


def _load(path: Path) -> dict[str, list[Any]]:
    """Return what an earlier process left; nothing if it is missing or damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


@cache
def _plain(name: str) -> str:
    """Return the normalised name of a package."""
    return re.sub(r"[-_.]+", "-", name).lower()


def inside(module: str, package: str) -> bool:
    """Return whether a module is a package or in it."""
    return module == package or module.startswith(f"{package}.")


def _imported(tree: ast.AST, package: str) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of all imports, except those for types alone. name: "" for a whole
    module.
    """
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                yield base, alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, ""
        elif (
            isinstance(node, ast.If)
            and isinstance(node.test, ast.Name)
            and node.test.id == "TYPE_CHECKING"
        ):
            yield from _imported(ast.Module(node.orelse, []), package)
        else:
            yield from _imported(node, package)


def _texts(tree: ast.AST) -> Iterator[str]:
    """Yield all strings that may be names; those with inserted values as patterns."""
    for node in ast.walk(tree):
        text = ""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
        elif isinstance(node, ast.JoinedStr):
            text = "".join(
                str(part.value) if isinstance(part, ast.Constant) else "*" for part in node.values
            )
        if 0 < len(text) <= NAME_MAX and "\n" not in text:
            yield text


def _code(text: str, tree: ast.AST) -> str:
    """Return the code of a module without its docstrings, whole lines of comments and empty
    lines.
    """
    lines = text.splitlines()
    stays = [True] * len(lines)
    inside_text = set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant | ast.JoinedStr)
            and node.end_lineno
            and node.end_lineno > node.lineno
        ):
            inside_text |= set(range(node.lineno, node.end_lineno))
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and node.body
        ):
            first = node.body[0]
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                stays[first.lineno - 1 : first.end_lineno] = [False] * (
                    (first.end_lineno or first.lineno) - first.lineno + 1
                )
    for number, line in enumerate(lines):
        if number not in inside_text and (not line.strip() or line.lstrip().startswith("#")):
            stays[number] = False
    return "\n".join(line for line, keep in zip(lines, stays, strict=True) if keep)
