"""Rows of a PLY's elements, ASCII or binary: numbers and lists of numbers, of any lengths."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int

from brafit.cloud.words import Words, plain_lines

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
"""PLY's types as NumPy's."""


@dataclass(frozen=True)
class Property:
    """A property of an element: its type as NumPy's, and that of its count if it is a list."""

    name: str
    kind: str
    counted: str | None = None


@dataclass
class Element:
    """What the header says of an element."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def names(self, listed: bool) -> list[str]:
        """Of its properties that are lists, or that are not."""
        return [each.name for each in self.properties if (each.counted is not None) == listed]


class Bytes:
    """The data of a binary PLY; places in it are counted in bytes."""

    unit = "bytes"

    def __init__(self, data: bytes, order: str):
        self._data, self._order = data, order
        self._array = np.frombuffer(data, dtype=np.uint8)

    def __len__(self) -> int:
        return len(self._data)

    def width(self, kind: str) -> int:
        return int(kind[1])

    def counter(self, kind: str) -> Callable[[int], int]:
        """A function that reads the number at a place."""
        read = struct.Struct(self._order + np.dtype(kind).char).unpack_from

        def count(at: int) -> int:
            (value,) = read(self._data, at)  # a place beyond the end is a struct.error
            if value < 0:
                raise ValueError(f"it has a list of {value} numbers")
            return value

        return count

    def rows(self, kind: str, start: int, stride: int, shape: tuple[int, int]) -> np.ndarray:
        """Rows of numbers, one after the other, that begin at `start` and every `stride`."""
        dtype = np.dtype(self._order + kind)
        if not all(shape):
            return np.empty(shape, dtype)
        return np.ndarray(shape, dtype, self._data, start, (stride, dtype.itemsize))

    def at(self, kind: str, places: Int[np.ndarray, " n"]) -> np.ndarray:
        width = self.width(kind)
        return self._array[places[:, None] + np.arange(width)].view(self._order + kind)[:, 0]

    def left(self, end: int) -> bool:
        """Whether anything but blanks and zeros follows."""
        return bool(self._data[end:].strip(b"\0 \t\r\n"))


class Numbers:
    """The data of an ASCII PLY; places in it are counted in numbers."""

    unit = "numbers"

    def __init__(self, data: bytes, before: int):
        self._words = Words(plain_lines(data), before)
        self._values = self._words.numbers()
        self._view = self._values.data  # whose single numbers come faster than the array's

    def __len__(self) -> int:
        return len(self._values)

    def width(self, kind: str) -> int:
        return 1

    def counter(self, kind: str) -> Callable[[int], int]:
        def count(at: int) -> int:
            value = self._view[at]  # a place beyond the end is an IndexError
            if not 0 <= value <= len(self) or value % 1:
                raise ValueError(f"line {self._words.line(at)}: {self._words[at][:40]!r} stands where a count should")
            return int(value)

        return count

    def rows(self, kind: str, start: int, stride: int, shape: tuple[int, int]) -> np.ndarray:
        if not all(shape):
            return np.empty(shape)
        return np.lib.stride_tricks.as_strided(self._values[start:], shape, (8 * stride, 8), writeable=False)

    def at(self, kind: str, places: Int[np.ndarray, " n"]) -> np.ndarray:
        return self._values[places]

    def left(self, end: int) -> bool:
        return end < len(self)


Body = Bytes | Numbers


@dataclass(frozen=True)
class Table:
    """The rows of an element.

    Attributes:
        end: where they end in the body.
        stride: length of a row, if all are alike; None: they are not.
        places: where the numbers of each property begin: in the first row if all are alike, otherwise row by row.
        sizes: how many numbers each property has; likewise.
    """

    element: Element
    body: Body
    end: int
    stride: int | None
    places: list[list[int]]
    sizes: list[list[int]]

    def scalars(self, name: str) -> np.ndarray:
        """A property that is no list, row by row."""
        return self.lists(name)[0]

    def lists(self, name: str) -> tuple[np.ndarray, Int[np.ndarray, " rows"]]:
        """The numbers of a property, one row's after another's, and how many each row has."""
        count = self.element.count
        k = next(place for place, each in enumerate(self.element.properties) if each.name == name)
        kind = self.element.properties[k].kind
        if not count:
            return np.empty(0), np.empty(0, dtype=np.int64)
        if self.stride is not None:
            size = self.sizes[k][0]
            return self.body.rows(kind, self.places[k][0], self.stride, (count, size)).ravel(), np.full(count, size)
        sizes, width = np.array(self.sizes[k]), self.body.width(kind)
        first = np.array(self.places[k]) - width * (np.cumsum(sizes) - sizes)
        return self.body.at(kind, np.repeat(first, sizes) + width * np.arange(sizes.sum())), sizes


def read_tables(elements: list[Element], body: Body) -> dict[str, Table]:
    """The rows of all elements, by name.

    Raises:
        ValueError: with a short reason, if the body holds more or less than they need.
    """
    least = 0
    for element in elements:
        least += element.count * sum(body.width(each.counted or each.kind) for each in element.properties)
    if len(body) < least:
        raise ValueError(f"its header promises {least} {body.unit} or more, {len(body)} follow")
    tables, at = {}, 0
    for element in elements:
        tables[element.name] = _table(element, body, at)
        at = tables[element.name].end
    if body.left(at):
        cause = "its rows are not as the header says"
        raise ValueError(f"its header promises {at} {body.unit}, {len(body)} follow: {cause}")
    return tables


def _table(element: Element, body: Body, start: int) -> Table:
    """The rows of an element: alike, where lists are all as long as in the first row, or else one by one."""
    first = min(element.count, 1 if element.properties else 0)
    places, sizes, end = _walk(element, body, start, first)
    stride = end - start
    if start + stride * element.count <= len(body) and _alike(element, body, stride, places, sizes):
        return Table(element, body, start + stride * element.count, stride, places, sizes)
    places, sizes, end = _walk(element, body, start, element.count)
    return Table(element, body, end, None, places, sizes)


def _alike(element: Element, body: Body, stride: int, places: list[list[int]], sizes: list[list[int]]) -> bool:
    for each, place, size in zip(element.properties, places, sizes, strict=True):
        if each.counted is not None and place:
            counts = body.rows(each.counted, place[0] - body.width(each.counted), stride, (element.count, 1))
            if (counts != size[0]).any():
                return False
    return True


def _walk(element: Element, body: Body, at: int, rows: int) -> tuple[list[list[int]], list[list[int]], int]:
    """Where the numbers of each property begin and how many there are, row by row, and where the last row ends."""
    places: list[list[int]] = [[] for _ in element.properties]
    sizes: list[list[int]] = [[] for _ in element.properties]
    steps = [
        (body.counter(counted) if counted else None, body.width(counted or kind), body.width(kind))
        for counted, kind in ((each.counted, each.kind) for each in element.properties)
    ]
    for row in range(rows):
        try:
            for (count, head, width), place, size in zip(steps, places, sizes, strict=True):
                number = 1
                if count is not None:
                    number = count(at)
                    at += head
                place.append(at)
                size.append(number)
                at += number * width
        except (struct.error, IndexError):
            at = len(body) + 1
        if at > len(body):
            raise ValueError(f"its header promises {element.count} of {element.name}, it ends within number {row + 1}")
    return places, sizes, at
