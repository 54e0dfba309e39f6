"""The exception classes. The message of an error says where it is, what was expected, and what to try."""

import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches

_LONGEST, _END = 2000, 400  # bytes of a message, and of its end, where the advice is
_LISTED, _COMPARED, _LETTERS = 40, 1000, 100  # names listed, compared; their letters


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


class MbdlftWarning(UserWarning):
    """A result that is right for what it is, and easily used for what it is not."""


def shortened(text: str) -> str:
    """A text of at most 2 kB: of a longer one the middle of long words is left out, and of the whole."""
    data = text.encode("utf-8", "backslashreplace")
    if len(data) <= _LONGEST:
        return text
    text = re.sub(rf"\S{{{_LETTERS + 20},}}", lambda word: _middle_out(word[0]), text)
    data = text.encode("utf-8", "backslashreplace")
    if len(data) <= _LONGEST:
        return text
    begin = data[: _LONGEST - _END - 60].decode("utf-8", "ignore")
    end = data[-_END:].decode("utf-8", "ignore")
    return f"{begin} ... ({len(data)} bytes, the middle is left out) ... {end}"


def _middle_out(word: str) -> str:
    return f"{word[: _LETTERS // 2]}...{word[-_LETTERS // 2 :]}"


def _cut(name: str) -> str:
    return name if len(name) <= _LETTERS else f"{name[:_LETTERS]}..."


def check_known(
    what: str,
    given: Iterable[str],
    existing: Collection[str],
    where: str,
    error: type[MbdlftError] = SceneError,
) -> None:
    """Raise an error of the class `error` for a name that does not exist; arguments as `unknown_name`."""
    for name in given:
        if name not in existing:
            raise error(f"{where}: {unknown_name(what, name, existing)}")


def unknown_name(what: str, name: str, existing: Iterable[str]) -> str:
    """A sentence that a name is unknown, with the most similar existing name and all existing names.

    `what` says what the name should name, such as ``parameter``.
    """
    names = sorted(existing)
    nearest = [known for known in names if known.lower() == name.lower()]
    if (
        not nearest and len(name) <= _LETTERS
    ):  # comparing takes as long as the product of the lengths
        compared = [known for known in names[:_COMPARED] if len(known) <= _LETTERS]
        nearest = get_close_matches(name, compared, n=1, cutoff=0.5)
    hint = f" Did you mean {nearest[0]!r}?" if nearest else ""
    listed = [_cut(known) for known in names[:_LISTED]]
    if len(names) > _LISTED:
        listed.append(f"and {len(names) - _LISTED} more")
    return f"unknown {what} {_cut(name)!r}.{hint} Existing: {', '.join(listed) or 'none'}."
