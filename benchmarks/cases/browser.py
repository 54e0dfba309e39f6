"""A headless Chromium of the distribution: what pages complain about, and what they would load."""

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# software draws: machines of tests have no graphics; root needs no sandbox
_OPTIONS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = 1300, 800  # pixels of a page


def chromium() -> str | None:
    """The program, or None where there is none, or no playwright to drive it."""
    if importlib.util.find_spec("playwright") is None:
        return None
    return next((path for path in map(shutil.which, _NAMES) if path), None)


class Loaded:
    """A page in the browser, with what it has complained about."""

    def __init__(self, page: Any) -> None:
        self.page, self.complaints = page, []
        page.on("console", lambda message: self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", self._asked)
        self._tools = page.context.new_cdp_session(page)
        self._tools.send("Performance.enable", {"timeDomain": "threadTicks"})

    def _asked(self, request: Any) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            self.complaints.append(f"the page asks for {request.url}")

    def run(self, script: str, *given: Any) -> Any:
        """The value of a function of JavaScript."""
        return self.page.evaluate(script, *given)

    def seconds(self) -> float:
        """Seconds of the processor that the page itself has taken: its scripts, layout and painting."""
        metrics = self._tools.send("Performance.getMetrics")["metrics"]
        return float(next(one["value"] for one in metrics if one["name"] == "TaskDuration"))

    def picture(self, path: Path) -> Path:
        self.page.screenshot(path=path)
        return path


@contextmanager
def browser(program: str, size: tuple[int, int] = SIZE) -> Iterator[Any]:
    """A function that loads a file as a `Loaded` page; more options start a browser of its own."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tool:
        running: dict[tuple[str, ...], Any] = {}

        def load(file: Path, *more: str) -> Loaded:
            if more not in running:
                running[more] = tool.chromium.launch(executable_path=program, args=[*_OPTIONS, *more])
            page = running[more].new_page(viewport={"width": size[0], "height": size[1]})
            loaded = Loaded(page)
            page.goto(file.resolve().as_uri())
            return loaded

        try:
            yield load
        finally:
            for one in running.values():
                one.close()
