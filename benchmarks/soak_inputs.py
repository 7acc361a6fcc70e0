# SPDX-License-Identifier: Apache-2.0
"""Hostile inputs: examples with bytes, numbers and words changed, moved, doubled or cut."""

import random
import re
from collections.abc import Sequence

_WORDS = (
    *(b"nan", b"-inf", b"1e400", b"-0", b"0", b"-1", b"1e-320", b"1e300", b"18446744073709551616"),
    *(b"null", b"[]", b"{}", b"true", b"''", b"[[", b"&a *a", b"!!python/object", b"---", b"\xff"),
    *(b"\x00", b"\x1b[2J", b"\xe2\x80\xae", b"a" * 300, b"9" * 5000, b"\n", b"\t", b",", b":"),
)
_INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63, 2**64 - 1)
_TOKEN = re.compile(rb"[A-Za-z_0-9.+-]+")
_MOST = 1 << 20


def mutated(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """``data`` after one to four changes; now and then with parts of ``others``."""
    for _ in range(draw.choice((1, 1, 2, 4))):
        data = draw.choice(_CHANGES)(draw, data, others)[:_MOST]
    return data


def _flip(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at = _place(draw, data)
    return (
        data[:at] + bytes([(data[at] if data else 0) ^ (1 << draw.randrange(8))]) + data[at + 1 :]
    )


def _integer(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    size = draw.choice((1, 2, 4, 8))
    value = draw.choice(_INTEGERS) & ((1 << 8 * size) - 1)
    at = _place(draw, data) // size * size
    return data[:at] + value.to_bytes(size, draw.choice(("little", "big"))) + data[at + size :]


def _word(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    tokens = [*_TOKEN.finditer(data)] if len(data) < 10_000 else []
    if not tokens:
        at = _place(draw, data)
        return data[:at] + draw.choice(_WORDS) + data[at:]
    token = draw.choice(tokens)
    return data[: token.start()] + draw.choice(_WORDS) + data[token.end() :]


def _exchange(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    tokens = [*_TOKEN.finditer(data)] if len(data) < 10_000 else []
    if len(tokens) < 2:
        return data
    one, other = sorted(draw.sample(tokens, 2), key=lambda each: each.start())
    middle = data[one.end() : other.start()]
    return data[: one.start()] + other[0] + middle + one[0] + data[other.end() :]


def _cut(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at = _place(draw, data)
    return data[:at] + (b"" if draw.random() < 0.3 else data[at + draw.randrange(1, 40) :])


def _double(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at, size = _place(draw, data), draw.choice((1, 8, 60, 400))
    return data[:at] + data[at : at + size] * draw.choice((2, 3, 50)) + data[at + size :]


def _splice(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    other = draw.choice(others)
    return data[: _place(draw, data)] + other[_place(draw, other) :]


def _random(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at, size = _place(draw, data), draw.choice((1, 4, 16, 200))
    return data[:at] + draw.randbytes(size) + data[at + size :]


def _place(draw: random.Random, data: bytes) -> int:
    return draw.randrange(len(data)) if data else 0


_CHANGES = (_flip, _integer, _word, _exchange, _cut, _double, _splice, _random)
