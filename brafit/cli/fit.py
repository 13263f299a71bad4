"""The command `brafit`: settings in, results and an exit status out.

What computes is imported late, so that help and wrong settings are answered at once.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from brafit import __version__
from brafit.atomic import write_text
from brafit.cli.arguments import prepared
from brafit.cli.completion import answer, is_query
from brafit.cli.status import ALL_OK, INTERRUPTED, NOTHING_RAN, SOME_FAILED, TERMINATED
from brafit.errors import BrafitError, ConfigError
from brafit.naming import print_anything
from brafit.processes import prepare
from brafit.run.folder import is_about_writing, make_writable, why_not
from brafit.run.job import PRELOAD, REDO
from brafit.run.recipe import NAMED, recipe_from_settings
from brafit.run.store import differences, relevant
from brafit.run.sweep import SweepJob, check_scans, combinations, gather, parted, read_statuses, write_status
from brafit.settings.checks import check, check_launcher, check_one_job
from brafit.settings.compose import explain, from_settings, help_text, plain_settings, register, searched
from brafit.settings.entries import locate, made, targets
from brafit.settings.quoting import unquoted

if TYPE_CHECKING:
    from brafit.run.job import Job, Row

_STATUSES = ".statuses"

# What the callback below saw in this process: None while no job was begun, else the exit status.
_status: int | None = None
# The folder of the run or sweep in this process, once it was begun: Hydra forgets it where one is broken off.
_out: str | None = None


class Statuses(Callback):
    """Brings the exit status of every job to the process that the user started.

    Hydra drops what a job returns. A sweep's jobs may run in other processes, on other machines: each leaves its status
    in a folder inside the sweep's.
    """

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Refuse what cannot run before Hydra makes its folder."""
        _note(NOTHING_RAN, config.hydra.run.dir)
        with _refusing():
            check_one_job(config.hydra.overrides.hydra)
            check_launcher(config)
            make_writable(Path(config.hydra.run.dir))

    def on_run_end(self, config: DictConfig, *, job_return: JobReturn | None = None, **_: Any) -> None:
        _note(_status_of(job_return))

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Refuse a bad value before the first job runs; jobs' folders are named by what is swept."""
        _note(NOTHING_RAN, config.hydra.sweep.dir)
        arguments = list(config.hydra.overrides.task)
        with _refusing():
            swept, fixed = parted(arguments)
            check_launcher(config)
            search = [f"{key}={value}" for key, value in searched(config.hydra).items()]
            given = combinations(swept, fixed)
            check_scans([recipe_from_settings(plain_settings(from_settings(own + search)), {}) for own in given])
            make_writable(Path(config.hydra.sweep.dir))
        excluded = ",".join(key for key in fixed)
        with read_write(config), open_dict(config):
            config.hydra.overrides.hydra.append(f"hydra.job.config.override_dirname.exclude_keys=[{excluded}]")
        folder = Path(config.hydra.sweep.dir) / _STATUSES
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **_: Any) -> None:
        output = Path(config.hydra.runtime.output_dir)
        statuses = output.parent / _STATUSES  # found by its place: jobs on a cluster have nothing else of the sweep's
        if config.hydra.mode == RunMode.MULTIRUN and statuses.is_dir():
            fixed = set(config.hydra.job.config.override_dirname.exclude_keys)
            own = (text.partition("=") for text in config.hydra.overrides.task)
            overrides = {key: unquoted(value) for key, _, value in own if key not in fixed}
            write_status(statuses, config.hydra.job.num, SweepJob(output.name, overrides, _status_of(job_return)))

    def on_multirun_end(self, config: DictConfig, **_: Any) -> None:
        folder = Path(config.hydra.sweep.dir) / _STATUSES
        jobs = read_statuses(folder)
        shutil.rmtree(folder)
        if not jobs:
            print("brafit: the sweep held no job; name the values: key=1,2,3", file=sys.stderr)
        else:
            gather(folder.parent, jobs)
            print(f"{len(jobs)} jobs. Table over all: {config.hydra.sweep.dir}/sweep.csv, pages: index.html beside it")
        _note(max((job.status for job in jobs), default=NOTHING_RAN))


class _Terminated(KeyboardInterrupt):
    """The process was asked to end (SIGTERM), as a queue or a container does it: all ends as at Ctrl+C."""


def _terminate(*_: Any) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # once is enough: what is begun is cleared up
    raise _Terminated


def _kept() -> str:
    """What is left of a run that was broken off, and how to go on."""
    if _out is None:
        return "nothing was begun"
    return f"finished scans are kept, and the same command with out={shlex.quote(_out)} goes on from there"


@contextlib.contextmanager
def _refusing() -> Iterator[None]:
    """Ends the process where something is refused: of errors in a callback Hydra would only warn."""
    try:
        yield
    except BrafitError as error:
        print(f"brafit: {error}", file=sys.stderr)
        sys.exit(NOTHING_RAN)


def _note(status: int | None, out: str | None = None) -> None:
    global _status, _out
    _status, _out = status, out or _out


def _status_of(job: JobReturn | None) -> int:
    done = job is not None and job.status == JobStatus.COMPLETED
    return int(job.return_value) if job is not None and done else NOTHING_RAN


def main() -> None:
    """Entry of the console script: exit status 0 if all scans are ok, 1 if some failed, 2 if nothing could run.

    With -m the highest of the jobs' statuses.
    """
    _note(None)
    print_anything()
    full = os.environ.get("HYDRA_FULL_ERROR") == "1"
    # Hydra prints its errors at length and exits with 1, unless it is told to let them through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    register()
    signal.signal(signal.SIGTERM, _terminate)
    given = sys.argv[1:]
    try:
        if given in (["--help"], ["-h"]):
            print(help_text())
        elif "--version" in given:  # Hydra would tell its own
            print(f"brafit {__version__}")
        elif is_query(given):
            answer(_hydra)
        else:
            sys.argv[1:] = given = prepared(given)
            if not any(text.startswith("-") for text in given):  # one run: imports take as long as settings, or longer
                prepare(PRELOAD)
            _hydra()
    except _Terminated:
        print(f"brafit: terminated; {_kept()}", file=sys.stderr)
        sys.exit(TERMINATED)
    except KeyboardInterrupt:
        print(f"brafit: interrupted; {_kept()}", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:  # the output is piped into something that has read enough, such as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        if full:
            raise
        print(f"brafit: {explain(error, given)}", file=sys.stderr)
        sys.exit(NOTHING_RAN)
    sys.exit(_status or 0)


@hydra.main(version_base="1.3", config_path="pkg://brafit.conf", config_name="config")
def _hydra(config: DictConfig) -> int:
    """One job. Returns its exit status, and raises only when interrupted, so that a sweep's other jobs run."""
    out = Path(HydraConfig.get().runtime.output_dir)
    try:
        check(config)
        settings = plain_settings(config)
        refuse_other_settings(out, settings)
        from brafit.run import run

        write_text(out / "config.yaml", _settings_file(config))
        return exit_status(run(job_of(settings, _choices(), out), say=print))
    except BrafitError as error:
        print(f"brafit: {error}", file=sys.stderr)
    except Exception as error:
        if is_about_writing(error):
            print(f"brafit: {why_not(out, error)}", file=sys.stderr)
            return NOTHING_RAN
        traceback.print_exc()
        print(f"brafit: unexpected {type(error).__name__}, please report it with the lines above", file=sys.stderr)
    _remove_if_unused(out)
    return NOTHING_RAN


def exit_status(rows: Sequence[Row]) -> int:
    """0: all rows are ok; 1: some failed; 2: not one scan came as far as a result."""
    if all(row["status"] == "ok" for row in rows):
        return ALL_OK
    return SOME_FAILED if any(row.get("iterations") is not None for row in rows) else NOTHING_RAN


def _choices() -> dict[str, Any]:
    """Which choice of each group this job has, and where they were looked for."""
    return dict(HydraConfig.get().runtime.choices) | searched(HydraConfig.get())


def job_of(settings: Mapping[str, Any], choices: Mapping[str, Any], out: Path) -> Job:
    """The job of composed settings, whose results go to `out`."""
    from brafit.run.job import Job

    for name, target in targets(settings["pattern"]["formats"], "pattern.formats"):  # which a sink may share
        locate(target, name)
    sinks = [made(sink, f"sinks.{name}") for name, sink in settings["sinks"].items() if sink is not None]
    names = {key: choices[key] for key in NAMED if key in choices}
    return Job(
        out=out,
        recipe=partial(recipe_from_settings, settings, names),
        scans=settings["scans"],
        side=settings["scan"]["side"],
        manifest=settings["dataset"]["manifest"],
        shard=settings["dataset"]["shard"],
        sinks=sinks,
        batch=settings["batch"],
        workers=settings["threads"] or cores(),
        one_fit=settings["device"] != "cpu",
        read_patience=settings["scan"]["read_seconds"],
        patience=settings["patience"],
        resume=settings["resume"],
    )


def cores() -> int:
    """Processor cores that this process may use, or as many as OMP_NUM_THREADS says; of a sweep's job that runs beside
    others, its share.
    """
    said = os.environ.get("OMP_NUM_THREADS", "")
    if said.isdecimal() and int(said) > 0:
        return int(said)
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    beside = 1
    if HydraConfig.initialized() and "joblib" in HydraConfig.get().launcher.get("_target_", ""):
        jobs = HydraConfig.get().launcher.n_jobs
        beside = count if jobs < 0 else jobs
    return max(1, count // beside)


def refuse_other_settings(out: Path, settings: Mapping[str, Any]) -> None:
    """Keep results of different settings out of one folder.

    Raises:
        ConfigError: `out` holds results of other settings, and `resume` is not `redo`; names what is different.
    """
    file = out / "config.yaml"
    if settings["resume"] == REDO or not file.is_file() or not any(out.glob("*/fit.json")):
        return
    try:
        old = OmegaConf.to_container(OmegaConf.load(file))
    except Exception as error:
        raise ConfigError(f"{file} cannot be read ({error}); take another out, or resume=redo to start over") from None
    assert isinstance(old, dict)
    version = re.match(r"# brafit (\S+),", file.read_text(encoding="utf-8"))
    before = relevant({str(key): value for key, value in old.items()}) | {"brafit": version[1] if version else "?"}
    if found := differences(before, relevant(settings)):
        shown = "; ".join(found[:5]) + (f"; and {len(found) - 5} more" if len(found) > 5 else "")
        remedy = "take another out, or resume=redo to start over"
        raise ConfigError(f"out={out} holds results of other settings ({shown}): {remedy}")


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
