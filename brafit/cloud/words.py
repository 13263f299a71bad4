"""Splits a whole text into words at once: where each begins and ends, which begin a line, and the numbers they spell.

Words are parted by white space, lines by LF, CR or both.
"""

from __future__ import annotations

import codecs
import re
from functools import cached_property
from typing import SupportsIndex

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float, Int

from brafit.cloud.refusal import RefusedError

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_JOINED = b"\x0b"
"""Stands for the end of a line that goes on in the next: white space, and still counted in line numbers."""
_NOT_A_NUMBER = re.compile(r"[-+]?1\.#\w+")
"""How programs on Windows write what is not a number: 1.#QNAN, -1.#IND."""


def in_utf8(data: bytes) -> bytes:
    """A text in UTF-8 without a mark of order, where it is in UTF-16 (as Windows PowerShell writes) or has a mark."""
    if data.startswith(_UTF16):
        data = data.decode("utf-16", errors="replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def plain_lines(data: bytes, comment: bytes = b"", joining: bytes = b"") -> bytes:
    """Text with LF at the ends of its lines, without comments; lines that end with `joining` joined to the next.

    Raises:
        ValueError: it is no text.
    """
    data = in_utf8(data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if comment and comment in data:
        first, *rest = data.split(comment)
        data = first + b"".join(part[part.find(b"\n") :] for part in rest if b"\n" in part)
    if joining and joining in data:
        data = re.sub(re.escape(joining) + rb"[ \t]*\n", b" " + _JOINED, data)
    return data


_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d*(?:[eE][-+]?\d+)?")


class Words:
    """The words of a text.

    Args:
        text: as `plain_lines` gives it.
        before: lines of the file that come before the text, for messages.

    Attributes:
        starts, ends: where the words begin and end, bytes from the text's beginning.
    """

    def __init__(self, text: bytes, before: int = 0):
        self.text, self._before = text, before
        self._bytes = np.frombuffer(text, dtype=np.uint8)
        # Every eight bytes in a row, as one number.
        self._eights = np.ndarray(len(text) + 1, dtype="<u8", buffer=text + bytes(8), strides=(1,))
        inside = np.zeros(len(text) + 2, dtype=bool)
        np.greater(self._bytes, ord(" "), out=inside[1:-1])
        edges = np.flatnonzero(inside[1:] != inside[:-1])
        self.starts, self.ends = edges[::2], edges[1::2]

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, word: SupportsIndex) -> str:
        return self.text[self.starts[word] : self.ends[word]].decode(errors="replace")

    @cached_property
    def heads(self) -> Int[np.ndarray, " lines"]:
        """The first word of each line that has words."""
        after = np.searchsorted(self.starts, np.flatnonzero(self._bytes == ord("\n")))
        heads = np.concatenate([[0], after[after < len(self)]])
        return heads[np.diff(heads, prepend=-1) > 0][: len(self)]

    @cached_property
    def lengths(self) -> Int[np.ndarray, " lines"]:
        """How many words each of these lines has."""
        return np.diff(self.heads, append=len(self))

    def line(self, word: SupportsIndex) -> int:
        """The number in its file of the line that holds a word."""
        start = int(self.starts[word])
        return 1 + self._before + sum(self.text.count(end, 0, start) for end in (b"\n", _JOINED))

    def are(self, which: Int[np.ndarray, "*shape"], word: bytes) -> np.ndarray:
        """Which of some words are `word`, of at most eight bytes."""
        starts, bits = self.starts[which], 8 * len(word)
        found = self._eights[starts] & np.uint64((1 << bits) - 1)
        return (self.ends[which] - starts == len(word)) & (found == int.from_bytes(word, "little"))

    def numbers(self, which: Int[np.ndarray, "*shape"] | None = None) -> Float[np.ndarray, "*shape"]:
        """The numbers that some words are; all of them if `which`, which must rise, is None.

        Raises:
            ValueError: a word is no number; a `RefusedError` if it is one with a decimal comma.
        """
        which = np.arange(len(self)) if which is None else which
        try:
            values = pc.cast(self._strings(which, self.ends[which]), pa.float64())
        except pa.ArrowInvalid:
            return np.array([self._number(word) for word in which.ravel().tolist()]).reshape(which.shape)
        return values.to_numpy().reshape(which.shape)

    def whole_numbers(self, which: Int[np.ndarray, "*shape"], until: bytes = b"") -> Int[np.ndarray, "*shape"]:
        """The whole numbers that some words are; with `until`, that they are up to this byte, if they have it.

        Raises:
            ValueError: a word is, or begins with, no whole number.
        """
        ends = self.ends[which]
        if until:
            marks = np.append(np.flatnonzero(self._bytes == ord(until)), len(self.text))
            ends = np.minimum(ends, marks[np.searchsorted(marks, self.starts[which])])
        strings = self._strings(which, ends)
        try:
            values = pc.cast(strings, pa.int64())
        except pa.ArrowInvalid:
            parts = zip(which.ravel().tolist(), strings.to_pylist(), strict=True)
            return np.array([self._whole(word, part) for word, part in parts]).reshape(which.shape)
        return values.to_numpy().reshape(which.shape)

    def _strings(self, which: np.ndarray, ends: np.ndarray) -> pa.Array:
        """Pieces of the text, by reference: every second piece between the places where these begin and end."""
        if not which.size:
            return pa.array([], pa.large_string())
        bounds = np.stack([self.starts[which].ravel(), ends.ravel()], axis=1).ravel()
        pieces = pa.LargeStringArray.from_buffers(len(bounds) - 1, pa.py_buffer(bounds), pa.py_buffer(self.text))
        return pieces.take(pa.array(np.arange(0, len(bounds), 2)))

    def _number(self, word: int) -> float:
        text = self[word]
        if _NOT_A_NUMBER.fullmatch(text):
            return np.nan
        if _DECIMAL_COMMA.fullmatch(text):
            cause = f"line {self.line(word)}: {text[:40]!r} has a decimal comma, which this format does not know"
            raise RefusedError(cause, "Export it with decimal points")
        try:
            return float("_" if "_" in text else text)
        except ValueError:
            raise ValueError(f"line {self.line(word)}: {text[:40]!r} is no number") from None

    def _whole(self, word: int, text: str) -> int:
        if not re.fullmatch(r"[-+]?[0-9]{1,18}", text):
            raise ValueError(f"line {self.line(word)}: {self[word][:40]!r} is no whole number")
        return int(text)
