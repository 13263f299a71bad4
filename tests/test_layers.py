"""Which part of brafit may import which: the table, and a look at every import of the source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "brafit"
LAYERS = (
    ("geometry", "naming", "processes", "remarks", "samples", "typeface"),
    ("atomic", "errors"),
    ("cloud", "cup", "underwires"),
    ("surface", "settings"),
    ("landmarks",),
    ("anatomy", "fitting", "pattern", "simulation"),
    ("scan", "report"),
    ("result",),
    ("run",),
    ("marking", "sizing"),
    ("api", "cli"),
    ("__init__", "__main__"),
)
"""From the bottom up. A part may import the parts of lower layers, and none of its own layer or above."""
HEIGHT = {part: height for height, layer in enumerate(LAYERS) for part in layer}


def part_of(file: Path) -> str:
    """The package, or module of the top level, that a file belongs to."""
    return file.relative_to(ROOT).with_suffix("").parts[0]


def imports(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and full name of what is imported of brafit, anywhere in a module; of names of brafit itself, these."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports name their module in full"
            names = [_full(node.module or "", alias.name) for alias in node.names]
        else:
            continue
        for name in names:
            if name.split(".")[0] == "brafit" and name != "brafit.__version__":
                yield node.lineno, name


def _full(module: str, name: str) -> str:
    """The module that `from module import name` loads: of a package its module of that name, if there is one."""
    inner = f"{module}.{name}"
    path = ROOT.parent.joinpath(*inner.split("."))
    return inner if module == "brafit" or path.is_dir() or path.with_suffix(".py").is_file() else module


def breaches(part: str, text: str) -> list[str]:
    """Imports of a part's source that the table does not allow."""
    found = []
    for line, name in imports(ast.parse(text)):
        other = ([*name.split("."), "__init__"])[1]
        if other != part and HEIGHT[other] >= HEIGHT[part]:
            found.append(f"line {line}: {part} imports {name}")
    return found


FILES = [file for file in sorted(ROOT.rglob("*.py")) if part_of(file) != "conf"]
"""`brafit/conf` is no part: a link to the settings that a working tree may have, and that a wheel has as a folder."""


def test_every_part_has_its_layer_and_every_layer_its_parts():
    assert {part_of(file) for file in FILES} == set(HEIGHT)
    assert len(HEIGHT) == sum(map(len, LAYERS))


@pytest.mark.parametrize("part", HEIGHT)
def test_imports_go_down(part):
    own = [file for file in FILES if part_of(file) == part]
    found = [f"{file.relative_to(ROOT)}, {line}" for file in own for line in breaches(part, file.read_text())]
    assert not found


def test_a_breach_is_seen_wherever_it_stands():
    assert breaches("geometry", "from brafit.cup import Cup")
    assert breaches("cup", "def f():\n    import brafit.cloud.read")
    assert breaches("fitting", "if True:\n    from brafit import run")
    assert breaches("run", "import brafit")
    assert not breaches("run", "from brafit import __version__\nfrom brafit.run.job import Job\nimport torch")


def test_modules_within_a_part_import_one_way():
    """As they are loaded; a type's name or a late import may point back."""
    graph = {}
    for file in FILES:
        name = ".".join(("brafit", *file.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
        tree = ast.parse(file.read_text())
        tree.body = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
        graph[name] = {other for _, other in imports(tree) if other != name}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


LONGEST_FUNCTION, LONGEST_FILE = 60, 450


def long_functions(text: str) -> list[tuple[str, int]]:
    """Names and lines, docstring and decorators included, of functions that are too long."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = min([node.lineno, *(one.lineno for one in node.decorator_list)])
            lines = (node.end_lineno or first) - first + 1
            found += [(node.name, lines)] if lines > LONGEST_FUNCTION else []
    return found


@pytest.mark.parametrize("part", HEIGHT)
def test_functions_and_files_can_be_seen_at_once(part):
    found = []
    for file in (file for file in FILES if part_of(file) == part):
        text, name = file.read_text(encoding="utf-8"), str(file.relative_to(ROOT))
        found += [(name, *function) for function in long_functions(text)]
        found += [(name, lines)] if (lines := len(text.splitlines())) > LONGEST_FILE else []
    assert not found


def test_a_long_function_is_seen_wherever_it_stands():
    body = "\n".join("        x = 1" for _ in range(LONGEST_FUNCTION - 1))
    assert not long_functions(f"class A:\n    def f():\n{body}")
    assert long_functions(f"class A:\n    @staticmethod\n    def f():\n{body}") == [("f", LONGEST_FUNCTION + 1)]
