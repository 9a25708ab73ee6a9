"""A real browser for pages that people open: Chromium, headless, driven by Playwright."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page, sync_playwright

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the PATH")


@contextmanager
def opened(path: Path, allowed: str = "$^") -> Iterator[Page]:
    """Open a page from its file, without network.

    What its console says is an error of the test, but for what matches the pattern ``allowed``.
    """
    said: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(offline=True, viewport={"width": 1200, "height": 900})
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("requestfailed", lambda request: said.append(f"not there: {request.url}"))
        # Without a graphics card WebGL is drawn in software, which takes its time.
        page.set_default_timeout(150_000)
        page.goto(path.resolve().as_uri())
        try:
            yield page
        finally:
            browser.close()
    assert [text for text in said if not re.search(allowed, text)] == []
