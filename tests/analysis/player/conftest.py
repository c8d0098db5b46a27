"""A headless browser that fails a test for what a page logs or asks of the network."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
#: Milliseconds; a busy machine is slow.
PATIENCE = 60_000


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium as the system has it, driven by Playwright."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no browser test: playwright is not installed"
    )
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip(f"no browser test: there is none of {', '.join(NAMES)}")
    # Chromium's own sandbox does not work for root, as in a container.
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=path, args=options, timeout=PATIENCE)
        yield running
        running.close()


Visit = Callable[..., Any]


@pytest.fixture
def visit(browser: Any, tmp_path: Path) -> Iterator[Visit]:
    """Open HTML as a file; fail the test if a page logs an error or asks for anything else."""
    contexts, complaints = [], []

    def open_page(text: str, **context: Any) -> Any:
        file = tmp_path / f"page{len(contexts)}.html"
        file.write_text(text, encoding="utf-8")
        contexts.append(browser.new_context(**context))
        page = contexts[-1].new_page()
        page.set_default_timeout(PATIENCE)
        own = file.as_uri()

        def note_request(request: Any) -> None:
            if request.url != own and not request.url.startswith("data:"):
                complaints.append(f"asked for {request.url}")

        def note_message(message: Any) -> None:
            if message.type in ("error", "warning"):
                complaints.append(f"logged {message.text}")

        page.on("request", note_request)
        page.on("console", note_message)
        page.on("pageerror", lambda error: complaints.append(f"raised {error}"))
        page.goto(own)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not complaints
