"""What is added from outside of brafit works by the command and from Python, with the same numbers."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import brafit
from brafit.cloud import read_cloud
from brafit.errors import ConfigError
from brafit.fitting import TensorTarget
from brafit.run.dataset import ScanRef
from brafit.run.recipe import recipe_of
from brafit.run.store import key_of
from brafit.samples import sample_paths
from brafit.settings.entries import modules

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "extending"
LENGTH, BELOW = 235.0, 8.0
EXTRA, CLOSE = "condition.extra=[{_target_: edge_length.", "}]"
SETTINGS = [
    "condition.extra=[{_target_: edge_length.UpperEdgeLength, length: 235},"
    "{_target_: style_line.RidgeBelowApex, distance: 8}]",
    "condition.points={_target_: tukey.Biweight, width: 25}",
    "pattern.formats=[dxf,{_target_: hpgl.HpglWriter, gap: 20}]",
    "pattern.meshes=[]",
    "pattern.report=false",
    "scan.readers=[{_target_: ptx.PtxReader}]",
    "cup=house",
    "restarts=1",
]


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the modules in it, a block, and a scan as PTX with its landmark file."""
    folder = tmp_path_factory.mktemp("work")
    shutil.copytree(FOLDER, folder, dirs_exist_ok=True)
    sample = sample_paths()[0]
    cloud = read_cloud(sample)
    assert cloud.inside is not None
    cells = "\n".join(" ".join(map(repr, point)) + " 0.5" for point in (cloud.points[cloud.inside] / 1000).tolist())
    head = f"{int(cloud.inside.sum())}\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    (folder / "scans").mkdir()
    (folder / "scans" / "one.ptx").write_text(head + cells + "\n")
    marks = json.loads(sample.with_suffix(".json").read_text())
    del marks["units"]  # mm, while the cloud is in metres: found
    (folder / "scans" / "one.json").write_text(json.dumps(marks))
    block = brafit.fit(sample, settings=["pattern.report=false"])
    (folder / "block.json").write_text(json.dumps({"parameters": block.fit.parameters}))
    return folder


def run(work: Path, *settings: str) -> subprocess.CompletedProcess[str]:
    """The command as it is installed: the folder that it runs in is not on Python's path."""
    paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path and "extending" not in path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *paths]), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-P", "-m", "brafit", *settings]
    return subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, timeout=400)


@pytest.fixture(scope="module")
def told(work: Path) -> dict:
    """fit.json of a run with everything that the examples add, of the scans of a folder."""
    done = run(
        work, "--config-dir", "conf", "scans", *SETTINGS, "cup.block=block.json", "out=out", "sinks.tensorboard=null"
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads((work / "out" / "one" / "fit.json").read_text())


def test_the_command_takes_all_that_the_examples_add(told, work):
    assert told["status"] == "ok"
    assert told["cup"] == "house"
    conditions = told["conditions"]
    assert conditions["upper edge length"]["wanted_mm"] == LENGTH
    assert abs(conditions["upper edge length"]["length_mm"] - LENGTH) < 9
    assert conditions["ridge below apex"]["residual_mm"] < 4
    assert told["files"] == ["patterns.dxf", "patterns.plt"]
    assert (work / "out" / "one" / "patterns.plt").read_text().startswith("IN;DF;\nSP1;\nPU")
    assert told["settings"]["condition"]["extra"][0]["length"] == 235


@pytest.mark.parametrize(
    ("content", "panels", "words"),
    [
        (None, 2, "cannot be read (No such file or directory); make the block first"),
        ("no json", 2, "not JSON"),
        ("[1]", 2, "has no parameters of a cup"),
        ('{"parameters": null}', 2, "has no parameters of a cup"),
        ('{"parameters": {"edges": [[1.0]]}}', 3, "not a fit of strips with 3 panels and 14 terms; give cup.panels"),
    ],
)
def test_a_wrong_block_is_told_in_one_line(tmp_path, monkeypatch, content, panels, words):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    if content is not None:
        (tmp_path / "block.json").write_text(content)
    settings = ["hydra.searchpath=[conf]", "cup=house", "cup.block=block.json", f"cup.panels={panels}"]
    with pytest.raises(ConfigError) as told:
        brafit.fit(sample_paths()[0], settings=settings)
    assert str(told.value).startswith("cup.block=block.json: ")
    assert words in str(told.value)
    assert "Errno" not in str(told.value)


def test_the_fit_differs_from_one_without_them(told):
    plain = brafit.fit(sample_paths()[0], settings=["pattern.report=false"])
    assert abs(told["upper_edge_mm"] - plain.row()["upper_edge_mm"]) > 1e-3


def test_python_gives_the_same_numbers(told, work, monkeypatch, tmp_path):
    monkeypatch.chdir(work)
    settings = [*SETTINGS, "hydra.searchpath=[conf]", "cup.block=block.json"]
    result = brafit.fit(work / "scans" / "one.ptx", settings=settings)
    row = result.row()
    for key in ("rms_mm", "upper_edge_mm", "regularity_min", "outline_sd_mm"):
        assert row[key] == pytest.approx(told[key], rel=1e-9), key
    assert result.fit.conditions["upper edge length"]["length_mm"] == pytest.approx(
        told["conditions"]["upper edge length"]["length_mm"], rel=1e-9
    )
    written = {file.name for file in result.save(tmp_path)}
    assert written == {"patterns.dxf", "patterns.plt", "fit.json"}
    replace(result, options=replace(result.options, formats=["svg"])).save(tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"patterns.svg", "fit.json"}


def test_a_weight_by_its_name_has_derivatives_through_the_fit():
    """The upper edge's length by the share of the condition that asks for one, against a refit."""
    extra = "condition.extra=[{_target_: edge_length.UpperEdgeLength, length: 260}]"
    settings = [extra, "cup.terms=4", "cup.nodes=24", "scan.points=100", "condition.neckline_limit=null"]
    layer, (target,) = brafit.layer(str(sample_paths()[0]), settings=settings)
    scan = TensorTarget.of(target)
    share = torch.ones((), dtype=torch.float64, requires_grad=True)
    cups = layer([target], shares={"upper edge length": share})
    assert cups.settled.all()
    (slope,) = torch.autograd.grad(cups.lengths()[0, -1], share)
    h = 1e-4
    ahead, behind = (
        layer([scan], shares={"upper edge length": share.detach() + sign * h}, near=cups) for sign in (1, -1)
    )
    known = (ahead.lengths()[0, -1] - behind.lengths()[0, -1]).item() / (2 * h)
    assert slope.item() == pytest.approx(known, rel=1e-4)
    assert slope.item() > 0.1


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("condition.extra=[{_target_: no_module.A}]", "extra.0: no_module.A: there is no module no_module (in the"),
        (f"{EXTRA}UperEdgeLength{CLOSE}", "edge_length has no UperEdgeLength; did you mean UpperEdgeLength?"),
        (f"{EXTRA}UpperEdgeLength, lenght: 3{CLOSE}", "extra.0: UpperEdgeLength.__init__() got an unexpected keyword"),
        (f"{EXTRA}UpperEdgeLength, length: 0{CLOSE}", "condition.extra.0: length must be positive, got 0"),
        ("condition.extra=3", "condition.extra: must be a list"),
        ("condition.points=l3", "condition.points=l3: must be one of l2, l1, robust"),
        ("scan.readers=[{_target_: hpgl.HpglWriter}]", "scan.readers.0: a HpglWriter is no brafit.cloud.Reader"),
        ("cup._target_=ptx.PtxReader", "cup: PtxReader() takes no arguments"),
        ("cup._target_=edge_length", "_target_ must be MODULE.NAME"),
        ("cup._target_=brafit.cup", "brafit.cup is a module; name a class"),
        ("solver._target_=ptx.PtxReader", "solver: PtxReader() takes no arguments"),
        ("pattern.meshes=[stl]", "pattern.meshes=stl: must be a list of ply, obj, glb, {_target_: MODULE.CLASS}"),
        ("pattern.meshes=[{_target_: hpgl.HpglWriter}]", "pattern.meshes=HpglWriter: must be a list of ply"),
        ("cup.nodes=20", "cup: 14 terms need at least 28 nodes, got 20"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(setting, line):
    with pytest.raises(ConfigError, match=r"\S") as caught:
        recipe_of([setting])
    assert "\n" not in str(caught.value)
    assert line in str(caught.value)


def test_a_module_that_fails_as_it_is_imported_is_named(tmp_path, monkeypatch):
    (tmp_path / "broken_module.py").write_text("import no_such_library\n")
    (tmp_path / "raising_module.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        ConfigError, match=r"extra.0: broken_module cannot be imported \(No module named 'no_such_library'"
    ):
        recipe_of(["condition.extra=[{_target_: broken_module.A}]"])
    with pytest.raises(ConfigError, match=r"extra.0: raising_module cannot be imported \(ZeroDivisionError"):
        recipe_of(["condition.extra=[{_target_: raising_module.A}]"])


def test_results_are_made_anew_where_the_module_has_changed(tmp_path, monkeypatch):
    text = (FOLDER / "edge_length.py").read_text()
    (tmp_path / "changing_module.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    ref = ScanRef(sample_paths()[0], ("one",), (None,), (0,))
    plain = recipe_of([]).settings
    settings = recipe_of(["condition.extra=[{_target_: changing_module.UpperEdgeLength, length: 200}]"]).settings
    assert modules(plain) == []
    assert modules(settings) == [tmp_path / "changing_module.py"]
    before = key_of(ref, None, settings)
    assert before == key_of(ref, None, settings)
    assert before != key_of(ref, None, plain)
    (tmp_path / "changing_module.py").write_text(text + "\n# other\n")
    assert before != key_of(ref, None, settings)


def test_the_page_shows_the_commands_of_the_examples():
    """And each example tells its own."""
    page = (ROOT / "docs" / "extending.md").read_text()
    for file in FOLDER.glob("*.py"):
        assert f"{file.stem}." in page, file
        assert re.search(r"\n *brafit .*_target_: |--config-dir", file.read_text()), file


def test_the_help_names_no_module_and_loads_none():
    code = "import sys, brafit.cli.fit, brafit.settings.entries; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_a_reader_is_found_by_the_process_that_reads(work):
    """From Python, files are read in another process."""
    from ptx import PtxReader

    cloud = read_cloud(work / "scans" / "one.ptx", readers=[PtxReader()])
    assert cloud.unit == "m"
    assert np.ptp(cloud.points, axis=0).max() < 0.5
