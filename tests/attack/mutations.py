"""Changes of bytes and texts, drawn from a generator of random numbers."""

import re

import numpy as np

NUMBERS = (
    "0", "-1", "1e155", "1e-155", "1e300", "-1e300", "1e308", "nan", "inf", "1e400", "5e-324",
    "99999999999999999999", "0.1", "3.0", "-0.0", "true", '"x"', "[]", "{}", '"1e300*1e300"',
    '"1/0"', '"0*m"', '"m**64"', '"((1))"', '"sqrt(2)"', '"kg"', "''", "1_0", "0x10",
)  # fmt: skip
WORDS = ("ground", "rigid", "x", "", "\\u0000", "é", "日本", "a.b", "../x", "a" * 3000, "origin", "tip")


def check_message(error: Exception) -> None:
    """Raise an AssertionError unless the message of an error is of a length that can be read."""
    length = len(str(error).encode("utf-8", "replace"))
    assert 0 < length <= 2048, f"a message of {length} bytes"


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """Bytes with bits flipped, bytes replaced, blocks lost, repeated or exchanged, or the end cut."""
    found = bytearray(data)
    for _ in range(int(random.integers(1, 5))):
        if not found:
            break
        at, size = int(random.integers(len(found))), int(random.integers(1, 600))
        match random.integers(8):
            case 0 | 1 | 2:
                found[at] ^= 1 << int(random.integers(8))
            case 3:
                found[at] = int(random.integers(256))
            case 4:
                found[at : at + size] = bytes(len(found[at : at + size]))
            case 5:
                other = int(random.integers(len(found)))
                found[at : at + size] = found[other : other + size]
            case 6:
                found[at : at + size] = random.bytes(size)
            case _:
                if random.random() < 0.3:
                    del found[at:]
                else:
                    found[at : at + 8] = int(random.integers(2**62)).to_bytes(8, "little")
    return bytes(found)


def changed(text: str, random: np.random.Generator) -> str:
    """A text with a few numbers, words, lines or characters changed."""
    for _ in range(int(random.choice([1, 1, 1, 2, 3]))):
        lines = text.split("\n")
        row = int(random.integers(len(lines)))
        match random.integers(8):
            case 0 | 1 | 2:
                text = _one(text, r"(?<![\w.])-?\d+(\.\d+)?([eE][-+]?\d+)?", NUMBERS, random)
            case 3 | 4:
                text = _one(text, r"[A-Za-z_]\w*", (*WORDS, *re.findall(r"\w+", text)), random)
            case 5:
                del lines[row]
                text = "\n".join(lines)
            case 6:
                lines.insert(row, lines[int(random.integers(len(lines)))])
                text = "\n".join(lines)
            case _:
                at = int(random.integers(len(text) + 1))
                text = text[:at] + chr(int(random.integers(1, 300))) + text[at + 1 :]
        if not text:
            break
    return text


def _one(text: str, pattern: str, choices: tuple[str, ...], random: np.random.Generator) -> str:
    """The text with one place of a pattern replaced."""
    places = list(re.finditer(pattern, text))
    if not places:
        return text
    place = places[int(random.integers(len(places)))]
    new = choices[int(random.integers(len(choices)))]
    return text[: place.start()] + new + text[place.end() :]
