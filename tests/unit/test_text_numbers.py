"""Decimal text to float64: the same double as `float`, for every token, or an error that says where."""

from __future__ import annotations

import random

import numpy as np
import pytest

from clbvh.geometry import text_numbers
from clbvh.geometry.text_numbers import NotANumberError, count_tokens_per_line, parse_numbers

SPECIAL = """
    .5 5. -.5 +3 +.25e+2 -0 -0.0 0 00012 0e0 1e22 1e23 1e-22 1e-23 9007199254740993 9007199254740992
    12345678 123456789 1234567890123456 12345678901234567 0.12345678901234567890 1.7976931348623157e308 5e-324
    1e400 1e-400 1e0000000000000000000005 nan NaN inf -inf Infinity 123456789.12345678 3.14159265358979 1E5 -2.5E-3
""".split()  # noqa: SIM905 - a list of quoted words would hide them


def make_token(rng: random.Random) -> str:
    """Make a number as mesh files have them."""
    value = rng.uniform(-1, 1) * 10 ** rng.randrange(-12, 12)
    formats = [
        f"{value:.9g}",
        f"{value:.{rng.randrange(18)}f}",
        f"{value:.{rng.randrange(18)}e}",
        repr(value),
        str(int(value)),
    ]
    return rng.choice(formats)


@pytest.mark.parametrize("seed", range(3))
def test_every_number_is_the_double_nearest_to_its_text(seed, monkeypatch):
    monkeypatch.setattr(text_numbers, "_CHUNK_BYTES", 5000)
    rng = random.Random(seed)
    tokens = [make_token(rng) for _ in range(20_000)] + SPECIAL
    rng.shuffle(tokens)
    text = "".join(token + rng.choice([" ", "\n", "\t", "  ", "\r\n"]) for token in tokens).encode()
    expected = np.array([float(token) for token in tokens])
    assert parse_numbers(text).tobytes() == expected.tobytes()  # bytes, so that -0.0 and nan count


@pytest.mark.parametrize("seed", range(2))
def test_texts_of_long_numbers_are_read_to_the_last_bit(seed):
    rng = random.Random(seed)
    values = [rng.uniform(-1, 1) * 10 ** rng.randrange(-3, 3) for _ in range(5000)]
    text = " ".join(map(repr, values)).encode()
    assert parse_numbers(text).tolist() == values
    with pytest.raises(NotANumberError, match="'1-2'"):
        parse_numbers(text + b" 1-2")


@pytest.mark.parametrize("text", [b"", b" ", b"\n\r\n \t"])
def test_no_numbers(text):
    assert parse_numbers(text).shape == (0,)


def test_one_number_needs_no_space():
    assert parse_numbers(b"12.5").tolist() == [12.5]


NOT_NUMBERS = """
    1.2.3 1e e5 --1 +-1 1-2 . - + -. 1e+ 1_0 abc 1,5 0x10 1e5.5 1e5e5 -e 1:2 1/2 12a4 \x7f \xe9 12345678a12345678
""".split()  # noqa: SIM905 - a list of quoted words would hide them


@pytest.mark.parametrize("token", NOT_NUMBERS)
def test_what_is_no_number_is_named(token):
    with pytest.raises(NotANumberError) as caught:
        parse_numbers(f"1 2\n{token} 4".encode("latin-1"))
    assert (caught.value.offset, caught.value.token_id) == (4, 2)


def test_an_error_in_a_later_chunk_counts_the_tokens_before_it(monkeypatch):
    monkeypatch.setattr(text_numbers, "_CHUNK_BYTES", 100)
    text = b"1.5 " * 1000 + b"oops " + b"2 " * 1000 + b"again"
    with pytest.raises(NotANumberError, match="'oops' at byte 4000") as caught:
        parse_numbers(text)
    assert caught.value.token_id == 1000


def test_a_text_without_spaces_is_refused_quickly(monkeypatch):
    monkeypatch.setattr(text_numbers, "_CHUNK_BYTES", 1000)
    with pytest.raises(NotANumberError):
        parse_numbers(b"1" * 5000 + b"x" * 2_000_000)


def test_tokens_per_line():
    text = b"1 2 3\n\n 4\t5 \r\n6 7"
    assert count_tokens_per_line(text).tolist() == [3, 0, 2, 2]
    assert count_tokens_per_line(text + b"\n").tolist() == [3, 0, 2, 2]
    assert count_tokens_per_line(b"").tolist() == []
