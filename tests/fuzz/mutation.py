"""Mutants of files: bits, lengths, cuts and splices as damage and ill will make them."""

import re
import struct
from collections.abc import Callable, Sequence

import numpy as np

_NUMBERS = (
    0,
    1,
    2,
    7,
    0x7F,
    0x80,
    0xFF,
    2**15,
    2**16 - 1,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**40,
    2**60,
    2**63 - 1,
    2**63,
)
_NUMBERS += (2**64 - 1,)
_FLOATS = (float("nan"), float("inf"), -1.0, 1e200, 1.7e308, -1e-320)
_WORDS = re.compile(rb"[A-Za-z0-9_.+-]+")
_TEXTS = (
    b"0x_",
    b"2001-99-99",
    b"9" * 5000,
    b"nan",
    b".inf",
    b"-1",
    b"1e400",
    b"null",
    b"[",
    b"{a: 1}",
    b"*a",
    b"&a",
)
_TEXTS += (
    b"<<",
    b"!!python/name:os.system",
    b"\0",
    b"\xff\xfe",
    b"[/red]",
    b"yes",
    b"'",
    b'"',
    b"",
    b"1:59:59",
    b"..",
)

Mutation = Callable[[bytearray, np.random.Generator, Sequence[bytes]], None]


def mutant(seeds: Sequence[bytes], rng: np.random.Generator) -> bytes:
    """Return one of the seeds with one to four mutations."""
    content = bytearray(seeds[rng.integers(len(seeds))])
    text = b"\0" not in content[:2000]
    for _ in range(rng.integers(1, 5)):
        kinds = _OF_TEXT if text and rng.random() < 0.7 else _OF_BYTES
        kinds[rng.integers(len(kinds))](content, rng, seeds)
    return bytes(content)


def _place(content: bytearray, rng: np.random.Generator) -> int:
    # Heads and ends of files hold what the rest depends on.
    near = int(rng.integers(1, 400))
    choice = rng.random()
    if choice < 0.2:
        return min(near, len(content))
    return max(len(content) - near, 0) if choice < 0.3 else int(rng.integers(len(content) + 1))


def _flip(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    if content:
        content[_place(content, rng) % len(content)] ^= 1 << int(rng.integers(8))


def _number(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    width = int(rng.choice([1, 2, 4, 8]))
    value = _NUMBERS[rng.integers(len(_NUMBERS))] % (1 << 8 * width)
    at = _place(content, rng)
    content[at : at + width] = value.to_bytes(width, "little")


def _float(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    at = _place(content, rng)
    content[at : at + 8] = struct.pack("<d", _FLOATS[rng.integers(len(_FLOATS))])


def _cut(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    del content[_place(content, rng) :]


def _delete(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    at = _place(content, rng)
    del content[at : at + int(rng.integers(1, 200))]


def _repeat(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    at = _place(content, rng)
    content[at:at] = content[at : at + int(rng.integers(1, 400))] * int(rng.integers(1, 6))


def _splice(content: bytearray, rng: np.random.Generator, seeds: Sequence[bytes]) -> None:
    other = seeds[rng.integers(len(seeds))]
    begin = int(rng.integers(len(other) + 1))
    at = _place(content, rng)
    content[at : at + 100] = other[begin : begin + int(rng.integers(1, 1000))]


def _noise(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    at = _place(content, rng)
    content[at : at + 16] = rng.bytes(int(rng.integers(1, 17)))


def _word(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    words = list(_WORDS.finditer(bytes(content)))
    if words:
        found = words[rng.integers(len(words))]
        content[found.start() : found.end()] = _TEXTS[rng.integers(len(_TEXTS))]


def _swap(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    words = list(_WORDS.finditer(bytes(content)))
    if words:
        one, other = (words[rng.integers(len(words))] for _ in range(2))
        content[one.start() : one.end()] = other[0]


def _line(content: bytearray, rng: np.random.Generator, _: Sequence[bytes]) -> None:
    lines = bytes(content).split(b"\n")
    at = int(rng.integers(len(lines)))
    lines[at : at + 1] = [] if rng.random() < 0.5 else [lines[rng.integers(len(lines))]] * 2
    content[:] = b"\n".join(lines)


_OF_BYTES: tuple[Mutation, ...] = (
    _flip,
    _number,
    _number,
    _float,
    _cut,
    _delete,
    _repeat,
    _splice,
    _noise,
)
_OF_TEXT: tuple[Mutation, ...] = (_word, _word, _swap, _line, _line, _delete, _repeat, _splice)
