import csv
import json
import math
from enum import Enum

import numpy as np
import pytest
import torch

from brafit.report.table import SUMMARY_KEYS, format_table, write_fit_json, write_summary

NAMES = ["plain", 'quo"te, comma', "Größe 胸", "line\nbreak", " space ", "=1+1"]


def row(name: str = "anny_05", **values) -> dict:
    good = {key: 0.123456789 for key in SUMMARY_KEYS if key.endswith("_mm")}
    words = {"scan": name, "status": "ok", "reason": "converged", "side": "left", "cup": "frames", "solver": "anneal"}
    words["nearest_wire"] = "harriet:36"
    counts = {"panels": 2, "terms": 6, "points": 4000, "iterations": 300, "seconds": 12.5}
    return {**good, **words, **counts, "twist_deg_max": 1.5, "regularity_min": 0.4, **values}


def test_keys_are_those_of_the_specification():
    assert " ".join(SUMMARY_KEYS) == (
        "scan status reason side cup panels terms solver points rms_mm mean_mm p95_mm max_mm upper_edge_mm "
        "neckline_smoothing_mm seam_to_apex_mm outline_sd_mm tightest_radius_mm "
        "wire_length_mm wire_smoothing_mm wire_drift_mm "
        "nearest_wire nearest_wire_length_diff_mm nearest_wire_span_diff_mm "
        "twist_deg_max regularity_min isometry_mm seam_mismatch_mm "
        "iterations seconds landmark_confidence warning_count"
    )


def test_summary_round_trip_with_odd_names(tmp_path):
    write_summary(tmp_path / "summary.csv", [row(name) for name in NAMES])
    with (tmp_path / "summary.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["scan"] for r in rows] == NAMES
    assert tuple(rows[0]) == SUMMARY_KEYS
    assert rows[0]["rms_mm"] == "0.123457"
    assert rows[0]["points"] == "4000"


def test_six_digits_for_large_and_small_numbers(tmp_path):
    write_summary(tmp_path / "s.csv", [row(rms_mm=1.23456789e-7, wire_length_mm=255.3812345, max_mm=np.float32(0.1))])
    with (tmp_path / "s.csv").open(encoding="utf-8", newline="") as file:
        (read,) = csv.DictReader(file)
    assert (read["rms_mm"], read["wire_length_mm"], read["max_mm"]) == ("1.23e-07", "255.381", "0.1")


def test_failed_rows_have_empty_figures_and_a_reason_in_one_line(tmp_path):
    failed = {"scan": "x", "status": "failed", "reason": "x.ply: no points.\n  Give a cloud.", "rms_mm": math.nan}
    write_summary(tmp_path / "s.csv", [failed, row()])
    lines = (tmp_path / "s.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 3
    assert lines[1] == "x,failed,x.ply: no points. Give a cloud." + "," * (len(SUMMARY_KEYS) - 3)


class Code(Enum):
    GOOD = "went well"


def test_fit_json_is_strict_and_complete(tmp_path):
    extra = {"edges": {"wire": torch.tensor(1.0), "list": np.array([1.0, np.inf])}, "code": Code.GOOD, "none": None}
    write_fit_json(tmp_path / "fit.json", row('Größe "x"', rms_mm=math.nan, points=np.int64(7)), extra)

    def refuse(constant: str):
        raise AssertionError(f"{constant} is no JSON")

    read = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert tuple(read)[: len(SUMMARY_KEYS)] == SUMMARY_KEYS
    assert read["scan"] == 'Größe "x"'
    assert read["rms_mm"] is None
    assert read["points"] == 7
    assert read["mean_mm"] == 0.123456789
    assert read["edges"] == {"wire": 1.0, "list": [1.0, None]}
    assert read["code"] == "GOOD"
    assert read["none"] is None


def test_names_that_are_no_text_do_not_stop_a_run(tmp_path):
    write_summary(tmp_path / "s.csv", [row("bad\udcff")])
    write_fit_json(tmp_path / "fit.json", row("bad\udcff"))
    assert json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))["scan"] == "bad\ufffd"


def test_keys_that_are_no_columns_are_refused(tmp_path):
    with pytest.raises(KeyError, match="rms"):
        write_summary(tmp_path / "s.csv", [{"scan": "x", "rms": 1.0}])
    with pytest.raises(KeyError, match="rms_mm"):
        write_fit_json(tmp_path / "fit.json", row(), {"rms_mm": 1.0})
    assert list(tmp_path.iterdir()) == []


def test_table_is_aligned_and_names_what_failed():
    failed = {"scan": "a_much_longer_name", "status": "failed", "reason": "no landmark file"}
    lines = format_table([row(), failed, row("b", rms_mm=math.nan)]).splitlines()
    assert len(lines) == 5
    assert lines[0].index("status") == lines[1].index("ok") == lines[2].index("failed")
    assert lines[4] == "a_much_longer_name: no landmark file"
    assert max(map(len, lines)) < 130
