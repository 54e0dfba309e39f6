"""The exception classes. The message of an error says where it is, what was expected, and what to try."""

from collections.abc import Iterable
from difflib import get_close_matches


class MbdlftError(Exception):
    """The base class of all errors that mbdlft raises on purpose."""


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


def unknown_name(what: str, name: str, existing: Iterable[str]) -> str:
    """A sentence that a name is unknown, with the most similar existing name and all existing names.

    `what` says what the name should name, such as ``parameter``.
    """
    names = sorted(existing)
    nearest = [known for known in names if known.lower() == name.lower()]
    nearest = nearest or get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f" Did you mean {nearest[0]!r}?" if nearest else ""
    return f"unknown {what} {name!r}.{hint} Existing: {', '.join(names) or 'none'}."
