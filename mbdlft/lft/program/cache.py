"""A folder of native code and of programs, by content: the text it was made from, and the processor.

Native code is run as it is read, so a folder or a file that others may write to is not used. Each file
begins with the digest of its key and its code, and is written beside its place and then moved there:
writers do not disturb each other, and what is damaged is compiled again.
"""

import hashlib
import os
import stat
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

_DIGEST = 32
_FOLDER = "MBDLFT_CACHE"  # environment variable; empty for no cache


@dataclass(frozen=True, slots=True)
class Cache:
    """A folder of native code."""

    folder: Path

    def get(self, key: str, kind: str = "o") -> bytes | None:
        """The code of a key; None if it is not there, is damaged, or others may have written it."""
        path = self._path(key, kind)
        try:
            if not (_is_private(self.folder) and _is_private(path)):
                return None
            found = path.read_bytes()
        except OSError:
            return None
        code = found[_DIGEST:]
        return code if code and found[:_DIGEST] == _digest(key, code) else None

    def put(self, key: str, code: bytes, kind: str = "o") -> bool:
        """Keep code; whether that was possible."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if not _is_private(self.folder):
                return False
            handle, name = tempfile.mkstemp(dir=self.folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(_digest(key, code) + code)
                Path(name).replace(self._path(key, kind))
            except BaseException:
                Path(name).unlink(missing_ok=True)
                raise
        except OSError:
            return False
        return True

    def _path(self, key: str, kind: str) -> Path:
        return self.folder / f"{key}.{kind}"


def user_cache() -> Cache | None:
    """The folder of this user: `MBDLFT_CACHE`, or the one for such files; None if that is empty."""
    chosen = os.environ.get(_FOLDER)
    if chosen is not None:
        return Cache(Path(chosen).expanduser()) if chosen else None
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return Cache(base / "mbdlft")


def key_of(*parts: str) -> str:
    """The key of a text and of what it is compiled for."""
    found = hashlib.sha256()
    for part in parts:
        found.update(f"{len(part)}:".encode() + part.encode())
    return found.hexdigest()


def _digest(key: str, code: bytes) -> bytes:
    return hashlib.sha256(key.encode() + code).digest()


def _is_private(path: Path) -> bool:
    """Whether a file or folder is this user's, and nobody else may write to it."""
    if not hasattr(os, "getuid"):  # Windows: its folders of users are private
        return True
    found = path.stat(follow_symlinks=False)
    kind = stat.S_ISDIR(found.st_mode) or stat.S_ISREG(found.st_mode)
    return kind and found.st_uid == os.getuid() and not found.st_mode & 0o022
