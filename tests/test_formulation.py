"""docs/formulation.md: its numbers, and those of its equations that no other test checks."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from cups import cloud, half_circle, near

from brafit.cup import StripsCup
from brafit.geometry.nearest import nearest_feet
from brafit.geometry.panels import Feet, surface_points

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "formulation.md").read_text(encoding="utf-8")
TAGS = [int(number) for number in re.findall(r"\\tag\{(\d+)\}", PAGE)]
MODULES = sorted((ROOT / "brafit").rglob("*.py"))
_CITED = re.compile(r"(?<![\w)])\((\d{1,3})\)(?:(?:-| to )\((\d{1,3})\))?")


def cited(text: str) -> set[int]:
    """Numbers of equations in a text: "(12)", "(20)-(25)", "(1) to (4)"."""
    found = set()
    for first, last in _CITED.findall(text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def words_of(path: Path) -> Iterator[str]:
    """Docstrings (those of attributes too) and comments of a module."""
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string


def test_numbers_are_found_in_words():
    assert cited("(11)-(19) and (66), as (1) to (3) say, in 1992 (36: 122.8) and f(7)") == {*range(11, 20), 66, 1, 2, 3}


def test_every_equation_has_one_number_and_none_is_left_out():
    assert sorted(TAGS) == list(range(1, max(TAGS) + 1))


def test_the_page_cites_only_what_it_has():
    words = re.sub(r"```.*?```|\$[^$]*\$", "", PAGE, flags=re.DOTALL)
    assert cited(words) <= set(TAGS)


def test_every_number_in_the_code_leads_to_the_page():
    """And a module that cites equations says where they are."""
    words = {path.relative_to(ROOT).as_posix(): "\n".join(words_of(path)) for path in MODULES}
    citing = {name: numbers for name, text in words.items() if (numbers := cited(text))}
    assert len(citing) > 10
    assert {name: unknown for name, numbers in citing.items() if (unknown := numbers - set(TAGS))} == {}
    assert [name for name in citing if "docs/formulation.md" not in words[name]] == []


@pytest.mark.parametrize("page", ["formulation", "architecture"])
def test_what_pages_name_exists(page):
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:brafit|tests|scripts|docs|conf|examples)/[\w/.-]*)`", text)
    assert named
    assert [name for name in named if not (ROOT / name).exists()] == []
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
    assert [link for link in links if not (ROOT / "docs" / link).exists()] == []


def test_mathematics_survives_markdown():
    """Markdown takes the backslash off `\\,` within $...$, and a | within a table ends its cell."""
    words = re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)
    inline = re.findall(r"\$([^$]*)\$", words)
    assert len(inline) > 100
    assert [text for text in inline if re.search(r"\\[^A-Za-z]", text) or "\n" in text] == []
    rows = [line for line in words.splitlines() if line.startswith("|")]
    assert [row for row in rows if row.count("|") - row.count("\\|") != 3] == []


def test_second_derivative_57_of_the_distance_to_a_ruling():
    """Against central differences of half the squared distance to the ruling at s, its nearest place found anew."""
    cup = StripsCup(half_circle(), 2, 4, nodes=24)
    shape = cup.sketch(near(cup, 0.05, 2)).map(lambda v: v.detach()[:1])
    points = cloud(40, 3)[None]
    feet = nearest_feet(points, shape.edges, shape.tangents, shape.stations, 8)
    inside = (feet.u > 0.02) & (feet.u < 0.98) & (feet.tau > 0.02) & (feet.tau < 0.98)
    assert inside.sum() >= 10
    h = shape.stations.diff()[feet.interval]

    def at(tau: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        place = Feet(feet.panel, feet.interval, tau, u)
        return surface_points(shape.edges, shape.tangents, shape.stations, place)

    def parts(tau: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """X at the nearest place u of the ruling, the ruling's vector g and delta = p - X."""
        low, high = at(tau, torch.zeros_like(tau)), at(tau, torch.ones_like(tau))
        g = high - low
        u = ((points - low) * g).sum(-1) / (g * g).sum(-1)
        x = low + u[..., None] * g
        return x, g, points - x

    step = 1e-4
    tau, u = feet.tau, feet.u
    half = [0.5 * parts(tau + k * step)[2].square().sum(-1) for k in (-1, 0, 1)]
    expected = (half[2] - 2 * half[1] + half[0]) / (step * h) ** 2
    wide = (h * step)[..., None]
    x, g, delta = parts(tau)
    slope = (at(tau + step, u) - at(tau - step, u)) / (2 * wide)
    bend = (at(tau + step, u) - 2 * x + at(tau - step, u)) / wide**2
    turning = (parts(tau + step)[1] - parts(tau - step)[1]) / (2 * wide)
    mixed = (slope * g).sum(-1) - (delta * turning).sum(-1)
    found = (slope * slope).sum(-1) - (delta * bend).sum(-1) - mixed.square() / (g * g).sum(-1)
    torch.testing.assert_close(found[inside], expected[inside], rtol=1e-4, atol=1e-4)
