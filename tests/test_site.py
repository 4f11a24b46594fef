# SPDX-License-Identifier: Apache-2.0
"""The documentation site: links and anchors lead somewhere, docstrings are well-formed, and pages
are whole.

The examples do not run here (`test_examples.py` runs them). The search is tried in a browser.
"""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from docs.studies.drawings.browser import FLAGS, chromium

ROOT = Path(__file__).parents[1]
pytestmark = [pytest.mark.needs("docs", "chromium")]


def copy_of_the_project(root):
    """Copy the files from which the site is made."""
    for name in ("docs", "examples"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.iterdir():
        if path.is_file() and path.suffix in {".md", ".cff", ".toml", ""}:
            shutil.copy(path, root)


def search_from_a_file(site):
    """Search a site that is opened from its files, and see an excerpt."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        tab = browser.new_page()
        tab.goto(f"file://{site}/search.html?q=crosstalk")
        tab.wait_for_selector("#search-results p.context")
        assert "rosstalk" in tab.locator("#search-results p.context").first.text_content()
        browser.close()


def test_sources_follow_the_pages_and_unchanged_ones_keep_their_time(tmp_path, monkeypatch):
    """A change of one digit counts; a page that is gone goes."""
    monkeypatch.syspath_prepend(ROOT)
    build = importlib.import_module("docs.build")
    monkeypatch.setattr(build, "SOURCE", tmp_path)
    build.lay_out({"docs/a.md": b"4.2 mm", "docs/b.md": b"same", "docs/c.md": b"gone"})
    os.utime(tmp_path / "docs" / "b.md", (1, 1))
    build.lay_out({"docs/a.md": b"4.3 mm", "docs/b.md": b"same"})
    found = {path.name: path.read_bytes() for path in (tmp_path / "docs").iterdir()}
    assert found == {"a.md": b"4.3 mm", "b.md": b"same"}
    assert (tmp_path / "docs" / "b.md").stat().st_mtime == 1


@pytest.mark.long  # makes the whole site
def test_a_bad_link_is_the_only_warning(tmp_path):
    project = tmp_path / "project"
    copy_of_the_project(project)
    with open(project / "docs" / "depth.md", "a", encoding="utf-8") as file:
        file.write("\n[a heading that is not there](contract.md#nowhere)\n")
    command = [sys.executable, project / "docs" / "build.py", "-D", "plot_gallery=0"]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    warnings = [line for line in done.stderr.splitlines() if "WARNING" in line or "ERROR" in line]
    assert done.returncode != 0 and len(warnings) == 1 and "nowhere" in warnings[0], done.stderr
    site = project / "build" / "docs"
    for page in "index README docs/index docs/contract docs/integrate api/coincid gallery/index search".split():
        assert (site / f"{page}.html").exists(), page
    assert "estimate_depth" in (site / "api" / "coincid.html").read_text(encoding="utf-8")
    for path in site.rglob("*.html"):
        page = path.read_text(encoding="utf-8")
        assert re.search(r"<title>\w", page), f"{path}: has no title"
        prose = re.sub(r"<(pre|code|script)\b.*?</\1>", "", page, flags=re.DOTALL)
        assert "](" not in prose, f"{path}: has a link that is not one"
        pictures = re.findall(r"<img\b[^>]*>", prose)
        assert all(re.search(r'alt="[^"]+"', picture) for picture in pictures), (
            f"{path}: a picture says nothing"
        )
    search_from_a_file(site)
