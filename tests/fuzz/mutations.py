"""How a good file becomes a hostile one: hypothesis strategies over its bytes, lines and words.

Bytes are flipped, cut, moved, or replaced by numbers that sizes should not be; text has its words
and lines replaced. What has to be sound around the harm is in `recipes`.
"""

import re
from collections.abc import Callable

from hypothesis import strategies as st

SIZES = (0, 1, 2, 127, 128, 255, 256, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 10**13)
WORDS = (
    b"nan", b"inf", b"-inf", b"1e309", b"1e39", b"1e300", b"5e-324", b"-1", b"0", b"9" * 5000,
    b"10000000000000", b"\xc2\xb2", b"\xd9\xa3", b"1_0", b"0x10", b"", b"\x00", b"\xff\xfe",
    b"null", b"true", b"[]", b"{}", b'"', b"[" * 2000, b"../" * 9 + b"etc/passwd", b"\\ud800",
    "\u202e\u00e9\U0001f600".encode(), b"%s%n", b"<!---->", b"&x;", b"*x",
    b"!!python/name:os.system",
)  # fmt: skip
TEXT = (".json", ".yaml", ".toml", ".txt", ".bvh")


@st.composite
def hostile(draw: st.DrawFn, content: bytes, suffix: str) -> bytes:
    """A damaged or malicious version of a file's content."""
    families: list[Callable[[st.DrawFn, bytes], bytes]] = [_noise, _cut, _flip, _splice, _resize]
    if suffix in TEXT:
        families += [_word, _word, _lines]
    return draw(st.sampled_from(families))(draw, content)


# --- bytes --------------------------------------------------------------------------------------


def _place(draw: st.DrawFn, content: bytes) -> int:
    """Somewhere, and as often as not in the first bytes, where most formats keep their sizes."""
    last = max(len(content) - 1, 0)
    return draw(st.one_of(st.integers(0, last), st.integers(0, min(last, 64))))


def _noise(draw: st.DrawFn, content: bytes) -> bytes:
    kept = draw(st.sampled_from((0, 2, 4, 8, 16, 64)))
    return content[:kept] + draw(st.binary(max_size=100))


def _cut(draw: st.DrawFn, content: bytes) -> bytes:
    return content[: _place(draw, content)]


def _flip(draw: st.DrawFn, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 8))):
        if changed:
            changed[_place(draw, content)] ^= 1 << draw(st.integers(0, 7))
    return bytes(changed)


def _splice(draw: st.DrawFn, content: bytes) -> bytes:
    first, second, to = sorted(_place(draw, content) for _ in range(3))
    piece = content[first:second] * draw(st.sampled_from((0, 1, 2, 20)))
    return draw(st.sampled_from((content[:to] + piece + content[to:], piece + content[second:])))


def _resize(draw: st.DrawFn, content: bytes) -> bytes:
    """A number of 1 to 8 bytes becomes one that a size may not be."""
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 2))):
        place, width = _place(draw, content), draw(st.sampled_from((1, 2, 4, 8)))
        size = draw(st.sampled_from(SIZES)) % 2 ** (8 * width)
        changed[place : place + width] = size.to_bytes(
            width, draw(st.sampled_from(("big", "little")))
        )
    return bytes(changed)


# --- text ---------------------------------------------------------------------------------------


def _word(draw: st.DrawFn, content: bytes) -> bytes:
    for _ in range(draw(st.integers(1, 3))):
        words = list(re.finditer(rb"[\w.+-]+", content))
        if not words:
            break
        word = draw(st.sampled_from(words))
        new = draw(st.sampled_from((*WORDS, draw(st.sampled_from(words))[0])))
        content = content[: word.start()] + new + content[word.end() :]
    return content


def _lines(draw: st.DrawFn, content: bytes) -> bytes:
    lines = content.splitlines(keepends=True)
    for _ in range(draw(st.integers(1, 3))):
        if not lines:
            break
        at, to = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        action = draw(st.sampled_from(("drop", "repeat", "swap")))
        if action == "drop":
            del lines[at]
        elif action == "repeat":
            lines[at:at] = [lines[to]] * draw(st.sampled_from((1, 2, 50)))
        else:
            lines[at], lines[to] = lines[to], lines[at]
    return b"".join(lines)
