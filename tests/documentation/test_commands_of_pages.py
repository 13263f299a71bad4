"""The commands of README.md and docs/ do what the pages say.

Each is looked at here: its settings are composed and checked, its options and files are looked up. The slow tests run
it as a user would, in a folder where all that it names is there. What cannot run in a test is listed in NOT_RUN.
"""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import time
import tomllib
import urllib.request
from pathlib import Path

import pytest
from pages import ROOT, Command, commands, options
from workplace import FRAMES, QUICK, SCANS, copied, environment, extending, furnish, many, programs, run

from brafit.cli.arguments import parted as words_of_options
from brafit.cli.arguments import prepared
from brafit.run.sweep import combinations, parted
from brafit.settings.compose import SEARCH, from_settings

NOT_RUN = {
    r"make \w+": "sets up a whole machine, as .ci/run does",
    r"pip install ": "asks a package registry",
    r"brafit -m hydra/launcher=(submitit_slurm|ray) ": "needs a cluster",
    r"python scripts/(benchmark|check_run|check_scans|check_repeat|check_bodies|check_adam)\.py": "measures for long",
    r"python scripts/check_marking\.py": "measures how fast a browser draws, which a busy machine cannot promise",
}
"""Commands that no test runs, and why. Their settings, options, targets and extras are looked up all the same."""
SMALLER = {
    r"python scripts/reproduce_paper\.py": "--patience 2",
    r"python scripts/make_scans\.py": "--count 1 --points 5000",
    r"python scripts/check_patterns\.py": "--without-browser",
    r"python scripts/check_sizes\.py": "--many 12",
    r"python scripts/compare_peers\.py": "--breasts 1 --panels 2 --rescans 2 --patience 1",
}
"""Options that a command gets besides when it is run, so that it ends soon."""
NEEDS = {
    r"python scripts/make_scans\.py(?!.*--spheres)": "anny",
    r"brafit -m hydra/launcher=joblib": "hydra_plugins.hydra_joblib_launcher",
    r"python scripts/check_patterns\.py": "igl",
}
"""Packages without which a command cannot run."""
COMMANDS = commands()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
KINDS = ("python", "make", "pip", "tensorboard", "eval")
EXTENDING = "extending.md"


def matches(command: Command, table: dict[str, str]) -> list[str]:
    """What a table says of a command."""
    return [value for pattern, value in table.items() if re.match(pattern, command.text)]


def is_brafit(command: Command) -> bool:
    return re.match(r"brafit |brafit$|python -m brafit", command.text) is not None


def expanded(command: Command) -> list[str]:
    """The arguments that the shell hands to the program."""
    name = command.program
    script = f"{name}() {{ printf '%s\\0' \"$@\"; }}\n{command.text}"
    done = subprocess.run(["bash", "-ec", script], capture_output=True, text=True, check=True)
    return done.stdout.split("\0")[:-1]


BRAFIT = [command for command in COMMANDS if is_brafit(command)]
SMALL = [command for command in COMMANDS if command.program in PROJECT["scripts"] and command not in BRAFIT]
SCRIPTS = [command for command in COMMANDS if re.match(r"python (?!-m)", command.text)]
RUNNING = [command for command in COMMANDS if not matches(command, NOT_RUN) and command.program != "tensorboard"]


def of(program: str) -> list[Command]:
    """The commands of a program."""
    return [command for command in COMMANDS if command.program == program]


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All that commands name but for results."""
    folder = tmp_path_factory.mktemp("work")
    furnish(folder)
    extending(folder / "extending")
    copied(1, folder / "scan")
    return folder


@pytest.mark.parametrize("command", COMMANDS, ids=str)
def test_every_command_is_of_a_kind_that_is_looked_at(command: Command) -> None:
    assert command.program in (*KINDS, *PROJECT["scripts"]), "no test knows how to look at this"


def test_the_list_of_what_is_not_run_has_nothing_in_vain() -> None:
    for pattern in (*NOT_RUN, *SMALLER, *NEEDS):
        assert any(re.match(pattern, command.text) for command in COMMANDS), pattern


@pytest.mark.parametrize("command", BRAFIT, ids=str)
def test_settings_are_accepted(command: Command, work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(work / "extending" if command.page.name == EXTENDING else work)
    arguments = expanded(command)
    if command.text.startswith("python"):
        assert arguments[:2] == ["-m", "brafit"]
        arguments = arguments[2:]
    given = prepared(arguments)
    flags, settings = words_of_options(given)
    assert not {flag for flag in flags if flag.startswith("-")} - {"-m", "--help", "--cfg", "--config-dir"}
    if "--config-dir" in flags:
        settings.append(f"{SEARCH}=[{flags[flags.index('--config-dir') + 1]}]")
    swept, fixed = parted(settings)
    assert bool(swept) <= ("-m" in flags)
    jobs = list(combinations(swept, fixed))
    for one in jobs if len(jobs) < 8 else [*jobs[:2], jobs[-1]]:
        from_settings(one if any(text.startswith("out=") for text in one) else [*one, "out=unused"])


@pytest.mark.parametrize("command", SMALL, ids=str)
def test_options_of_the_smaller_commands_exist(command: Command) -> None:
    module = PROJECT["scripts"][command.program].partition(":")[0]
    known = declared(ROOT / (module.replace(".", "/") + ".py"))
    assert set(options(command.text.split())) <= known


@pytest.mark.parametrize("command", SCRIPTS, ids=str)
def test_scripts_and_their_options_exist(command: Command) -> None:
    script = ROOT / command.text.split()[1]
    assert script.is_file()
    assert set(options(command.text.split())) <= declared(script)


def declared(file: Path) -> set[str]:
    """The options that a file's argument parser takes, those of the modules beside it that it asks for some too."""
    text = file.read_text(encoding="utf-8")
    beside = re.findall(r"^from brafit\.cli\.(\w+) import \w+_arguments$", text, re.MULTILINE)
    trees = [ast.parse(own) for own in (text, *((ROOT / f"brafit/cli/{name}.py").read_text() for name in beside))]
    calls = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call)]
    adding = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "add_argument"]
    words = [argument.value for call in adding for argument in call.args if isinstance(argument, ast.Constant)]
    return {str(word) for word in words if str(word).startswith("--")} | {"--help"}


@pytest.mark.parametrize("command", of("make"), ids=str)
def test_targets_of_make_exist(command: Command) -> None:
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert phony is not None
    assert command.text.split()[1] in phony[1].split()


@pytest.mark.parametrize("command", of("pip"), ids=str)
def test_what_pip_is_to_install_exists(command: Command) -> None:
    for extra in re.findall(r"(?:brafit|\.)\[(\w+)\]", command.text):
        assert extra in PROJECT["optional-dependencies"]
    for file in re.findall(r"-[cr] (\S+)", command.text):
        assert (ROOT / file).is_file()


@pytest.fixture(scope="module")
def bin_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("programs") / "bin"
    programs(folder)
    return folder


@pytest.fixture(scope="module")
def results(work: Path, bin_folder: Path) -> Path:
    """Results of a few scans, of the same under other names, and with two and three panels in folders beside them."""
    out = work.parent / "results"
    files = {key: value for key, value in QUICK.items() if not key.startswith(("pattern.", "sinks."))}
    run(f"brafit FOLDER out={out}", work, bin_folder, files)
    for panels in ("2", "3"):
        shutil.copytree(out, out / panels, ignore=lambda _, names: {"2", "3", *SCANS[1:]} & set(names))
    for name in ("b", *(f"again_{k}" for k in range(4))):
        shutil.copytree(out / SCANS[0], out / name)
        fit = out / name / "fit.json"
        fit.write_text(fit.read_text().replace(f'"scan": "{SCANS[0]}"', f'"scan": "{name}"'))
    return out


def quick(command: Command) -> dict[str, str]:
    """The settings of QUICK that the command has not itself."""
    if not is_brafit(command) or re.search(r" --(help|cfg)\b", command.text):
        return {}
    settings = QUICK | (FRAMES if "cup=frames" in command.text else {})
    if "cup.block=" in command.text:  # which is only like a block with as many terms, and that is sound
        settings = {key: value for key, value in QUICK.items() if key.startswith(("pattern.", "sinks."))}
    return {key: value for key, value in settings.items() if f"{key}=" not in command.text}


@pytest.fixture
def place(command: Command, work: Path, results: Path, tmp_path: Path, bin_folder: Path) -> Path:
    """A fresh folder to run a command in; with results where it does not make them."""
    folder = tmp_path / "here"
    shutil.copytree(work, folder, symlinks=True)
    if "dataset.shard=" in command.text:
        many(folder)
    if "out=" not in command.text:
        shutil.copytree(results, folder / "RESULTS")
    if command.page.name != EXTENDING:
        return folder
    if "cup.block=" in command.text:
        run("brafit out=runs/block", folder / "extending", bin_folder, quick(command))
    return folder / "extending"


@pytest.mark.slow
@pytest.mark.parametrize("command", RUNNING, ids=str)
def test_the_command_runs(command: Command, place: Path, bin_folder: Path) -> None:
    for package in matches(command, NEEDS):
        pytest.importorskip(package)
    line = " ".join([command.text, *matches(command, SMALLER)])
    if command.text.startswith("python -m brafit"):
        line += "".join(f" '{key}={value}'" for key, value in quick(command).items())
    printed = run(line, place, bin_folder, quick(command))
    assert "Traceback" not in printed
    for out in re.findall(r"(?:--out |\bout=)(\S+)", command.text):
        if "--cfg" not in command.text:
            assert any((place / out).iterdir()), printed


@pytest.mark.slow
@pytest.mark.parametrize("command", of("tensorboard"), ids=str)
def test_tensorboard_shows_the_results(command: Command, place: Path, bin_folder: Path) -> None:
    """Its server is asked for the names of its runs."""
    line = ["bash", "-ec", f"exec {command.text} --port 0 --host 127.0.0.1"]
    surroundings = environment(bin_folder, {})
    with subprocess.Popen(line, cwd=place, env=surroundings, stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        try:
            said = next(line for line in server.stderr if "http://" in line)
            address = re.search(r"http://\S+", said)
            assert address is not None
            names, end = [], time.monotonic() + 60
            while not names and time.monotonic() < end:  # it reads the results while it answers
                with urllib.request.urlopen(f"{address[0].rstrip('/')}/data/runs", timeout=60) as answer:
                    names = json.loads(answer.read())
            assert any("batch" in name for name in names), names
        finally:
            server.terminate()
