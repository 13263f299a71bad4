"""Engines that run a sweep's jobs: their settings compose, what is missing is named, and those at hand run."""

from __future__ import annotations

import csv
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_module

from brafit.errors import ConfigError
from brafit.settings.checks import check_launcher, check_one_job
from brafit.settings.compose import explain, register

LAUNCHERS = {
    "joblib": "hydra_joblib_launcher",
    "ray": "hydra_ray_launcher",
    "submitit_local": "hydra_submitit_launcher",
    "submitit_slurm": "hydra_submitit_launcher",
}


@pytest.mark.parametrize("name", LAUNCHERS)
def test_settings_of_launchers_compose(name: str) -> None:
    register()
    with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
        config = compose("config", overrides=[f"hydra/launcher={name}"], return_hydra_config=True)
    assert LAUNCHERS[name] in config.hydra.launcher._target_


@pytest.mark.parametrize(("name", "extra"), [("joblib", "joblib"), ("ray", "ray"), ("submitit", "slurm")])
def test_a_missing_launcher_is_named_with_the_line_that_installs_it(name: str, extra: str) -> None:
    error = ImportError(f"Error locating target 'hydra_plugins.hydra_{name}_launcher.x.Y', set env var ...")
    assert f"pip install 'brafit[{extra}]'" in explain(error, [])


def test_a_launcher_without_m_is_refused() -> None:
    check_one_job(["hydra/launcher=basic"])
    with pytest.raises(ConfigError, match=r"brafit -m hydra/launcher=joblib KEY=VALUE"):
        check_one_job(["hydra.verbose=true", "hydra/launcher=joblib"])


@pytest.mark.parametrize("name", LAUNCHERS)
def test_a_missing_launcher_is_refused_before_anything_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    register()
    with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
        config = compose("config", overrides=[f"hydra/launcher={name}"], return_hydra_config=True)
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: None)
    extra = {"joblib": "joblib", "ray": "ray"}.get(name, "slurm")
    with pytest.raises(ConfigError, match=rf"^hydra/launcher={name}: .*pip install 'brafit\[{extra}\]'"):
        check_launcher(config)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["joblib", "submitit_local"])
def test_jobs_run_on_an_engine_and_their_tables_become_one(tmp_path: Path, name: str) -> None:
    if importlib.util.find_spec("hydra_plugins") is None or not importlib.util.find_spec(
        f"hydra_plugins.{LAUNCHERS[name]}"
    ):
        pytest.skip("this launcher is not installed")
    settings = [
        "experiment=quick",
        "scan.points=100",
        "pattern.formats=[]",
        "pattern.meshes=[]",
        "sinks.tensorboard=null",
    ]
    command = [sys.executable, "-m", "brafit", "-m", f"hydra/launcher={name}", "out=sweep", *settings]
    shards = "dataset.shard=1/3,2/3,3/3"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [*command, shards], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    with (tmp_path / "sweep" / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["scan"]: row["dataset.shard"] for row in rows} == {"anny_01": "1/3", "anny_04": "2/3", "anny_09": "3/3"}
