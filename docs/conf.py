# SPDX-License-Identifier: Apache-2.0
"""Sphinx's configuration of the documentation site. `docs/build.py` lays out its sources and
runs it.
"""

import json
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project, author, copyright = "Coincid", "The Coincid authors", "2026, The Coincid authors"
version = release = PROJECT["version"]
language = "en"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**", "examples/README.md", "gallery/**", "api/**"]
exclude_patterns = ["gallery/**.py", "gallery/**.ipynb", "gallery/**.md5"]
default_role = "literal"  # docstrings have names in single backticks

myst_heading_anchors = (
    4  # the same anchors as on a Git host, so that a link to a missing heading is a warning
)

autodoc_member_order = "bysource"
# names of the front door are also in their rooms: two targets for one name
suppress_warnings = ["ref.python"]
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
napoleon_google_docstring = False

sphinx_gallery_conf = {
    "examples_dirs": "programs",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "ignore_pattern": r"bench_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "min_reported_time": 1e6,  # times hold on one machine only
    "show_memory": False,
    "write_computation_times": False,
    "show_signature": False,
    "remove_config_comments": True,
    "download_all_examples": False,
}

html_theme = "furo"
html_title = f"Coincid {release}"
html_extra_path = [str(ROOT / "build" / "docs-source" / "extra")]
html_copy_source = html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": False}

# begins a heading of the index; the links below it become a part of the table of contents
READERS = "## "


def contents(text):
    """Return hidden tables of contents for the index, one per heading, with the pages that are
    linked below the heading.
    """
    tables = []
    for part in re.split(rf"^{READERS}", text, flags=re.MULTILINE)[1:]:
        caption, _, body = part.partition("\n")
        pages = [
            f"/docs/{link}"[:-3]
            for link in re.findall(r"^\* \[[^]]*\]\(([\w./-]+\.md)\)", body, re.MULTILINE)
        ]
        pages = [page.replace("/docs/../", "/") for page in pages]
        tables.append((caption, pages))
    tables.append(("Reference", ["/gallery/index", "/api/index"]))
    return "\n".join(
        f"```{{toctree}}\n:hidden:\n:caption: {caption}\n\n" + "\n".join(pages) + "\n```\n"
        for caption, pages in tables
    )


def add_contents(app, name, source):
    if name == root_doc:
        source[0] += "\n" + contents(source[0])


# texts of all pages: the search takes excerpts from it where a browser may not read files
TEXTS = "texts.js"
READ_TEXTS = """
if (location.protocol === "file:") {
  window.fetch = async (address) => {
    const top = new URL(document.documentElement.dataset.content_root, location).href;
    return new Response(TEXTS[decodeURI(new URL(address, location).href.slice(top.length))] ?? "");
  };
}
"""


def load_texts(app, name, template, context, doctree):
    if name == "search":
        app.add_js_file(TEXTS)


def write_texts(app, error):
    """Write the texts of all pages as a script, and keep only the attributes that are anchors."""
    if error or app.builder.format != "html":
        return
    site, texts = Path(app.outdir), {}
    for path in sorted(site.rglob("*.html")):
        main = re.search(
            r"<article\b[^>]*role=\"main\".*?</article>",
            path.read_text(encoding="utf-8"),
            re.DOTALL,
        )
        if main:
            plain = re.sub(r"<(script|svg|style)\b.*?</\1>", "", main[0], flags=re.DOTALL)
            kept = re.sub(r"<(\w+)[^>]*?((?: id=\"[^\"]*\")?)[^>]*>", r"<\1\2>", plain)
            texts[path.relative_to(site).as_posix()] = f'<div role="main">{kept}</div>'
    (site / "_static" / TEXTS).write_text(
        f"const TEXTS = {json.dumps(texts)};{READ_TEXTS}", encoding="utf-8"
    )


def describe_thumbnails(app, doctree, name):
    """Give each picture of the gallery's index the title of its example as alternative text."""
    for image in doctree.findall(lambda node: node.tagname == "image" and not node.get("alt")):
        example = re.search(r"sphx_glr_(\w+)_thumb", image["uri"])
        if example:
            image["alt"] = app.env.titles[f"gallery/{example[1]}"].astext()


NUMPY_SECTIONS = {"Parameters", "Returns", "Raises", "Attributes", "Yields"}


def plain_text(app, what, name, obj, options, lines):
    """Treat docstrings as plain text: only names in backticks, headings and lists are markup."""
    underlined = [i for i, line in enumerate(lines) if re.fullmatch(r"\s*-{3,}\s*", line)]
    if any(lines[i - 1].strip() in NUMPY_SECTIONS for i in underlined):
        return  # left to napoleon
    for i in underlined:
        lines[i - 1], lines[i] = lines[i - 1] + ":", ""
    if what == "property" and lines:
        lines[0] = lines[0].replace(": ", " -- ", 1)  # a colon would make a link of the type
    text = "\n".join(lines)
    if text.count("`") % 2:
        text = text.replace("`", "")
    parts = text.split("`")
    parts[::2] = [re.sub(r"([*|\\]|_(?=\W|$))", r"\\\1", part) for part in parts[::2]]
    text = re.sub(r"`([^`]+)`", r"``\1``\\ ", "`".join(parts))
    text = re.sub(r"(?<=\w)``(?=\w)", r"\\ ``", text)
    text = re.sub(r"^(\s*)\\\* ", r"\1* ", text, flags=re.MULTILINE)
    lines[:] = "\n\n".join(map(as_written, re.split(r"\n\s*\n", text))).split("\n")


def as_written(paragraph):
    """Keep the lines of a paragraph that is indented in steps; let others flow."""
    rows = [row for row in paragraph.split("\n") if row.strip()]
    if not rows:
        return paragraph
    steps = {len(row) - len(row.lstrip()) for row in rows}
    least = min(steps)
    is_list = re.match(r"\s*([*-]|\d+\.) ", rows[0]) and all(
        re.match(r"\s*([*-]|\d+\.) ", row) for row in rows if len(row) - len(row.lstrip()) == least
    )
    if is_list or (len(steps) == 1 and not re.match(r"\s*([*-]|\d+\.) ", rows[0])):
        return paragraph
    return "\n".join(f"| {row[least:]}" for row in rows)


def setup(app):
    app.connect("source-read", add_contents)
    app.connect("doctree-resolved", describe_thumbnails)
    app.connect("html-page-context", load_texts)
    app.connect("build-finished", write_texts)
    app.connect("autodoc-process-docstring", plain_text, priority=400)  # before napoleon
