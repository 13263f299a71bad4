"""The command `brafit`: settings in, results and an exit status out.

What computes is imported late, so that help and wrong settings are answered at once.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import InstantiationException
from hydra.experimental.callback import Callback
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from brafit import __version__
from brafit.atomic import write_text
from brafit.config import check, explain, register, sources
from brafit.errors import BrafitError, ConfigError

if TYPE_CHECKING:
    from brafit.pipeline import Job, Row

ALL_OK, SOME_FAILED, NOTHING_RAN, INTERRUPTED = 0, 1, 2, 130
_STATUSES = "BRAFIT_STATUSES"

# What the callback below saw in this process: None while no job was begun, else the exit status.
_status: int | None = None


class Statuses(Callback):
    """Brings the exit status of every job to the process that the user started.

    Hydra drops what a job returns. A sweep's jobs may run in other processes, on other machines: each leaves its status
    in a folder inside the sweep's, which the environment names.
    """

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        _note(NOTHING_RAN)

    def on_run_end(self, config: DictConfig, *, job_return: JobReturn | None = None, **_: Any) -> None:
        _note(_status_of(job_return))

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        _note(NOTHING_RAN)
        folder = Path(config.hydra.sweep.dir).absolute() / ".statuses"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        os.environ[_STATUSES] = str(folder)

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **_: Any) -> None:
        if _STATUSES in os.environ:
            Path(os.environ[_STATUSES], str(config.hydra.job.num)).write_text(str(_status_of(job_return)))

    def on_multirun_end(self, config: DictConfig, **_: Any) -> None:
        folder = Path(os.environ.pop(_STATUSES))
        found = [int(file.read_text()) for file in folder.iterdir()]
        shutil.rmtree(folder)
        if not found:
            print("brafit: the sweep held no job; name the values: key=1,2,3", file=sys.stderr)
        _note(max(found, default=NOTHING_RAN))


def _note(status: int | None) -> None:
    global _status
    _status = status


def _status_of(job: JobReturn | None) -> int:
    done = job is not None and job.status == JobStatus.COMPLETED
    return int(job.return_value) if job is not None and done else NOTHING_RAN


def main() -> None:
    """Entry of the console script: exit status 0 if all scans are ok, 1 if some failed, 2 if nothing could run.

    With -m the highest of the jobs' statuses.
    """
    _note(None)
    full = os.environ.get("HYDRA_FULL_ERROR") == "1"
    # Hydra prints its errors at length and exits with 1, unless it is told to let them through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    register()
    try:
        _hydra()
    except KeyboardInterrupt:
        print("brafit: interrupted; what is finished is kept", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:  # the output is piped into something that has read enough, such as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        if full:
            raise
        print(f"brafit: {explain(error, sys.argv[1:])}", file=sys.stderr)
        sys.exit(NOTHING_RAN)
    sys.exit(_status or 0)


@hydra.main(version_base="1.3", config_path="pkg://brafit.conf", config_name="config")
def _hydra(config: DictConfig) -> int:
    """One job. Returns its exit status, and raises only when interrupted, so that a sweep's other jobs run."""
    out = Path(HydraConfig.get().runtime.output_dir)
    try:
        check(config)
        from brafit.pipeline import run

        write_text(out / "config.yaml", _settings_file(config))
        return exit_status(run(job_of(config, out), say=print))
    except BrafitError as error:
        print(f"brafit: {error}", file=sys.stderr)
    except Exception as error:
        traceback.print_exc()
        print(f"brafit: unexpected {type(error).__name__}, please report it with the lines above", file=sys.stderr)
    _remove_if_unused(out)
    return NOTHING_RAN


def exit_status(rows: Sequence[Row]) -> int:
    """0: all rows are ok; 1: some failed; 2: not one scan came as far as a result."""
    if all(row["status"] == "ok" for row in rows):
        return ALL_OK
    return SOME_FAILED if any(row.get("iterations") is not None for row in rows) else NOTHING_RAN


def job_of(config: DictConfig, out: Path) -> Job:
    """The pipeline's job for a composed configuration whose results go to `out`.

    Raises:
        ConfigError: a group's settings are not what its `_target_` takes.
    """
    import torch

    from brafit.pipeline import Job

    settings = OmegaConf.to_container(config, resolve=True)
    assert isinstance(settings, dict)
    return Job(
        scans=sources(config),
        out=out,
        cup=_build(config, "cup"),
        solver=_build(config, "solver"),
        condition=_build(config, "condition"),
        pattern=_build(config, "pattern"),
        names=dict(HydraConfig.get().runtime.choices) if HydraConfig.initialized() else {},
        scan={str(key): value for key, value in settings["scan"].items()},
        restarts=config.restarts,
        batch=config.batch,
        device=config.device,
        dtype=getattr(torch, config.dtype),
        threads=config.threads,
        settings={str(key): value for key, value in settings.items()},
    )


def _build(config: DictConfig, group: str) -> Any:
    try:
        return instantiate(config[group])
    except InstantiationException as error:
        said = " ".join(str(error.__cause__ or error).split())
        raise ConfigError(said if said.startswith(f"{group}.") else f"{group}: {said}") from error


def _settings_file(config: DictConfig) -> str:
    given = " ".join(shlex.quote(text) for text in HydraConfig.get().overrides.task)
    head = f"# brafit {__version__}, started in {Path.cwd()} with: {given or 'no settings'}\n"
    return head + OmegaConf.to_yaml(config, resolve=True)


def _remove_if_unused(out: Path) -> None:
    """Take away the folder of a job that had nothing to write into it but its settings."""
    if [file.name for file in out.iterdir()] == ["config.yaml"]:
        (out / "config.yaml").unlink()
    with contextlib.suppress(OSError):  # it holds something
        out.rmdir()
