"""What a run promises beyond one good scan: that kills, bad files, shards and size change nothing.

    python scripts/check_run.py FOLDER                  FOLDER holds breasts with landmark files
    python scripts/check_run.py FOLDER --only kill,poison,shards,memory,torn

    kill      kill -9 at random moments of a run of 300 scans, each time resumed: every file as of an undisturbed run
    poison    50 bad files of six kinds among 500: the others as of a clean run, the bad ones failed for true reasons
    shards    16 shards of 64 scans, collected, against one run
    memory    peak of what the whole process tree holds in memory of its own, over a run of 200 and of 2,000 scans
    cluster   a cluster of two processes on this machine (Ray), one killed in the middle: all scans end

The fits are quick ones (few points and terms): what is checked does not depend on how good they are.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from rescans import write_rescans

QUICK = ["experiment=quick", "scan.points=300", "pattern.meshes=[]", "sinks.tensorboard=null"]
LEAN = ["pattern.formats=[dxf]", "pattern.report=false"]
DATES = re.compile(rb"\d{4}-\d{2}-\d{2}")


def command(scans: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "brafit", f"scans='{scans}'", f"out='{out}'", *QUICK, *more]


def run(scans: Path, out: Path, *more: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command(scans, out, *more), capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"the run ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return done


def content(file: Path) -> object:
    """What a file says, its times, dates and folders, and the scan's place among all, apart."""
    if file.name == "fit.json":
        fit = json.loads(file.read_text(encoding="utf-8"))
        fit.pop("seconds")
        fit.pop("position", None)  # in a folder with bad files between
        fit["file"] = Path(fit["file"]).name
        settings = fit.get("settings", {})
        for key in ("out", "dataset", "scans", "threads", "batch"):
            settings.pop(key, None)
        return fit
    if file.suffix == ".csv":
        with file.open(encoding="utf-8", newline="") as lines:
            return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(lines)]
    return DATES.sub(b"DATE", file.read_bytes())


def differing(one: Path, other: Path, names: Sequence[str] | None = None) -> list[str]:
    """Files of two runs that are not the same; of the scans of these names, or of all, and then the table too."""

    def files(out: Path) -> set[Path]:
        chosen = [out] if names is None else [out / name for name in names]
        found = {file.relative_to(out) for folder in chosen for file in folder.rglob("*") if file.is_file()}
        return {f for f in found if f.name not in ("config.yaml", "index.html", "summary.parquet", "report.html")}

    if files(one) != files(other):
        return sorted(map(str, files(one) ^ files(other)))
    return sorted(str(file) for file in files(one) if not alike(content(one / file), content(other / file)))


NUMBER = re.compile(rb"-?\d+\.\d+(?:e[+-]?\d+)?")


def alike(one: object, other: object) -> bool:
    """The same, numbers to seven digits or a ten thousandth of a millimetre: other batches round differently."""
    if isinstance(one, bytes) and isinstance(other, bytes):
        if NUMBER.sub(b"#", one) != NUMBER.sub(b"#", other):
            return False
        return alike([float(v) for v in NUMBER.findall(one)], [float(v) for v in NUMBER.findall(other)])
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= max(1e-7 * abs(one), 1.1e-4)
    return one == other


def broken(out: Path) -> list[str]:
    """Visible files that are not whole: JSON that cannot be read, a table with half a line, a DXF without its end."""
    found = []
    for file in out.rglob("*"):
        if not file.is_file() or file.name.startswith("."):
            continue
        data = file.read_bytes()
        if file.suffix == ".json":
            try:
                json.loads(data)
            except ValueError:
                found.append(str(file))
        elif (file.suffix == ".csv" and not data.endswith(b"\n")) or (
            file.suffix == ".dxf" and not data.rstrip().endswith(b"EOF")
        ):
            found.append(str(file))
    return found


def check_kill(folder: Path, work: Path, kills: int = 10, count: int = 300) -> None:
    scans = work / "scans"
    write_rescans(folder, scans, count)
    begun = time.monotonic()
    run(scans, work / "whole", *LEAN)
    length = time.monotonic() - begun
    out, rng, torn = work / "killed", np.random.default_rng(3), []
    for _ in range(kills):
        process = subprocess.Popen(
            command(scans, out, *LEAN), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        try:
            process.wait(rng.uniform(0.05, 0.35) * length)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)  # the command alone: its workers are to notice
            process.wait()
        torn += broken(out)
    print(f"killed {kills} times: {len(list(out.glob('*/fit.json')))} of {count} scans were finished by then")
    run(scans, out, *LEAN)
    differ = differing(work / "whole", out)
    litter = [str(file) for file in out.rglob(".*") if file.is_file()]
    print(f"files not as of an undisturbed run: {len(differ)} {differ[:5]}; broken files seen: {len(torn)} {torn[:3]}")
    print(f"left behind: {len(litter)} {litter[:3]}")


def poison(scans: Path, good: Path) -> dict[str, str]:
    """Bad files of six kinds among the scans; what the reason of each has to say."""
    cloud, marks = good.read_bytes(), json.loads(good.with_suffix(".json").read_text())
    header = cloud[: cloud.index(b"end_header\n")]
    text = json.dumps(marks)
    kinds: list[tuple[str, str]] = []
    for k in range(50):
        kind = ("cut", "empty", "dies", "hangs", "nan", "same")[k % 6]
        path = scans / f"bad_{kind}_{k:02d}.ply"
        path.with_suffix(".json").write_text(text)
        if kind == "cut":
            path.write_bytes(cloud[: len(cloud) // 2])
            words = "damaged or cut off"
        elif kind == "empty":
            path.write_bytes(b"")
            words = "the file is empty"
        elif kind in ("dies", "hangs"):
            path.write_bytes(header + b"end_header\n")
            os.truncate(path, 100_000_000_000 if kind == "hangs" else 20_000_000_000)  # takes no room on the disk
            words = "longer than" if kind == "hangs" else "crashed"
        elif kind == "nan":
            path.write_bytes(cloud)
            wire = [[float("nan")] * 3, *marks["wire"][1:]]
            path.with_suffix(".json").write_text(json.dumps(marks | {"wire": wire}))
            words = "not finite|NaN"
        else:
            count = 1_000_000
            lines = re.sub(rb"element vertex \d+", b"element vertex %d" % count, header)
            lines = re.sub(rb"property uchar inside\n", b"", lines)
            path.write_bytes(lines + b"end_header\n" + np.zeros((count, 3), "<f4").tobytes())
            words = "distinct"
        kinds.append((path.stem, words))
    return dict(kinds)


def fell(name: str, stop: threading.Event) -> None:
    """Make every process fall that has a file open whose name has this in it: its reader dies of it."""
    while not stop.wait(0.05):
        for process in filter(str.isdigit, os.listdir("/proc")):
            with suppress(OSError):  # it has ended meanwhile
                if any(name in os.readlink(link) for link in os.scandir(f"/proc/{process}/fd")):
                    os.kill(int(process), signal.SIGSEGV)


def check_poison(folder: Path, work: Path, count: int = 450) -> None:
    clean, mixed = work / "clean_scans", work / "mixed_scans"
    paths = write_rescans(folder, clean, count)
    shutil.copytree(clean, mixed)
    wanted = poison(mixed, paths[0])
    bad = [str(mixed / f"{name}.ply") for name in wanted]
    listed = ",".join(f"'{path}'" for path in [str(mixed), *bad])
    settings = (*LEAN, "scan.read_seconds=20")
    run(clean, work / "clean", *settings)
    stop = threading.Event()
    feller = threading.Thread(target=fell, args=("bad_dies", stop))
    feller.start()
    done = subprocess.run(
        [*command(mixed, work / "mixed", *settings), f"scans=[{listed}]"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    stop.set()
    feller.join()
    print("\n".join(done.stdout.splitlines()[-12:]))
    rows = {row["scan"]: row for row in content(work / "mixed" / "summary.csv")}  # type: ignore[union-attr]
    names = [path.stem for path in paths]
    differ = differing(work / "clean", work / "mixed", names)
    wrong = [
        f"{name}: {rows[name]['status']}, {rows[name]['reason']}"
        for name, words in wanted.items()
        if rows[name]["status"] != "failed" or not re.search(words, rows[name]["reason"])
    ]
    states = Counter(row["status"] for row in rows.values())
    said = Counter(name for name in wanted if done.stderr.count(f"{name}.") + done.stderr.count(f"{name}:") > 1)
    print(f"rows: {dict(states)}; good scans that differ from the clean run: {len(differ)} {differ[:3]}")
    print(f"bad files without their true reason: {len(wrong)} {wrong[:5]}; said more than once: {len(said)}")


def check_shards(folder: Path, work: Path, shards: int = 16, count: int = 64) -> None:
    scans = work / "shard_scans"
    write_rescans(folder, scans, count)
    run(scans, work / "one", *LEAN)
    for k in range(1, shards + 1):
        run(scans, work / "parts", *LEAN, f"dataset.shard={k}/{shards}")
    subprocess.run([sys.executable, "-m", "brafit.cli.collect", str(work / "parts")], check=True, capture_output=True)
    same = content(work / "one" / "summary.csv") == content(work / "parts" / "summary.csv")
    names = [path.name for path in (work / "one").iterdir() if path.is_dir()]
    differ = differing(work / "one", work / "parts", names)
    table = "identical" if same else "DIFFERENT"
    print(f"{shards} shards collected, table {table}; scans' files differing: {len(differ)}")


def peak_memory(arguments: Sequence[str]) -> tuple[float, float]:
    """Peak of what a command's whole process tree holds in memory of its own (MiB), and its wall time.

    The code of libraries is left out: how much of it counts depends on what else runs on the machine.
    """
    begun = time.monotonic()
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    peak = 0.0
    stop = threading.Event()

    def watch() -> None:
        nonlocal peak
        while not stop.wait(0.5):
            peak = max(peak, sum(map(_share, _tree(process.pid))))

    watcher = threading.Thread(target=watch)
    watcher.start()
    process.wait()
    stop.set()
    watcher.join()
    return peak, time.monotonic() - begun


def _tree(root: int) -> Iterator[int]:
    yield root
    try:
        children = Path(f"/proc/{root}/task/{root}/children").read_text().split()
    except OSError:
        return
    for child in children:
        yield from _tree(int(child))


def _share(pid: int) -> float:
    try:
        return int(re.search(r"^Pss_Anon:\s+(\d+)", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.M)[1]) / 1024  # type: ignore[index]
    except (OSError, TypeError):
        return 0.0


def check_memory(folder: Path, work: Path) -> None:
    peaks = []
    for count in (200, 2000):
        scans = work / f"scans_{count}"
        write_rescans(folder, scans, count)
        peak, seconds = peak_memory(command(scans, work / f"memory_{count}", *LEAN))
        peaks.append(peak)
        print(f"{count} scans: peak of all processes {peak:.0f} MiB in {seconds:.0f} s")
    print(f"2,000 scans against 200: {peaks[1] / peaks[0]:.3f}")


def check_cluster(folder: Path, work: Path, shards: int = 6, count: int = 60) -> None:
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]  # the extra "ray"

    scans = work / "scans"
    write_rescans(folder, scans, count)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    other = cluster.add_node(num_cpus=1)
    listed = ",".join(f"{k}/{shards}" for k in range(1, shards + 1))
    sweep = ["-m", "hydra/launcher=ray", f"hydra.launcher.ray.init.address='{cluster.address}'"]
    sweep += ["hydra.launcher.ray.remote.num_cpus=1", f"dataset.shard={listed}"]
    process = subprocess.Popen([*command(scans, work / "sweep", *LEAN), *sweep], stdout=subprocess.DEVNULL)
    while len(list((work / "sweep").glob("*/*/fit.json"))) < count // 4 and process.poll() is None:
        time.sleep(1)
    cluster.remove_node(other, allow_graceful=False)
    print(f"one of two nodes killed after {len(list((work / 'sweep').glob('*/*/fit.json')))} scans", flush=True)
    cluster.add_node(num_cpus=1)
    process.wait()
    cluster.shutdown()
    rows = content(work / "sweep" / "sweep.csv")
    states = Counter(row["status"] for row in rows)  # type: ignore[union-attr]
    print(f"exit status {process.returncode}, rows of {shards} jobs: {dict(states)} of {count} scans")


PARTS = {"kill": check_kill, "poison": check_poison, "shards": check_shards, "memory": check_memory}
MORE = {"cluster": check_cluster}
"""Those that need more packages than brafit itself."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default=",".join(PARTS), help="parts, by commas")
    parser.add_argument("--work", type=Path, help="where the runs go; a temporary folder if not given")
    given = parser.parse_args()
    for part in given.only.split(","):
        if given.work is not None:
            given.work.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=given.work) as folder:
            print(f"== {part}", flush=True)
            (PARTS | MORE)[part](given.folder.resolve(), Path(folder))


if __name__ == "__main__":
    main()
