"""The exception classes. The message of an error says where it is, what was expected, and what to try."""

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches

_LONGEST, _END = (2000, 400)  # bytes of a message, a page of a terminal, and of its end, with the advice
_LISTED, _COMPARED = 40, 1000  # names in a message; names compared, which takes 10 ms
_LETTERS = 100  # of a name: no name that somebody means is longer
_QUANTITIES = ("position", "rotation", "angle", "force", "torque")  # with components
_SAME = (  # words for one thing, of a translation and of a rotation
    ("position", "angle", "rotation", "displacement", "theta", "q"),
    ("velocity", "rate", "speed", "angular_velocity"),
    ("acceleration", "angular_acceleration"),
    ("force", "torque", "effort"),
    ("damping", "friction", "damper"),
    ("stiffness", "spring"),
    ("kind", "type"),
    ("revolute", "hinge", "pin", "continuous"),
    ("prismatic", "slider", "translational"),
    ("spherical", "ball"),
    ("universal", "cardan"),
    ("fixed", "weld"),
    ("free", "floating"),
    ("rigid", "body", "solid"),
)


class MbdlftError(Exception):
    """The base class of all errors that mbdlft raises on purpose. A message has at most 2 kB."""

    def __init__(self, *arguments: object) -> None:
        if len(arguments) == 1 and isinstance(arguments[0], str):
            arguments = (shortened(arguments[0]),)
        super().__init__(*arguments)


class SceneError(MbdlftError, ValueError):
    """The description of a scene or a matrix is inconsistent or incomplete."""


class StructureError(MbdlftError, ValueError):
    """Shapes, block sizes or names do not fit together."""


class SizeError(StructureError):
    """Numbers of a model are too large, or too small, for doubles or their squares."""


class NotRationalError(MbdlftError, ValueError):
    """An operation has no exact linear fractional form."""


class TrimError(MbdlftError, RuntimeError):
    """No equilibrium was found; the message gives the smallest residual."""


class WellPosednessError(MbdlftError, ValueError):
    """I - D_zw Delta is singular somewhere inside the parameter range."""


class AnalysisError(MbdlftError, RuntimeError):
    """A computation on a finished model stopped without an answer."""


class ArchiveError(MbdlftError, OSError):
    """A file, a version or an element of an archive is not as specified."""


@contextmanager
def naming(what: object, *kinds: type[MbdlftError]) -> Iterator[None]:
    """Errors from inside, all or of some kinds, begin once with what they are about, such as a file."""
    chosen = kinds or (MbdlftError,)
    try:
        yield
    except chosen as error:
        if str(error).startswith(f"{what}: "):
            raise
        raise type(error)(f"{what}: {error}") from None


class MbdlftWarning(UserWarning):
    """A result that is right for what it is, and easily used for what it is not."""


def shortened(text: str) -> str:
    """A text of at most 2 kB: of a longer one the middle of long words is left out, and of the whole."""
    data = text.encode("utf-8", "backslashreplace")
    if len(data) <= _LONGEST:
        return text
    half = _LETTERS // 2
    text = re.sub(rf"\S{{{_LETTERS + 20},}}", lambda word: f"{word[0][:half]}...{word[0][-half:]}", text)
    data = text.encode("utf-8", "backslashreplace")
    if len(data) <= _LONGEST:
        return text
    begin = data[: _LONGEST - _END - 60].decode("utf-8", "ignore")
    end = data[-_END:].decode("utf-8", "ignore")
    return f"{begin} ... ({len(data)} bytes, the middle is left out) ... {end}"


def _cut(name: str) -> str:
    return name if len(name) <= _LETTERS else f"{name[:_LETTERS]}..."


def _of_the_same_item(name: str, known: list[str]) -> list[str]:
    """The signal of the same item that was meant by a name ``ITEM.quantity.component``, if there is one.

    ``flight.x`` is the x of its position; ``road.rate``, of what slides, is its velocity.
    """
    item, *quantities = name.split(".")
    if not quantities:
        return [other for same in _SAME if name in same for other in same if other in known][:1]
    meant = [[quantity, *quantities] for quantity in _QUANTITIES]
    meant += [[other, *quantities[1:]] for same in _SAME if quantities[0] in same for other in same]
    return [same_signal for words in meant if (same_signal := ".".join((item, *words))) in known][:1]


def check_known(
    what: str,
    names: Iterable[str],
    existing: Collection[str],
    where: str = "",
    error: type[MbdlftError] = SceneError,
) -> None:
    """Raise an error of the class `error` for a name that does not exist; arguments as `unknown_name`."""
    for name in names:
        if name not in existing:
            raise error(f"{where}{where and ': '}{unknown_name(what, name, existing)}")


def misspelt(key: str, given: Iterable[str]) -> str:
    """A clause for messages on a key that is missing: which of the keys that are given it may be."""
    near = get_close_matches(key, [name for name in given if len(name) <= _LETTERS], n=1)
    return f", and {near[0]!r} is no key" if near else ""


def unknown_name(what: str, name: str, existing: Iterable[str]) -> str:
    """A sentence that a name is unknown, with the most similar existing name and all existing names.

    `what` says what the name should name, such as ``parameter``.
    """
    names = sorted(existing)
    nearest = [known for known in names if known.lower() == name.lower()]
    if len(name) <= _LETTERS:  # comparing takes as long as the product of the lengths
        compared = [known for known in names[:_COMPARED] if len(known) <= _LETTERS]
        nearest = nearest or _of_the_same_item(name, compared)
        near = get_close_matches(name, compared, n=1, cutoff=0.5)
        nearest = nearest or [known for known in near if len(name) > 1 or known[0] == name]
    hint = f" Did you mean {nearest[0]!r}?" if nearest else ""
    listed = [_cut(known) for known in names[:_LISTED]]
    if len(names) > _LISTED:
        listed.append(f"and {len(names) - _LISTED} more")
    return f"unknown {what} {_cut(name)!r}.{hint} Existing: {', '.join(listed) or 'none'}."
