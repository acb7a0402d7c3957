"""A SQLite file that many threads write into at once: what is written is on the disk, and soon in the file itself."""

import logging
import os
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from torchbrdf.errors import DataError

T = TypeVar("T")

# How long a write waits for that of another process, in seconds; and how long after that nobody waits any more, so that
# a file that stays locked does not hold up threads that could serve what needs no write.
PATIENCE = 0.5
SHUT = 1.0
# Seconds between checkpoints, while there are writes.
PAUSE = 0.2

log = logging.getLogger("torchbrdf")


class Database:
    """A file of tables; any number of threads and processes may use it at once.

    It is in SQLite's mode WAL: a write waits for the disk once (5 ms where a rollback journal takes 25), and does not
    keep readers waiting, nor does the lock of another process. Writes go into a log beside the file, and from there
    into the file at a checkpoint.
    """

    def __init__(self, path: Path | str, schema: str) -> None:
        self.path = Path(path)
        self._own = threading.local()
        self._opened: list[sqlite3.Connection] = []
        self._waiting: deque[tuple[Future[Any], Callable[[sqlite3.Connection], Any]]] = deque()
        self._writer = threading.Lock()
        self._written = threading.Event()
        self._shut = 0.0
        self._names = [f"{self.path}{end}" for end in ("", "-wal", "-shm")]
        self._place: list[tuple[int, int] | None] | None = None
        try:
            self.write(lambda db: [db.execute(statement) for statement in schema.split(";")])
            self.checkpoint()
        except BaseException:
            self.close()
            raise
        self._place = self._find()

    def connection(self) -> sqlite3.Connection:
        """This thread's own, to read with; a DataError if it is made when the file is not there any more."""
        found: sqlite3.Connection | None = getattr(self._own, "connection", None)
        if found is None:
            self.check_place()
            # isolation_level: transactions are those that are written here. Others' threads only ever close it.
            found = sqlite3.connect(self.path, timeout=PATIENCE, isolation_level=None, check_same_thread=False)
            try:
                found.execute("PRAGMA journal_mode = WAL")
                found.execute("PRAGMA synchronous = FULL")
                found.execute("PRAGMA foreign_keys = ON")
                self.check_place()  # or it might be another file, or a new one
            except BaseException:
                found.close()
                raise
            self._opened.append(found)
            self._own.connection = found
        return found

    def write(self, work: Callable[[sqlite3.Connection], T]) -> T:
        """Do some work in a transaction that no other write comes into.

        On the disk when this returns, undone if the work raises. What other threads want to write meanwhile is done in
        the same transaction, since the disk takes as long for one as for many.

        Raises:
            DataError: Another process has the file locked, or the file is not there any more.
        """
        mine: Future[T] = Future()
        self._waiting.append((mine, work))
        with self._writer:
            if not mine.done():
                together = [self._waiting.popleft() for _ in range(len(self._waiting))]
                self._write_all(together)
        return mine.result()

    def checkpoint(self) -> bool:
        """Bring what is written from the log into the file; False if readers keep some of it out."""
        busy, logged, moved = self.connection().execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        return not busy and logged == moved

    @contextmanager
    def checkpoints(self) -> Iterator[None]:
        """Within the block, a copy of the file alone holds all but the last moments."""
        stop = threading.Event()

        def work() -> None:
            while not stop.is_set():
                self._written.wait()
                self._written.clear()
                try:
                    if not self.checkpoint():
                        self._written.set()
                except DataError:
                    continue  # gone; writes say so
                except (sqlite3.Error, OSError) as error:  # what is written is in the log
                    log.error("%s: not brought into the file yet (%s)", self.path, error)
                stop.wait(PAUSE)

        thread = threading.Thread(target=work, name="checkpoints", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            self._written.set()
            thread.join()

    def check_place(self) -> None:
        """A DataError if the file was removed or replaced: what is written then is lost when the process ends."""
        if self._place is not None and self._place != self._find():
            raise DataError(
                f"{self.path}: removed or replaced while in use, so nothing is recorded; put it back, or start again"
            )

    def close(self) -> None:
        """Close the connections of all threads; none may be at work."""
        if self._place is not None and self._place == self._find():
            with suppress(sqlite3.Error):  # then the log stays beside the file
                # The last connection's end does so too, but another process may have the file open.
                self.connection().execute("PRAGMA wal_checkpoint(TRUNCATE)")
        for connection in self._opened:
            connection.close()
        self._opened.clear()
        self._own = threading.local()

    def _write_all(self, together: list[tuple[Future[Any], Callable[[sqlite3.Connection], Any]]]) -> None:
        """One transaction; whoever waits for a part of it hears only when all of it is on the disk."""
        heard: list[Callable[[], None]] = []
        try:
            with self._transaction() as db:
                for future, work in together:
                    heard.append(_attempt(db, future, work))
            self.check_place()
        except BaseException as error:
            for future, _ in together:
                future.set_exception(error)
            if not isinstance(error, Exception):
                raise
            return
        self._written.set()
        for tell in heard:
            tell()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        if time.monotonic() < self._shut:
            raise DataError(f"{self.path}: another process has it locked")
        self.check_place()
        db = self.connection()
        try:
            db.execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY:
                raise
            self._shut = time.monotonic() + SHUT
            raise DataError(f"{self.path}: another process has it locked") from None
        try:
            yield db
            db.execute("COMMIT")
        finally:
            if db.in_transaction:
                db.execute("ROLLBACK")

    def _find(self) -> list[tuple[int, int] | None]:
        """What is at the names of the file, its log, and the log's index now."""
        found: list[tuple[int, int] | None] = []
        for name in self._names:
            try:
                status = os.stat(name)  # noqa: PTH116 (asked before each use, and a Path takes ten times as long)
            except FileNotFoundError:
                found.append(None)
            else:
                emptied = not found and not status.st_size
                found.append(None if emptied else (status.st_dev, status.st_ino))
        return found


def _attempt(db: sqlite3.Connection, future: Future[T], work: Callable[[sqlite3.Connection], T]) -> Callable[[], None]:
    """Do one of several pieces of work in a transaction, or none of it; gives what tells of it."""
    db.execute("SAVEPOINT piece")
    try:
        result = work(db)
    except Exception as error:
        failed = error
        db.execute("ROLLBACK TO piece")
        db.execute("RELEASE piece")
        return lambda: future.set_exception(failed)
    db.execute("RELEASE piece")
    return lambda: future.set_result(result)
