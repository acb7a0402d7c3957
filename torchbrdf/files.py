"""Writing files whole or not at all: text, JSON, CSV."""

import csv
import hashlib
import io
import json
import logging
import math
import os
import platform
import re
import secrets
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError

# A temporary file says who writes it: a digest of the machine, the process, and a number of its own.
_TEMPORARY = re.compile(r"\.tmp-(?P<machine>[0-9a-f]{8})-(?P<pid>\d+)-[0-9a-f]{8}(\..*)?")
# Seconds after which a temporary file that nobody has written to is nobody's, whatever its name says.
_ABANDONED = 86_400
# Seconds of waiting for a lock before it is said.
_PATIENCE = 1.0
LOCK = ".lock"
"""The file, in a folder, that whoever writes there holds locked."""

_live: set[str] = set()  # temporary files and locks of this process
_noting: list[dict[Path, None]] = []  # for each `noting_replaced` that is going on, the files that were there before
_swept: set[Path] = set()  # folders that it has looked for leftovers in


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, that takes its place when the block ends without an error.

    No two writers have the same one. What processes that were killed have left in the folder is removed first. Where
    `path` is a link, all of this is so for the file that it leads to, and the link stays.

    Raises:
        DataError: It is a device, a FIFO or a folder, or cannot be written, whatever the library that writes says of a
            full disk.
    """
    path, target = Path(path), destination(path)
    suffix = path.suffix if len(path.suffix) < 32 else ""
    temporary = target.with_name(f".tmp-{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}")
    _live.add(temporary.name)
    try:
        _note_missing(target.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(target.parent)
        temporary.touch()
        yield temporary
        was_there = bool(_noting) and target.name not in _live and target.exists()
        temporary.replace(target)
        if was_there:
            _noting[-1][path] = None
    except (OSError, RuntimeError) as error:  # OpenEXR and torch have no other words for a full disk
        raise DataError(f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})") from error
    finally:
        _live.discard(temporary.name)
        with suppress(OSError):  # the folder is no folder, or gone
            temporary.unlink(missing_ok=True)


@contextmanager
def noting_replaced() -> Iterator[list[Path]]:
    """A list that has, at the end of the block, the files that were there before and were replaced within it.

    Example:
        >>> from torchbrdf.files import noting_replaced, write_text
        >>> with noting_replaced() as replaced:
        ...     write_text("new.txt", "a")
        ...     write_text("new.txt", "b")
        >>> [path.name for path in replaced]
        ['new.txt']
    """
    found: list[Path] = []
    _noting.append({})
    try:
        yield found
    finally:
        found += _noting.pop()


def destination(path: Path | str) -> Path:
    """Where a file of this name is written: itself, or where it leads to if it is a link, also to nothing yet.

    Raises:
        DataError: Something is there that is no regular file, such as a device, which a new file would replace.
    """
    path = Path(path)
    _expect(path, stat.S_IFREG)
    return Path(os.path.realpath(path)) if path.is_symlink() else path


# What is at a path, for people.
_KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def _expect(path: Path, kind: int) -> None:
    """A DataError if something is at a path, or where it leads to, that is not of this kind."""
    try:
        found = stat.S_IFMT(path.stat().st_mode)
    except (FileNotFoundError, NotADirectoryError):  # a new name, or one that whoever writes finds to be none
        return
    except (OSError, ValueError) as error:  # links in a circle; a NUL
        raise DataError(f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})") from None
    if found != kind:
        raise DataError(f"{path}: expected {_KINDS[kind]} or a new name, found {_KINDS.get(found, 'something else')}")


def is_writing() -> bool:
    """Whether this process has a temporary file or a lock, which it is to remove before it ends."""
    return bool(_live)


@cache
def _machine() -> str:
    """This machine, since it was started, and its processes' numbers: those of another say nothing here."""
    told = [platform.node()]
    with suppress(OSError):  # Linux has these
        told.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
        told.append(str(Path("/proc/self/ns/pid").readlink()))
    return hashlib.sha256("\n".join(told).encode()).hexdigest()[:8]


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files of processes that are gone, once for each folder.

    Those of another machine, which may share the folder, are removed when they are a day old.
    """
    folder = folder.absolute()
    if folder in _swept:
        return
    _swept.add(folder)
    for path in folder.glob(".tmp-*"):
        found = _TEMPORARY.fullmatch(path.name)
        if found:
            with suppress(OSError):  # another writer was faster
                if _is_left(path, found["machine"], int(found["pid"])):
                    path.unlink(missing_ok=True)


def _is_left(path: Path, machine: str, pid: int) -> bool:
    import psutil

    written = path.stat().st_mtime
    if time.time() - written > _ABANDONED:
        return True
    if machine != _machine():
        return False
    if pid == os.getpid():
        return path.name not in _live
    try:  # a process that is younger than the file has got the number of the one that wrote it
        return bool(psutil.Process(pid).create_time() > written + 1)
    except psutil.NoSuchProcess:
        return True
    except psutil.AccessDenied:
        return False


@contextmanager
def locked(folder: Path | str, wait: float = 0.0) -> Iterator[None]:
    """Hold a folder's lock: no other process, or thread, that asks for it is in its block at the same time.

    The system lets go of it when a process ends, however that is; the file `.lock` says nothing by being there.

    Args:
        folder: Made, if it is not there.
        wait: For how many seconds to wait for another; after the first of them the log says so.

    Raises:
        DataError: Another process holds the lock, or the folder cannot be written.
    """
    import filelock

    path = writable(folder) / LOCK
    lock = filelock.FileLock(path)
    try:
        try:
            lock.acquire(timeout=min(wait, _PATIENCE))
        except filelock.Timeout:
            if wait > _PATIENCE:
                logging.getLogger("torchbrdf").warning("torchbrdf: %s: waiting for another process", folder)
            lock.acquire(timeout=max(wait - _PATIENCE, 0.0))
    except filelock.Timeout:
        waited = f" for {wait:g} s" if wait else ""
        raise DataError(
            f"{folder}: another process has been at work in it{waited}; wait for its end, or choose another folder"
        ) from None
    except OSError as error:
        raise DataError(f"{path}: cannot be locked ({error.strerror or error})") from None
    held = str(path)
    _live.add(held)
    try:
        yield
    finally:
        if os.name == "posix":  # those that wait see that it is gone, and make a new one
            path.unlink(missing_ok=True)
        lock.release()
        _live.discard(held)


def is_passing(path: Path) -> bool:
    """Whether a file is one of those that come and go while a folder is written: a lock, or a temporary one."""
    return path.name == LOCK or _TEMPORARY.fullmatch(path.name) is not None


# Folders that were made, in the order in which they were, of each block that asks.
_made: list[list[Path]] = []


@contextmanager
def without_empty_folders() -> Iterator[None]:
    """Remove in the end the folders that this module made within and that are empty: nothing came of the work."""
    _made.append([])
    try:
        yield
    finally:
        for path in reversed(_made.pop()):
            with suppress(OSError):  # it is not empty, or gone
                path.rmdir()


def _note_missing(folder: Path) -> None:
    """Remember which folders are about to be made."""
    if _made:
        there = Path(os.path.realpath(folder))  # a link may lead to one that is still to be made
        _made[-1] += reversed([path for path in (there, *there.parents) if not path.exists()])


def writable(folder: Path | str) -> Path:
    """The folder, made if need be; a DataError now rather than after the work if nothing can be written there."""
    folder = Path(folder)
    _expect(folder, stat.S_IFDIR)
    _note_missing(folder)
    try:
        if folder.is_symlink():  # also to a folder that is still to be made
            Path(os.path.realpath(folder)).mkdir(parents=True, exist_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise DataError(f"{folder}: cannot be written ({error.strerror})") from None


def writable_file(path: Path | str) -> Path:
    """The path; a DataError now rather than after the work if no file can be written there."""
    writable(destination(path).parent)
    return Path(path)


def write_text(path: Path | str, text: str) -> None:
    """Write a text file whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a file whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: Path | str, value: object) -> None:
    """Write a value as indented JSON, whole or not at all; a number that is not finite is null."""
    write_text(path, json_text(value))


def json_text(value: object) -> str:
    """What `write_json` writes."""
    return json.dumps(finite(value), indent=1, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """A value with None for every number in it that is not finite, which JSON has no word for."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def csv_text(rows: Iterable[Mapping[str, Any]]) -> str:
    r"""Rows as CSV: a line a row, a column for each key that any row has, in the order in which they first appear.

    A text that a spreadsheet would take for a formula gets an apostrophe before it, as `quoted` has it.

    Example:
        >>> csv_text([{"name": "nickel", "error": 0.5}, {"name": "nylon"}])
        'name,error\nnickel,0.5\nnylon,\n'
    """
    rows = list(rows)
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: quoted(value) for key, value in row.items()} for row in rows)
    return text.getvalue()


# What spreadsheets take for a formula, and what was written for one: so `unquoted` always finds the same text.
_FORMULA = re.compile(r"'*[=+\-@\t\r]")


def quoted(value: Any) -> Any:
    """A cell of a CSV file: a text that spreadsheets would run as a formula with an apostrophe before it.

    Source: OWASP, CSV Injection, https://owasp.org/www-community/attacks/CSV_Injection.

    Example:
        >>> quoted("=1+1"), quoted("nickel"), quoted(-1.5)
        ("'=1+1", 'nickel', -1.5)
    """
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def unquoted(text: str) -> str:
    """The text that `quoted` made a cell of.

    Example:
        >>> unquoted("'=1+1"), unquoted("nickel"), unquoted(quoted("'=1"))
        ('=1+1', 'nickel', "'=1")
    """
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def write_csv(path: Path | str, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows as CSV, as `csv_text` has them, whole or not at all."""
    write_text(path, csv_text(rows))
