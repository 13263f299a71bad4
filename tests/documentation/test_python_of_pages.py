"""The Python code of README.md and docs/ runs as it stands, in a folder with the samples."""

from __future__ import annotations

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pages import PAGES, ROOT, Block, blocks

CODE = [block for page in PAGES for block in blocks(page) if block.language == "python"]
EXAMPLES = {file: file.read_text(encoding="utf-8") for file in sorted((ROOT / "examples").rglob("*.py"))}


def is_excerpt(block: Block) -> bool:
    """Whether it shows a part of an example: without imports, with dots for what is left out."""
    return "import " not in block.text


def of_example(block: Block) -> Path | None:
    """The example that is shown as a whole, but for the docstring."""
    shown = [file for file, text in EXAMPLES.items() if text.split('"""', 2)[-1].strip() == block.text.strip()]
    return shown[0] if shown else None


def name(block: Block) -> str:
    return f"{block.page.relative_to(ROOT)}:{block.line}"


whole = [block for block in CODE if not is_excerpt(block) and of_example(block) is None]


@pytest.mark.parametrize(
    "block",
    [pytest.param(block, id=name(block), marks=[] if block.page == PAGES[0] else pytest.mark.slow) for block in whole],
)
def test_the_code_runs(block: Block, tmp_path: Path) -> None:
    (tmp_path / "brafit").mkdir()
    shutil.copytree(ROOT / "brafit" / "samples", tmp_path / "brafit" / "samples")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", block.text], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("block", [block for block in CODE if is_excerpt(block)], ids=name)
def test_excerpts_are_what_the_examples_have(block: Block) -> None:
    """Line by line; and as they stand they are whole classes where the example's imports are."""
    (defined,) = re.findall(r"^class (\w+)", block.text, re.MULTILINE)
    file = next(file for file, text in EXAMPLES.items() if f"class {defined}(" in text)
    for line in block.text.splitlines():
        assert line.removesuffix(" ...") in EXAMPLES[file], line
    module = importlib.import_module(file.stem)
    there = dict(vars(module))
    exec(block.text, there)
    assert there[defined] is not getattr(module, defined)
    assert issubclass(there[defined], getattr(module, defined).__mro__[1])


def test_all_code_is_run_somewhere() -> None:
    """Examples that a page shows as a whole are run by the tests of the examples, which name them."""
    tests = "".join(
        file.read_text(encoding="utf-8") for file in (ROOT / "tests").rglob("test_*.py") if file != Path(__file__)
    )
    shown = [example for block in CODE if (example := of_example(block))]
    assert shown
    for example in shown:
        assert example.name in tests
    assert len(whole) + len(shown) + sum(map(is_excerpt, CODE)) == len(CODE)
