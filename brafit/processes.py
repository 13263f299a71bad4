"""Processes that work for this one. What crashes, hangs or eats all memory in one of them costs its own task alone.

A `Pool` has a number of processes; each does one call at a time, may report while it runs, and is replaced when
it dies or falls silent for too long. On Linux they are forks of one process that has imported what they need, so that a
new one is ready within milliseconds. They do not run the caller's main module again: scripts and notebooks need no
`__main__` guard.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import multiprocessing
import os
import pickle
import signal
import sys
import time
import traceback
import types
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

PATIENCE = 600.0
"""Seconds that a process may be silent, unless its call says otherwise."""
LONG = 1.0
"""Seconds of a call after which memory is given back: it takes up to a tenth of one."""
_METHOD = "forkserver" if sys.platform == "linux" else "spawn"

Function = str
"""`package.module:name`: it takes the arguments of the call, then a function that tells the caller something."""


@dataclass(frozen=True)
class Told:
    """What a call that is not finished has to tell."""

    content: Any


@dataclass(frozen=True)
class Returned:
    """What a call returned."""

    value: Any


@dataclass(frozen=True)
class Raised:
    """What a call raised, and where."""

    error: Exception
    trace: str


@dataclass(frozen=True)
class Lost:
    """A call whose process is gone.

    Attributes:
        reason: how it ended, in a few words.
        killed: something else ended it, most likely for want of memory: the call may be innocent.
        late: it had not ended, but was silent for too long.
    """

    reason: str
    killed: bool = False
    late: bool = False


Event = Told | Returned | Raised | Lost


class Pool:
    """Processes that do calls for this one.

    Args:
        count: how many; they are started when there is something to do.
        preload: modules that they all need.
    """

    def __init__(self, count: int, preload: Sequence[str] = ()):
        self.count = max(1, count)
        self._context = multiprocessing.get_context(_METHOD)
        if _METHOD == "forkserver":
            self._context.set_forkserver_preload(list(preload))
        self._workers: list[_Worker] = []
        _POOLS.append(self)

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def free(self) -> int:
        """Calls that can be taken now."""
        return self.count - sum(worker.key is not None for worker in self._workers)

    def submit(self, key: Hashable, function: Function, *arguments: Any, patience: float = PATIENCE) -> None:
        """Begin a call; what comes of it is told by `events` under its key.

        Args:
            key: tells this call from all others that are running.
            function: `package.module:name`.
            arguments: of the function, before the one by which it tells; what pickle can send.
            patience: seconds of silence after which it is given up.

        Raises:
            RuntimeError: no process is free.
            Exception: the arguments cannot be sent (what pickle raises).
        """
        call = pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL)
        worker = next((worker for worker in self._workers if worker.key is None), None)
        if worker is None:
            if len(self._workers) >= self.count:
                raise RuntimeError("no process is free")
            worker = _Worker(self._context)
            self._workers.append(worker)
        worker.begin(key, call, patience)

    def events(self, timeout: float | None = None) -> Iterator[tuple[Hashable, Event]]:
        """What has happened: waits for the first event, or until `timeout` seconds have passed."""
        busy = {worker.connection: worker for worker in self._workers if worker.key is not None}
        if not busy:
            return
        left = min(worker.deadline for worker in busy.values()) - time.monotonic()
        ready = wait(list(busy), max(0.0, left if timeout is None else min(left, timeout)))
        for connection, worker in busy.items():
            key = worker.key
            event = worker.hear() if connection in ready else worker.late()
            if event is None:
                continue
            if isinstance(event, Lost):
                self._workers.remove(worker)
            yield key, event

    @property
    def closed(self) -> bool:
        """Whether `close` has been called."""
        return self not in _POOLS

    def close(self) -> None:
        """End all processes, whatever they are at."""
        for worker in self._workers:
            worker.end()
        self._workers.clear()
        if self in _POOLS:
            _POOLS.remove(self)


_POOLS: list[Pool] = []


def prepare(preload: Sequence[str]) -> None:
    """Begin to import, elsewhere, what a `Pool` will need, while this process does something else.

    Args:
        preload: the modules; what a pool that is made later names beyond these is imported by each of its processes.
    """
    if _METHOD == "forkserver":
        from multiprocessing import forkserver

        forkserver.set_forkserver_preload(list(preload))
        with _no_main(), _one_thread():
            forkserver.ensure_running()


@atexit.register
def _close_all() -> None:
    for pool in list(_POOLS):
        pool.close()
    if _METHOD == "forkserver":
        from multiprocessing.forkserver import _forkserver

        pid = _forkserver._forkserver_pid  # type: ignore[attr-defined]
        if pid is not None and not multiprocessing.active_children():  # of others, that is
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)  # tidying up after its imports takes half a second and serves nobody
        with contextlib.suppress(OSError):  # its folder may be gone already
            _forkserver._stop()  # type: ignore[attr-defined]  # nothing is left behind, and its time counts as ours


class _Worker:
    """One process, and what it is at."""

    def __init__(self, context: Any):
        self.connection, other = context.Pipe()
        self._process = context.Process(target=serve, args=(other,), daemon=True)
        with _no_main(), _one_thread():
            self._process.start()
        other.close()
        self.key: Hashable | None = None
        self.deadline = 0.0
        self._patience = PATIENCE

    def begin(self, key: Hashable, call: bytes, patience: float) -> None:
        self.key, self._patience = key, patience
        self.deadline = time.monotonic() + patience
        with contextlib.suppress(OSError):  # it died while idle: `hear` will find out
            self.connection.send_bytes(call)

    def hear(self) -> Event:
        try:
            kind, content = pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError, pickle.UnpicklingError):
            return self._lost()
        self.deadline = time.monotonic() + self._patience
        if kind == "told":
            return Told(content)
        self.key = None
        return Returned(content) if kind == "returned" else Raised(*content)

    def late(self) -> Event | None:
        if time.monotonic() < self.deadline:
            return None
        self.end()
        return Lost(f"took longer than {self._patience:g} s", late=True)

    def _lost(self) -> Lost:
        self._process.join(5.0)
        code = self._process.exitcode
        self.end()
        if code is None:
            return Lost("stopped answering")
        if code >= 0:
            return Lost(f"ended with exit status {code}")
        with contextlib.suppress(ValueError):
            name = signal.Signals(-code).name
            if -code == signal.SIGKILL:
                return Lost(f"was killed ({name}), most likely for want of memory", killed=True)
            return Lost(f"crashed ({name})")
        return Lost(f"crashed (signal {-code})")

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self.connection.close()


@contextlib.contextmanager
def _no_main() -> Iterator[None]:
    """Keep `multiprocessing` from passing on to the new process what is the caller's own: its main module, which would
    be run again, and its way of starting processes, which may be known to its libraries only.
    """
    main, method = sys.modules["__main__"], multiprocessing.get_start_method(allow_none=True)
    sys.modules["__main__"] = types.ModuleType("__main__")
    multiprocessing.set_start_method(_METHOD, force=True)
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        multiprocessing.set_start_method(method, force=True)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """One thread a process: more would wait for each other thousands of times, ever longer on a busy machine."""
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = before


def serve(connection: Connection) -> None:
    """Do calls until the other side is gone. This runs in the new process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever sent for it decides what an interrupt means
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.dup2(2, 1)  # the output is the caller's
    gc.freeze()  # what is imported stays: it need not be looked through again and again
    gc.enable()
    limit_memory()
    _end_with_parent()

    def tell(content: Any) -> None:
        connection.send_bytes(pickle.dumps(("told", content), pickle.HIGHEST_PROTOCOL))

    with contextlib.suppress(EOFError, OSError):
        while True:
            name, arguments = pickle.loads(connection.recv_bytes())
            begun = time.monotonic()
            connection.send_bytes(_done(name, arguments, tell))
            if time.monotonic() - begun > LONG:
                give_back_memory()


def _done(name: Function, arguments: tuple, tell: Callable[[Any], None]) -> bytes:
    try:
        module, _, function = name.partition(":")
        value = getattr(importlib.import_module(module), function)(*arguments, tell)
        return pickle.dumps(("returned", value), pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        trace = traceback.format_exc()
        try:
            data = pickle.dumps(("raised", (error, trace)), pickle.HIGHEST_PROTOCOL)
            pickle.loads(data)
        except Exception:  # an error of a kind that cannot be sent
            plain = RuntimeError(f"{type(error).__name__}: {error}")
            data = pickle.dumps(("raised", (plain, trace)), pickle.HIGHEST_PROTOCOL)
        return data


def _end_with_parent() -> None:
    """Do not go on for nobody where the caller is killed: then the process that this one was forked from ends."""
    if sys.platform == "linux":
        import ctypes

        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


def give_back_memory() -> None:
    """Hand to the system what is free between what is in use: the C library keeps it, and needs more of it with every
    call that is as large.
    """
    if sys.platform == "linux":
        import ctypes

        with contextlib.suppress(AttributeError):  # a C library without it
            ctypes.CDLL(None).malloc_trim(0)


def limit_memory() -> None:
    """No more than the machine has: a damaged count must not bring it down."""
    try:
        import resource

        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        resource.setrlimit(resource.RLIMIT_AS, (total, resource.getrlimit(resource.RLIMIT_AS)[1]))
    except (ImportError, ValueError, OSError):  # not on every system
        return
