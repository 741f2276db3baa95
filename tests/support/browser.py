"""A headless Chromium that opens pages from disk."""

from __future__ import annotations

import contextlib
import shutil

import pytest

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]


@contextlib.contextmanager
def chromium():
    """A browser; the test is skipped where playwright or Chromium is not installed."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("Chromium is not installed")
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=path, args=[*FLAGS, "--enable-precise-memory-info"])
        try:
            yield browser
        finally:
            browser.close()


class Tab:
    """A page from disk that fails at its end if any script failed or anything was missing."""

    def __init__(self, browser, path, *, width=1280, height=800, fragment=""):
        self.faults = []
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("console", lambda line: line.type == "error" and self.faults.append(line.text))
        self.page.on("requestfailed", lambda request: self.faults.append(f"{request.url}: {request.failure}"))
        self.page.on("request", lambda request: self._local(request.url))
        self.page.goto(f"{path.as_uri()}{fragment}")

    def _local(self, url):
        if not url.startswith(("file:", "data:", "blob:")):
            self.faults.append(f"asked the network: {url}")

    def __enter__(self):
        return self.page

    def __exit__(self, kind, *_):
        self.page.close()
        if kind is None:
            assert not self.faults, self.faults
