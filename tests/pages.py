"""The pages of the documentation, taken apart: fenced blocks, the commands in them, links and headings."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "examples" / "README.md"]
_FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(?<!\\)\[[^\]]*\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Block:
    """What stands between two fences: its language, as the page has it, and the line of the page where it begins."""

    page: Path
    line: int
    language: str
    text: str


@dataclass(frozen=True)
class Command:
    """A command as a page shows it, without its comment."""

    page: Path
    line: int
    text: str

    @property
    def program(self) -> str:
        """Its first word."""
        return self.text.split()[0]

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line} {self.text}"


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page."""
    text = page.read_text(encoding="utf-8")
    return [Block(page, text.count("\n", 0, found.start(2)) + 1, found[1], found[2]) for found in _FENCE.finditer(text)]


def commands() -> list[Command]:
    """Every command of every page."""
    return [command for page in PAGES for block in blocks(page) if block.language == "sh" for command in _lines(block)]


def _lines(block: Block) -> Iterator[Command]:
    """Commands that go on after a backslash are one."""
    begun, start = "", block.line
    for number, line in enumerate(block.text.splitlines(), block.line):
        start = start if begun else number
        begun += _without_comment(line)
        if begun.endswith("\\"):
            begun = begun[:-1]
        elif begun.strip():
            yield Command(block.page, start, " ".join(begun.split()))
            begun = ""


def _without_comment(line: str) -> str:
    """A hash begins a comment where a word could begin, outside of quotes."""
    quote = ""
    for k, letter in enumerate(line):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif letter == "#" and (k == 0 or line[k - 1].isspace()):
            return line[:k].rstrip()
    return line.rstrip()


def options(words: list[str]) -> list[str]:
    """The long options among a command's words."""
    return [word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)]


def plain_words(command: Command) -> list[str]:
    """A command's words, where nothing in it is for the shell to work out."""
    return shlex.split(command.text)


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return _FENCE.sub("", page.read_text(encoding="utf-8"))


def links(page: Path) -> list[str]:
    """Where the links and pictures of a page lead, but for those to other sites."""
    return [link for link in _LINK.findall(prose(page)) if not re.match(r"[a-z]+:", link)]


def anchors(page: Path) -> set[str]:
    """The names that links may add to the page after a hash: of each heading, as GitHub makes them."""
    names: list[str] = []
    for title in re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE):
        plain = re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-")
        seen = sum(re.fullmatch(re.escape(plain) + r"(-\d+)?", name) is not None for name in names)
        names.append(f"{plain}-{seen}" if seen else plain)
    return set(names)


def tables(page: Path) -> list[list[list[str]]]:
    """The tables of a page, the cells of each row without their borders; the row of dashes is left out."""
    found: list[list[list[str]]] = []
    inside = False
    for line in prose(page).splitlines():
        if line.startswith("|"):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            if not inside:
                found.append([])
            if not all(re.fullmatch(r":?-+:?", cell) for cell in cells):
                found[-1].append(cells)
        inside = line.startswith("|")
    return found
