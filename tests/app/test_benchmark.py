"""The benchmark runs where there is no GPU, too, and says so."""

from __future__ import annotations

import re

import pytest
import torch
from benchmark import report_gpu
from lunes import lune_cup, sphere_points

from brafit.fitting import Target


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is there")
def test_without_a_gpu_a_few_scans_run_on_the_cpu(capsys):
    edges = lune_cup(2, 41).edges
    whole = Target("sphere", sphere_points(400)[0], edges[0].numpy(), edges[-1].numpy())
    report_gpu([whole], (16, 256, 4096), 2000)
    first, *rows = capsys.readouterr().out.splitlines()
    assert "no CUDA device" in first
    assert len(rows) == 2
    for row, dtype in zip(rows, ("float64", "float32"), strict=True):
        found = re.fullmatch(
            rf"2 scans of 300 points, cpu, {dtype}: [\d.]+ scans/s \(starts \d+%, solve \d+%, measurement \d+%\);"
            r" RMS off the CPU's in float64 by at most ([\d.e-]+) mm",
            row,
        )
        assert found, row
        assert float(found[1]) < 0.1
