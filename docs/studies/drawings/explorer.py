# SPDX-License-Identifier: Apache-2.0
"""Takes the picture of the explorer after its third step, in Chromium."""

import subprocess
import sys

from coincid.model.shared.errors import InputError
from coincid.tools.pages import picture, put

from .browser import FLAGS, chromium

PICTURE = "docs/images/explorer.png"
SERVER = f"from {__name__} import serve_explorer; serve_explorer()"
SHOWN = "document.body.dataset.state === 'shown'"
STEP, TITLE = "3 Threshold 5", "threshold 5"
PATIENCE_MS = 240_000


def serve_explorer() -> None:
    """Serve the explorer at a free port, and print its address."""
    from coincid.study.explore.control_values import given_settings
    from coincid.study.explore.server import serve

    serve(0, browser=False, start=given_settings([]))


def make() -> None:
    """Write the picture into its page. Raises `InputError` without Chromium."""
    program = chromium()
    if program is None:
        raise InputError("chromium: is not installed; scripts/setup chromium installs it")
    from playwright.sync_api import sync_playwright

    server = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True, encoding="utf-8"
    )
    assert server.stdout is not None
    try:
        address = server.stdout.readline().split()[2]
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
            tab = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
            tab.set_default_timeout(PATIENCE_MS)
            tab.goto(address)
            tab.wait_for_function(SHOWN)
            tab.get_by_text(STEP).click()
            tab.wait_for_function(f"{SHOWN} && document.body.innerText.includes('{TITLE}')")
            tab.screenshot(path=picture(PICTURE))
            browser.close()
    finally:
        server.kill()
        server.wait()
    put("docs/explorer.md", "picture")
