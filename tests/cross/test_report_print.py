"""A report as it is printed in Chromium: four lines and the scene on the first page, nothing cut."""

from collections.abc import Callable
from pathlib import Path

import mbdlft
from tests.browser import Loaded
from tests.cross.test_viewer import scene_called

_MM = 96 / 25.4  # pixels
_WIDE, _HIGH = (210 - 2 * 15) * _MM, (297 - 2 * 16) * _MM  # A4 without the margins of the style sheet
MEASURED = """() => {
  const box = (one) => document.querySelector(one).getBoundingClientRect();
  const cut = [...document.querySelectorAll("h1, p, dd, table, svg")].filter((one) => one.getBoundingClientRect().right > window.innerWidth + 1);
  const unfolded = [...document.querySelectorAll("details")].filter((one) => one.checkVisibility());
  return { lines: document.querySelectorAll(".verdict dt").length, bottom: box(".views").bottom, cut: cut.length, unfolded: unfolded.length, folded: document.querySelectorAll("details").length };
}"""  # noqa: E501


def test_the_first_printed_page_has_four_lines_and_the_scene(
    load: Callable[..., Loaded], tmp_path: Path
) -> None:
    model = mbdlft.to_lft(scene_called("crane"), search=0.0)
    file = mbdlft.model_report(model).save(tmp_path / "report.html")
    loaded = load(file)
    loaded.page.set_viewport_size({"width": int(_WIDE), "height": int(_HIGH)})
    loaded.page.emulate_media(media="print")
    measured = loaded.run(MEASURED)
    assert loaded.complaints == []
    assert measured["lines"] == 4
    assert measured["bottom"] < _HIGH
    assert measured["cut"] == 0
    assert (measured["folded"], measured["unfolded"]) == (1, 0)
