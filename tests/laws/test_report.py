"""Reports of models: what they say is what the model, its certificate and its archive say."""

import json
import re
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import fastjsonschema
import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import MbdlftError
from mbdlft.multibody import scene_from_toml, scene_schema, scene_to_toml
from mbdlft.robust.evidence import Bounds, BoxProof
from mbdlft.show import model_report
from mbdlft.show.report import content, page, sentences
from mbdlft.show.viewer import stills
from mbdlft.show.viewer.stills import scene_film, scene_picture
from mbdlft.system.model import LFTModel
from tests.attack.scenes import texts
from tests.attack.structures import as_toml, restructured
from tests.close import PAGE, target
from tests.cross.mechanisms import open_tree
from tests.scenarios.commands import Call, Output

ROOT = Path(__file__).parents[2]


def scene(name: str) -> mbdlft.Scene:
    return mbdlft.load_scene(ROOT / "scenarios" / f"{name}.toml")


@cache
def model_of(name: str) -> LFTModel:
    return mbdlft.to_lft(scene(name), search=0.0, prove=0.0)


class Texts(HTMLParser):
    """The cells of all tables, and tags that are open."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: set[str] = set()
        self.cell = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag == "tr":
            self.rows.append([])
        self.cell = tag in ("td", "th")
        if self.cell:
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self.cell:
            self.rows[-1][-1] += data

    def handle_endtag(self, tag: str) -> None:
        self.cell = self.cell and tag not in ("td", "th")


def read(html: str) -> Texts:
    found = Texts()
    found.feed(html)
    return found


def test_the_report_of_the_arm() -> None:
    """Parameters, repetitions, equilibrium and poles are in its tables."""
    model = model_of("two_link_arm")
    html = model_report(model).html
    found = read(html)
    rows = {row[0]: row for row in found.rows if row}
    c = model.certificate
    for k, p in enumerate(model.parameters):
        counts = [str(entry[k]) for entry in (c.raw_order, c.order, c.lower_bound)]
        span = f"{p.low:g} to {p.high:g}"
        assert rows[p.name][:8] == [p.name, f"{p.nominal:g}", span, p.unit, p.role, *counts]
    for signal, value in zip(model.trim.signals, model.trim.nominal, strict=True):
        target(float(rows[signal.name][1]), value, PAGE)
    assert [row[1] for row in found.rows if row[:1] == ["input"]] == [
        signal.name for signal in model.inputs
    ]
    assert "script" not in found.tags
    assert "unstable at nominal" in html


def test_loads_lie_between_the_least_and_the_largest() -> None:
    """shoulder.torque = g (...) of the arm in closed form is monotone in m3: corners have its ends."""
    model = model_of("two_link_arm")
    rows, points = content.trim_rows(model)
    assert points == 2 ** len(model.parameters) + 300
    corners = mbdlft.corners(model.parameters)
    found = mbdlft.trim_at(model, corners)
    for row, column in zip(rows, found.T, strict=True):
        least, largest = float(row.least), float(row.largest)
        assert least <= float(row.nominal) <= largest
        scale = float(np.max(np.abs(column)))
        assert least <= np.min(column) + 1e-5 * scale
        assert largest >= np.max(column) - 1e-5 * scale


def test_the_first_sentence_follows_the_certificate() -> None:
    model = model_of("pendulum")
    assert "proved to be the least" in content.verdict_sentence(model)
    c = replace(model.certificate, order=(3, 2), raw_order=(3, 2))
    assert "has at least 3" in content.verdict_sentence(replace(model, certificate=c))
    c = replace(model.certificate, exact=False, truncation_error=0.1)
    assert "The model is an approximation." in content.verdict_sentence(replace(model, certificate=c))
    matrix = mbdlft.realize(mbdlft.load_matrix(ROOT / "scenarios" / "missile.toml"), search=0.0)
    assert "equals the matrix at every value" in content.verdict_sentence(matrix)
    plain = mbdlft.as_system(mbdlft.state_space([[-1.0]], [[1.0]], [[1.0]], [[0.0]], name="lag"))
    assert "without evidence" in content.verdict_sentence(plain)


def test_what_is_to_be_done_next_follows_what_is_known() -> None:
    hanging, balancing = model_of("double_pendulum_hanging"), model_of("double_pendulum_inverted")
    proved = replace(hanging.certificate, well_posed="proved")
    hanging = replace(hanging, certificate=proved)
    said = content.stability_sentences(hanging)
    (what, _), (_, sure), (_, seen), (_, then) = content.summary(hanging, said, (), None)
    assert what == "What it is"
    assert sure == content.verdict_sentence(hanging)
    assert seen.startswith("Stable at nominal")
    assert "mbdlft margin double_pendulum_hanging.h5" in then
    open_ = replace(hanging, certificate=replace(proved, well_posed="sampled"))
    assert "--prove" in content.next_step(open_, said, (), None)
    assert "close a loop" in content.next_step(
        replace(balancing, certificate=proved), content.stability_sentences(balancing), (), "a.h5"
    )
    case = content.Worst("m: margin", proved=True, sentences=("Stable: proved.",), rows=())
    assert "mbdlft view a.h5" in content.next_step(hanging, said, (case,), "a.h5")
    plain = mbdlft.state_space([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    assert content.next_step(plain, said, (case,), "a.h5") == "Look at the worst cases below."
    assert content.next_step(plain, said, (), "a.h5") == "Look at it: mbdlft response a.h5."
    assert content.summary(hanging, said, (case,), None)[1][1].endswith("m: margin: Stable: proved.")
    assert "--work" in content.next_step(hanging, said, (case._replace(proved=False),), "a.h5")


@pytest.mark.parametrize("name", ["ur5", "solar_arrays", "half_car"])
def test_names_in_still_pictures_cover_none(name: str) -> None:
    """Their boxes, with the width that a letter has at most, have no common point."""
    picture = ET.fromstring(scene_picture(scene(name)))
    found = [one for one in picture.iter() if one.tag.endswith("text")]
    boxes = [(float(one.attrib["x"]), float(one.attrib["y"]), 6.0 * len(one.text or "")) for one in found]
    assert len(boxes) > 8
    for k, (x, y, wide) in enumerate(boxes):
        for a, b, other in boxes[k + 1 :]:
            assert x + wide <= a or a + other <= x or abs(y - b) >= 11.0


def test_names_of_many_loads_are_not_all_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Places for 1,000 names took a minute."""
    monkeypatch.setattr(stills, "_MOST_NAMES", 3)
    found = [
        text.text
        for text in ET.fromstring(scene_picture(scene("crane"))).iter()
        if text.tag.endswith("text")
    ]
    assert len(found) == 4
    assert re.fullmatch(r"and \d+ more", found[3] or "")


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without curves, which take a second each."""
    monkeypatch.setattr(page, "_drawn", lambda *_: [])


@pytest.mark.usefixtures("no_figures")
def test_stored_proofs_are_told(tmp_path: Path) -> None:
    """And analyses of other models of the archive are not."""
    model = model_of("pendulum")
    path = tmp_path / "a.h5"
    found = mbdlft.worst_case_gain(model, "pivot.torque", "pivot.angle", work=2.0)
    mbdlft.save_analysis(path, model, found)
    other = mbdlft.as_system(model, name="other")
    mbdlft.save_analysis(path, other, replace(found, proof=None))
    html = model_report(mbdlft.load(path, "pendulum"), path).html
    signals = "from pivot.torque to pivot.angle"
    assert f"The gain {signals} is at most {found.upper:.6g} for all values" in html
    assert "was checked when this page was made" in html
    assert ">proved<" in html
    assert "Nothing is proved." not in html
    html = model_report(mbdlft.load(path, "other"), path).html
    assert "Nothing is proved." in html
    assert ">proved<" not in html


@pytest.mark.parametrize(
    ("kind", "words", "reached"),
    [
        ("robust stability", "stable for all values in 1.5 times the ranges", 2.5),
        ("robust performance", "the gain from u to y is at most 1/1.5 for all values in 1.5 times", 2.5),
        ("worst-case gain", "the gain from u to y is at most 2.5 for all values in the ranges", 1.5),
        ("largest real part", "no pole has a real part above 2.5 rad/s for all values", 1.5),
        ("smallest damping", "no pole is damped less than 1.5 for all values", 2.5),
        ("smallest disk margin", "the disk margin from u to y is at least 1.5 for all values", 2.5),
    ],
)
def test_a_claim_is_told_and_believed_by_no_report(kind: str, words: str, reached: float) -> None:
    bounds = Bounds(
        kind, 1.5, 2.5, {"m": 2.0}, {"m": 0.0}, 3.0, {}, 0.0,
        proof=BoxProof((0,)), inputs=("u",), outputs=("y",),
    )  # fmt: skip
    assert str(bounds.claim).startswith(words)
    assert bounds.reached == reached
    assert "m 0.5 per second" in str(replace(bounds, rates={"m": 0.5}).claim)
    named = {"inputs": ("pivot.torque",), "outputs": ("pivot.angle",)} if "from" in words else {}
    forged = replace(bounds, **{"inputs": (), "outputs": (), **named})
    (told,) = content.worst_cases([("a", model_of("pendulum"), forged)])
    assert not told.proved
    assert told.sentences[0] == "Nothing is proved."
    assert told.sentences[1].startswith("The proof that is stored is none: ")
    assert f"Reached: {reached:g}, at 3 rad/s" in told.sentences[2]


def test_models_with_little_to_tell() -> None:
    """No parameters, no states, no scene, no evidence."""
    gain = mbdlft.state_space([], [], [], [[2.0]], name="gain")
    html = model_report(gain).html
    for words in ("no parameters", "without evidence", "None is stored"):
        assert words in html
    assert "<h2>The scene</h2>" not in html
    assert "<h2>Poles" not in html


@pytest.mark.usefixtures("no_figures")
def test_texts_are_not_markup() -> None:
    evil = "<script>alert(1)</script>"
    model = model_of("pendulum")
    html = model_report(replace(model, description=evil)).html
    assert evil not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in html


@pytest.mark.parametrize("name", ["four_bar", "solar_arrays", "gimbal", "mast_observatory"])
def test_pictures_are_drawings(name: str) -> None:
    """Well-formed, finite, inside of their frame, with the names of the scene."""
    drawn = scene(name)
    root = ET.fromstring(scene_picture(drawn))
    left, top, wide, high = map(float, root.attrib["viewBox"].split())
    numbers = re.compile(r"-?[\d.]+")
    for line in root.iter("{http://www.w3.org/2000/svg}polyline"):
        xy = np.array(numbers.findall(line.attrib["points"]), dtype=float).reshape(-1, 2)
        assert np.all(xy > [left, top])
        assert np.all(xy < [left + wide, top + high])
    said = {text.text for text in root.iter("{http://www.w3.org/2000/svg}text")}
    names = {joint.name for joint in drawn.joints if joint.kind != "fixed"}
    assert names <= said


def test_a_film_shows_one_frame_at_a_time() -> None:
    """The first frame has the bodies of the picture; the others are those of displaced coordinates."""
    svg = "{http://www.w3.org/2000/svg}"
    pendulum, moves = scene("pendulum"), [np.zeros(1), np.array([0.4]), np.array([-0.4])]
    film = ET.fromstring(scene_film(pendulum, moves, 3.0, 0.5, 0.2))
    frames = film.findall(f"{svg}g")
    assert [frame.attrib["visibility"] for frame in frames] == ["visible", "hidden", "hidden"]
    begins = [float(frame.find(f"{svg}animate").attrib["begin"][:-1]) for frame in frames]
    assert begins == [-3.0, -2.0, -1.0]  # each begins to be seen as the one before it ends
    rods = [{line.attrib["points"] for line in frame.iter(f"{svg}polyline")} for frame in frames]
    still = ET.fromstring(scene_picture(pendulum, 0.5, 0.2))
    assert rods[0] <= {line.attrib["points"] for line in still.iter(f"{svg}polyline")}
    assert rods[0] != rods[1] != rods[2] != rods[0]


def test_an_axis_toward_the_eye_differs_from_one_away() -> None:
    """A wrong sign of an axis is seen: the arrow points the other way."""
    pendulum = scene("pendulum")
    (pivot,) = [joint for joint in pendulum.joints if joint.kind == "revolute"]
    other = pivot.model_copy(update={"axis": (-1.0, 0.0, 0.0)})
    turned = pendulum.model_copy(
        update={"joints": tuple(other if j is pivot else j for j in pendulum.joints)}
    )
    for azimuth in (0.0, 0.9):
        assert scene_picture(pendulum, azimuth, 0.0) != scene_picture(turned, azimuth, 0.0)


# The schema of scene files: whatever is read as a scene fits it, and slips do not.

SCENES = [
    path
    for path in sorted((ROOT / "scenarios").glob("*.toml"))
    if "mbdlft-scene" in path.read_text(encoding="utf-8")
]


@cache
def schema() -> Any:
    return fastjsonschema.compile(scene_schema())


@pytest.mark.parametrize("path", SCENES, ids=lambda path: str(path.stem))
def test_scenarios_fit(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    schema()(tomllib.loads(text))
    schema()(tomllib.loads(scene_to_toml(scene_from_toml(text))))


def test_what_is_read_fits() -> None:
    """Random trees with all kinds of joints, and scenes that were changed by chance."""
    for seed in range(12):
        schema()(tomllib.loads(scene_to_toml(open_tree(seed))))
    rng, given, read = np.random.default_rng(5), texts(), 0
    for _ in range(150):
        text = as_toml(restructured(tomllib.loads(given[int(rng.integers(len(given)))]), rng))
        try:
            scene_from_toml(text)
        except MbdlftError:
            continue
        read += 1
        schema()(tomllib.loads(text))
    assert read > 20


ARM: dict[str, Any] = tomllib.loads((ROOT / "scenarios" / "two_link_arm.toml").read_text("utf-8"))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("format",), "mbdlft-scene/2"),
        (("gravty",), [0, 0, 1]),
        (("gravity",), [0, 0]),
        (("gravity",), [0, 0, True]),
        (("joints", "shoulder", "axis"), ["x", 0, 1]),
        (("joints", "shoulder", "stifness"), 1.0),
        (("joints", "shoulder", "kind"), "hinge"),
        (("bodies", "link1", "inertia", "xz2"), 1.0),
        (("bodies", "link1", "mass"), [1.0]),
        (("parameters", "m1", "role"), "unknown"),
        (("parameters", "m1", "nominal"), "3"),
        (("linearize", "states"), "some"),
        *((place, None) for place in (("joints", "shoulder", "kind"), ("joints", "shoulder", "parent"))),
        (("name",), None),
    ],
)
def test_slips_do_not_fit(place: tuple[str, ...], value: object) -> None:
    """They are errors of the reader, too; None is a key that is missing."""
    table = json.loads(json.dumps(ARM))
    schema()(table)
    part = table
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    if value is None:
        del part[place[-1]]
    with pytest.raises(fastjsonschema.JsonSchemaValueException):
        schema()(table)
    with pytest.raises(MbdlftError):
        scene_from_toml(as_toml(table))


def test_the_command(tmp_path: Path, call: Call, output: Output) -> None:
    said = output("schema")
    assert json.loads(said) == json.loads(json.dumps(mbdlft.scene_schema()))
    file = tmp_path / "scene.schema.json"
    output("schema", "-o", str(file))
    assert file.read_text(encoding="utf-8") == said
    code, _, said = call("schema", "-o", str(tmp_path))
    assert (code, "cannot be written" in said) == (2, True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a^60", (1e-2, 1e3)),
        ("a^20", (1e-7, 1e-5)),
        *((text, ()) for text in ("a^5", "1/a-1/a^3", "a-2")),
    ],
)
def test_entries_that_fall_over_the_ranges_are_said(text: str, said: tuple[float, ...]) -> None:
    """And not those that vanish at a corner, or change their sign. The share depends on the processor."""
    model = mbdlft.realize([[text]], [mbdlft.Parameter("a", 3.0, 1.0, 5.0)], search=0.0)
    found = [sentence for sentence in sentences.checked_beside(model) if "fall" in sentence]
    assert len(found) == bool(said)
    for sentence in found:
        share = re.search(r"by (\S+) of itself at a = 1\.0", sentence)
        assert share is not None
        assert said[0] < float(share[1]) < said[1]
