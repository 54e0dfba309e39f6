"""A scene to be looked at: a web page.

The page is one file with its own data and scripts, and the library that draws in space: three.js, out of
the bundle of the package k3d, which is read when a page is written.
"""

import html
import importlib.metadata
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from mbdlft.archive.archive import put, target_of
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import ArchiveError, MbdlftError, SceneError
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.scene.toml import scene_from_toml
from mbdlft.show.viewer.data import other_poles, placed_at, view_data
from mbdlft.system.model import LFTModel, System

_FOLDER = Path(__file__).parent / "assets"
_SCRIPTS = (
    "interpret.js", "numbers.js", "controls.js", "labels.js", "shapes.js", "world.js", "tools.js",
    "linear.js", "plots.js", "main.js",
)  # fmt: skip
_PACKAGE, _BUNDLE = "k3d", "k3d/static/standalone.js"
# its modules stand between `var e={` and the functions that load them, the first of which it asks for
_WHOLE = re.compile(r"(.*?\bvar \w={)(.*)(};const \w={};function (\w)\(.*\b\4\()\d+(\).*)", re.DOTALL)
_MODULE = re.compile(r"(?:^|,)(?=(\d+)\([\w,]*\){)")
_NEEDED = re.compile(r"\b\w\((\d+)\)")
_THREE = "WebGLRenderer:()=>"  # in its module this name is given to the others
_HEIGHT = 640  # of the page in a notebook


@dataclass(frozen=True, slots=True, repr=False)
class Page:
    """A web page; a notebook shows it, and `save` writes it.

    Attributes
    ----------
    name : of the scene
    html : the whole page, without anything that it would load
    """

    name: str
    html: str

    def save(self, path: str | Path) -> Path:
        """Write the page to the file `path`, whole or not at all; a SceneError if that fails."""
        file = target_of(Path(path))
        try:
            put({file: self.html.encode("utf-8")})
        except ArchiveError as error:
            raise SceneError(str(error)) from None
        return file

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{html.escape(self.html)}" width="100%" height="{_HEIGHT}" '
            'style="border:0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"Page({self.name!r}, {len(self.html) / 1e6:.1f} MB)"


@arguments_checked
def view(
    scene: Scene,
    values: Mapping[str, float] | None = None,
    *,
    robot: str | Path | None = None,
    model: str | None = None,
    over: Scene | System | None = None,
    places: Mapping[str, Mapping[str, float]] | None = None,
    response: str | None = None,
) -> Page:
    """The page that shows a scene: bodies, joints, loads, sensors; with sliders, and modes that move.

    Parameters
    ----------
    scene : Scene
    values : mapping of names to numbers, optional
        Values of parameters at which the page begins, in their units; the others are nominal. The modes
        there are exact.
    robot : file, optional
        The URDF, SDF or MJCF file that the scene is of: shapes and meshes of its links are shown, too.
    model : str, optional
        Which model of an SDF file that has several.
    over : Scene or System, optional
        What this one is compared with: its poles at nominal stay beside those of the sliders.
    places : mapping of titles to values by name, optional
        Buttons that lead the sliders to these values, also beyond the ranges: worst cases of margins.
    response : "step", optional
        What the page plays when it is opened.

    Returns
    -------
    Page
        It is shown by a notebook; ``view(scene).save("scene.html")`` writes a file.
    """
    if response not in (None, "step"):
        raise SceneError(f"view, response: expected 'step', got {response!r}.")
    library, version = _library()
    data = view_data(scene, values, robot, model)
    data |= {"response": response, "others": [] if over is None else [other_poles(over)]}
    data["places"] = [placed_at(scene, title, each) for title, each in (places or {}).items()]
    return Page(scene.name, _filled(data, library, version))


def _filled(data: Mapping[str, Any], library: str, version: str) -> str:
    """The page with its data; what a scene says is text and never markup."""
    from markupsafe import Markup

    try:
        text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    except ValueError:
        raise SceneError(
            f"view: scene {data['name']!r}: a number of the page is not finite; masses, lengths or "
            "stiffnesses are of very different size."
        ) from None
    for letter in "<>&":  # no text of a scene can end the element
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return rendered(
        _FOLDER / "page.html",
        _FOLDER / "style.css",
        data=data,
        data_text=Markup(text),
        scripts=[Markup((_FOLDER / name).read_text(encoding="utf-8")) for name in _SCRIPTS],
        library=Markup(library),
        library_version=version,
    )


def rendered(template: Path, style: Path, **entries: Any) -> str:
    """A page of a template and a style, with its entries; what a user has written is never markup."""
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template.parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template.name).render(
        style=Markup(style.read_text(encoding="utf-8")),
        version=importlib.metadata.version("mbdlft"),
        **entries,
    )


@cache
def _library() -> tuple[str, str]:
    """The script of the library, and the version of the package that has it."""
    try:
        package = importlib.metadata.distribution(_PACKAGE)
        text = Path(str(package.locate_file(_BUNDLE))).read_text(encoding="utf-8")
    except (importlib.metadata.PackageNotFoundError, OSError):
        raise SceneError(
            f"view: the package {_PACKAGE!r}, which has the library that draws in space, is not "
            "installed or has no " + _BUNDLE + ". pip install 'mbdlft[viewer]'."
        ) from None
    return three_of(text).replace("</script", "<\\/script"), package.version


def three_of(bundle: str) -> str:
    """The modules of three.js out of a bundle, a third of it; all of a bundle of another form."""
    bundled = _WHOLE.fullmatch(bundle)
    modules = _MODULE.split(bundled[2])[1:] if bundled else []
    texts = dict(zip(modules[::2], modules[1::2], strict=True))
    three = [key for key, text in texts.items() if _THREE in text]
    if not bundled or len(three) != 1:
        return bundle
    kept, needed = {}, three.copy()
    while needed:
        key = needed.pop()
        if key in texts and key not in kept:
            kept[key] = texts[key]
            needed += _NEEDED.findall(texts[key])
    return f"{bundled[1]}{','.join(kept.values())}{bundled[3]}{three[0]}{bundled[5]}"


@arguments_checked
def scene_of(model: System) -> Scene:
    """The scene that a model was made of, from the text in its provenance."""
    try:
        return scene_from_toml(model.provenance.scene if isinstance(model, LFTModel) else "")
    except MbdlftError as error:
        raise SceneError(
            f"view: the model {model.name!r} was not made of one scene alone, so there is nothing to "
            f"be seen: {error}"
        ) from None
