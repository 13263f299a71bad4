"""Readers in a process of their own: what crashes or hangs there costs one scan, not the run.

The process is started once and kept; after a crash or at the end of the time limit it is replaced. It is a plain
`python -m brafit.cloud.worker`, so callers need no `__main__` guard.

Protocol, both ways: eight bytes of length, then a pickle. A request is (reader, path, arguments), where the reader is
the name of one of `_readers` or a pickled `Reader`; a reply is ("ok", columns) or (kind of error, message).
"""

from __future__ import annotations

import atexit
import contextlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from queue import Empty, Queue
from typing import Any, BinaryIO

import numpy as np

from brafit.cloud.reader import Reader, read_columns
from brafit.cloud.refusal import RefusedError
from brafit.errors import BrafitError
from brafit.naming import plain_path
from brafit.processes import limit_memory

START_SECONDS = 120.0
"""For the process to start and load its libraries."""

_lock = threading.RLock()
_child: _Child | None = None


class ReaderError(ValueError):
    """A reader crashed, took too long or ran out of memory; the message is a short reason."""


def read_apart(reader: str | Reader, path: Path, seconds: float, **arguments: Any) -> dict[str, np.ndarray]:
    """Columns of a file, read in the other process, by one of `_readers` or another reader.

    A reader whose class only this process knows (of its main module) reads here.

    Raises:
        ReaderError: the reader crashed, took longer than `seconds` or needed too much memory.
        RefusedError: the file is sound, but of a kind that is not read.
        ValueError: the file is damaged; short reason.
        OSError: the file cannot be read.
        BrafitError: a library is missing.
    """
    global _child
    if type(reader).__module__ == "__main__":
        return read_here(reader, path, **arguments)
    called = reader if isinstance(reader, str) else pickle.dumps(reader)
    with _lock:
        if _child is None or _child.owner != os.getpid() or not _child.alive() or _child.paths != _import_paths():
            _child = _Child()
        try:
            kind, content = _child.ask(
                (called, str(path.absolute()), arguments), seconds
            )  # the child has its own folder
        except (EOFError, OSError, TimeoutError) as error:
            ending = _child.end()
            _child = None
            if isinstance(error, TimeoutError):
                raise ReaderError(f"reading it took longer than {seconds:g} s") from None
            raise ReaderError(f"its reader crashed on it, {ending}") from None
    return _taken(kind, content)


def read_here(reader: str | Reader, path: Path, **arguments: Any) -> dict[str, np.ndarray]:
    """As `read_apart`, but in this very process and without a time limit: a crash ends it. For processes that are
    guarded themselves.
    """
    function = _readers()[reader] if isinstance(reader, str) else partial(read_columns, reader=reader)
    return _taken(*_answer(function, path, arguments))


def _taken(kind: str, content: Any) -> dict[str, np.ndarray]:
    """The columns of an answer; an error as what it was."""
    if kind == "ok":
        return content
    if kind == "os":
        raise OSError(*content)
    if kind == "refused":
        raise RefusedError(*content)
    raise {"memory": ReaderError, "library": BrafitError}.get(kind, ValueError)(content)


def _answer(reader: Callable[..., dict[str, np.ndarray]], path: Path, arguments: dict[str, Any]) -> tuple[str, Any]:
    """What a reader makes of a file: kind and content of a reply."""
    try:
        with plain_path(path) as plain:
            return "ok", reader(plain, **arguments)
    except MemoryError:
        return "memory", "it needs more memory than there is"
    except RefusedError as error:
        return "refused", (error.cause, error.remedy)
    except BrafitError as error:
        return "library", str(error)
    except OSError as error:
        return "os", (error.errno, error.strerror)
    except Exception as error:
        return "value", " ".join(str(error).split())[:200] or type(error).__name__


class _Child:
    """The other process and the thread that listens to it."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.paths = _import_paths()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "brafit.cloud.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(self.paths)},
        )
        self._replies: Queue[Any] = Queue()
        threading.Thread(target=self._listen, daemon=True).start()
        if self._reply(START_SECONDS)[0] != "ready":
            raise EOFError

    def alive(self) -> bool:
        return self._process.poll() is None

    def ask(self, request: tuple, seconds: float) -> tuple[str, Any]:
        assert self._process.stdin is not None
        _send(self._process.stdin, request)
        return self._reply(seconds)

    def end(self) -> str:
        """End the process; how it had ended before, in words."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        code = self._process.poll()
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                assert pipe is not None
                pipe.close()
        return "it did not end" if code is None else f"signal {-code}" if code < 0 else f"exit status {code}"

    def _reply(self, seconds: float) -> tuple[str, Any]:
        try:
            reply = self._replies.get(timeout=seconds)
        except Empty:
            raise TimeoutError from None
        if reply is None:
            raise EOFError
        return reply

    def _listen(self) -> None:
        assert self._process.stdout is not None
        while True:
            try:
                reply = _receive(self._process.stdout)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                self._replies.put(None)
                return
            self._replies.put(reply)


@atexit.register
def _stop() -> None:
    global _child
    if _child is not None and _child.owner == os.getpid():
        _child._process.kill()
        _child.end()
    _child = None


def _send(pipe: BinaryIO | Any, content: Any) -> None:
    data = pickle.dumps(content, protocol=5)
    pipe.write(len(data).to_bytes(8, "little"))
    pipe.write(data)
    pipe.flush()


def _receive(pipe: BinaryIO | Any) -> Any:
    head = pipe.read(8)
    if len(head) < 8:
        raise EOFError
    size = int.from_bytes(head, "little")
    data = pipe.read(size)
    if len(data) < size:
        raise EOFError
    return pickle.loads(data)


def _readers() -> dict[str, Callable[..., dict[str, np.ndarray]]]:
    from brafit.cloud.arrays import read_arrays
    from brafit.cloud.mesh import read_mesh
    from brafit.cloud.pcd import read_pcd
    from brafit.cloud.text import read_text

    return {"mesh": read_mesh, "text": read_text, "pcd": read_pcd, "arrays": read_arrays}


def _import_paths() -> tuple[str, ...]:
    """Where this process looks for modules, so that the other one finds a reader's."""
    root = str(Path(__file__).resolve().parents[2])
    return (root, *(path or os.getcwd() for path in sys.path if os.pathsep not in path))


def _other(reader: bytes) -> Callable[..., dict[str, np.ndarray]]:
    """What reads, of a pickled `Reader`."""
    found = pickle.loads(reader)
    return partial(read_columns, reader=found)


def _serve() -> None:
    requests = sys.stdin.buffer
    # What libraries print must not get between the replies.
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    readers = _readers()
    limit_memory()
    _send(replies, ("ready", None))
    while True:
        try:
            reader, path, arguments = _receive(requests)
        except EOFError:
            return
        try:
            function = readers[reader] if isinstance(reader, str) else _other(reader)
        except Exception as error:
            _send(replies, ("library", f"its reader cannot be imported in another process ({error})"))
            continue
        _send(replies, _answer(function, Path(path), arguments))


if __name__ == "__main__":
    _serve()
