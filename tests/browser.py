"""A browser for tests of pages."""

import os
import shutil
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find_browser():
    """Find a Chromium, or skip."""
    for name in NAMES:
        if found := shutil.which(name):
            return found
    # where Playwright keeps its own
    default = Path.home() / ".cache" / "ms-playwright"
    folder = Path(os.environ.get("PLAYWRIGHT_BROWSERS_PATH", default))
    for found in sorted(folder.glob("chromium-*/chrome-linux*/chrome"), reverse=True):
        return str(found)
    pytest.skip(f"no browser: none of {', '.join(NAMES)} is on the path, nor one of Playwright's")
