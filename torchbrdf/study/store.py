"""Observers and their answers in a SQLite file: what is acknowledged is on the disk, and nothing is there twice."""

import hashlib
import json
import secrets
import sqlite3
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec

from torchbrdf.errors import DataError, UsageError
from torchbrdf.reading import reading
from torchbrdf.study.answers import Answer, Kind
from torchbrdf.study.database import Database
from torchbrdf.study.design import Trial, observer_seed, trials
from torchbrdf.study.plan import PLAN, Plan

STORE = "study.sqlite"
SIDES = ("left", "right")
Stage = Literal["questions", "screen", "trials", "done", "screened"]
HELD = "the database of a study"

# What its columns hold: SQLite itself takes anything anywhere.
Side = Literal["left", "right"]
Seconds = Annotated[float, msgspec.Meta(ge=0, le=1e9)]
Seed = Annotated[str, msgspec.Meta(pattern=r"^-?[0-9]{1,1000}$")]
T = TypeVar("T")

SCHEMA = """
CREATE TABLE IF NOT EXISTS plans (experiment TEXT PRIMARY KEY, fingerprint TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS observers (
    id INTEGER PRIMARY KEY,
    token TEXT NOT NULL UNIQUE,
    experiment TEXT NOT NULL,
    number INTEGER NOT NULL,
    seed TEXT NOT NULL,
    trials INTEGER NOT NULL,
    consented TEXT NOT NULL,
    reports TEXT,
    let_in INTEGER,
    screen TEXT,
    UNIQUE (experiment, number)
);
CREATE TABLE IF NOT EXISTS trials (
    observer INTEGER NOT NULL REFERENCES observers,
    position INTEGER NOT NULL,
    material TEXT NOT NULL,
    left TEXT NOT NULL,
    right TEXT NOT NULL,
    kind TEXT NOT NULL,
    PRIMARY KEY (observer, position)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS answers (
    observer INTEGER NOT NULL,
    position INTEGER NOT NULL,
    side TEXT NOT NULL CHECK (side IN ('left', 'right')),
    response_time REAL NOT NULL,
    time_stamp TEXT NOT NULL,
    PRIMARY KEY (observer, position),
    FOREIGN KEY (observer, position) REFERENCES trials
) WITHOUT ROWID;
"""


class UnknownObserverError(UsageError):
    """Error: a link that nobody was given."""


class NotNowError(UsageError):
    """Error: something that is not what an observer is to do now, such as an answer given before."""


class FullError(UsageError):
    """Error: someone who wants to begin when as many as may have begun."""


class IneligibleError(UsageError):
    """Error: a trial for someone whose self-reports screen them out."""


@dataclass(frozen=True)
class State:
    """Where an observer is: `position` trials of `trials` are answered, and `stage` is what comes next."""

    observer: int
    stage: Stage
    position: int
    trials: int


class Store:
    """The database of a study; any number of threads and processes may use it at once.

    A DataError if the file is something else, cannot be written, or has observers of an experiment whose materials or
    stimuli are others in the plan.
    """

    def __init__(self, path: Path | str, plan: Plan) -> None:
        self.path, self.plan = Path(path), plan
        # Trials are fixed, and each is asked for once for each of its pictures.
        self._trial = lru_cache(maxsize=10_000)(self._read_trial)
        with reading(self.path, f"{HELD} that can be written"):
            self._database = Database(self.path, SCHEMA)
        try:
            for (name,) in self._read("SELECT experiment FROM plans", tuple[str]):
                with reading(self.path, HELD):
                    self._check(self._database.connection(), name)
        except BaseException:
            self.close()
            raise

    def begin(self, experiment: str, most: int | None = None) -> str:
        """Begin with a new observer, who has consented: gives the token of their link. Their trials are fixed now.

        A FullError if `most` observers of the experiment have begun.
        """
        asked = self.plan.experiment(experiment)
        token = secrets.token_urlsafe(16)

        def record(db: sqlite3.Connection) -> str:
            db.execute("INSERT OR IGNORE INTO plans VALUES (?, ?)", (experiment, fingerprint(self.plan, experiment)))
            self._check(db, experiment)
            (number,) = db.execute("SELECT COUNT(*) FROM observers WHERE experiment = ?", (experiment,)).fetchone()
            if most is not None and number >= most:
                raise FullError(f"{number} observers have begun, as many as may")
            shown = trials(self.plan, asked, number)
            # As text, since a seed may be beyond 64 bits.
            row = (token, experiment, number, str(observer_seed(self.plan, number)), len(shown), now())
            made = db.execute(
                "INSERT INTO observers (token, experiment, number, seed, trials, consented) VALUES (?, ?, ?, ?, ?, ?)",
                row,
            )
            db.executemany(
                "INSERT INTO trials VALUES (?, ?, ?, ?, ?, ?)",
                [(made.lastrowid, k, one.material, one.left, one.right, one.kind) for k, one in enumerate(shown)],
            )
            return token

        return self._database.write(record)

    def state(self, token: str) -> State:
        """State of an observer, by their link's token."""
        return self._state(self._database.connection(), token)

    def trial(self, state: State, position: int) -> Trial:
        """A trial of an observer; positions count from 0."""
        return self._trial(state.observer, position)

    def report(self, token: str, reports: Mapping[str, Any], eligible: bool) -> State:
        """Record what an observer says about themselves, once, and whether that lets them in."""

        def record(db: sqlite3.Connection) -> State:
            state = self._state(db, token)
            if state.stage != "questions":
                raise NotNowError("the questions are answered already")
            db.execute(
                "UPDATE observers SET reports = ?, let_in = ? WHERE id = ?",
                (json.dumps(reports), eligible, state.observer),
            )
            return replace(state, stage="screen" if eligible else "screened")

        return self._database.write(record)

    def record_screen(self, token: str, screen: Mapping[str, Any]) -> State:
        """Record what an observer's screen is like, once."""

        def record(db: sqlite3.Connection) -> State:
            state = self._state(db, token)
            if state.stage != "screen":
                raise NotNowError("the screen is not to be checked now")
            db.execute("UPDATE observers SET screen = ? WHERE id = ?", (json.dumps(screen), state.observer))
            return replace(state, stage="trials")

        return self._database.write(record)

    def answer(self, token: str, position: int, side: str, response_time: float) -> State:
        """Record the answer to an observer's current trial, and no other; gives the state after it.

        When this returns, the answer is on the disk.
        """
        if side not in SIDES:
            raise UsageError(f"side: expected left or right, found {side!r}")

        def record(db: sqlite3.Connection) -> State:
            state = self._state(db, token)
            if state.stage == "screened":
                raise IneligibleError("there are no trials for you")
            if state.stage != "trials" or position != state.position:
                raise NotNowError("this is not the trial to answer now")
            row = (state.observer, position, side, float(response_time), now())
            db.execute("INSERT INTO answers VALUES (?, ?, ?, ?, ?)", row)
            answered = position + 1
            return replace(state, position=answered, stage="trials" if answered < state.trials else "done")

        return self._database.write(record)

    def answers(self, experiment: str | None = None) -> list[Answer]:
        """All answers, observer by observer, each in the order given; of one experiment, or of all."""
        rows = self._read(
            "SELECT observers.id, experiment, material, left, right, side, response_time, time_stamp, seed, kind"
            " FROM answers JOIN observers ON observers.id = answers.observer"
            " JOIN trials ON trials.observer = answers.observer AND trials.position = answers.position"
            " WHERE ? IS NULL OR experiment = ? ORDER BY observers.id, answers.position",
            tuple[int, str, str, str, str, Side, Seconds, str, Seed, Kind],
            (experiment, experiment),
        )
        try:
            return [
                Answer(observer_name(who), name, what, a, b, a if side == "left" else b, time, stamp, int(seed), kind)
                for who, name, what, a, b, side, time, stamp, seed, kind in rows
            ]
        except DataError as error:
            raise DataError(f"{self.path}: {error}") from None

    def profiles(self) -> list[dict[str, Any]]:
        """Profiles of observers; `reports`, `screen` and `let_in` are None before they said so."""
        rows = self._read(
            "SELECT id, experiment, number, seed, consented, let_in, reports, screen, trials,"
            " (SELECT COUNT(*) FROM answers WHERE observer = observers.id) FROM observers ORDER BY id",
            tuple[int, str, int, Seed, str, int | None, str | None, str | None, int, int],
        )
        return [
            {
                "observer": observer_name(who),
                "experiment": experiment,
                "number": number,
                "seed": int(seed),
                "consented": consented,
                "let_in": None if eligible is None else bool(eligible),
                "reports": self._said(reports),
                "screen": self._said(screen),
                "trials": count,
                "answered": answered,
            }
            for who, experiment, number, seed, consented, eligible, reports, screen, count, answered in rows
        ]

    def counts(self, experiment: str) -> tuple[int, int]:
        """Counts of an experiment's observers and of its answers."""
        ((observers, answers),) = self._read(
            "SELECT (SELECT COUNT(*) FROM observers WHERE experiment = ?), (SELECT COUNT(*) FROM answers"
            " JOIN observers ON observers.id = answers.observer WHERE experiment = ?)",
            tuple[int, int],
            (experiment, experiment),
        )
        return observers, answers

    def checkpoints(self) -> AbstractContextManager[None]:
        """Within the block, a copy of the file alone, without its log, holds all but the last moments."""
        return self._database.checkpoints()

    def check_place(self) -> None:
        """A DataError if the file was removed or replaced since it was opened."""
        self._database.check_place()

    def close(self) -> None:
        """Close the connections of all threads; none may be at work."""
        self._database.close()

    def _read_trial(self, observer: int, position: int) -> Trial:
        rows = self._read(
            "SELECT material, left, right, kind FROM trials WHERE observer = ? AND position = ?",
            tuple[str, str, str, Kind],
            (observer, position),
        )
        if not rows:
            raise DataError(f"{self.path}: expected trial {position} of {observer_name(observer)}, found none")
        return Trial(*rows[0])

    def _read(self, statement: str, kind: type[T], values: tuple[Any, ...] = ()) -> list[T]:
        """Rows of some kind; a DataError that names the file if it is damaged, or holds something else."""
        with reading(self.path, HELD):
            rows = self._database.connection().execute(statement, values).fetchall()
            return msgspec.convert(rows, list[kind])  # type: ignore[valid-type]

    def _state(self, db: sqlite3.Connection, token: str) -> State:
        with reading(self.path, HELD):
            return _state(db, token)

    def _said(self, text: str | None) -> Any:
        """What an observer said, as JSON; None before they did."""
        with reading(self.path, HELD):
            return None if text is None else msgspec.json.decode(text)

    def _check(self, db: sqlite3.Connection, experiment: str) -> None:
        """A DataError if observers of an experiment began with another plan."""
        found = db.execute("SELECT fingerprint FROM plans WHERE experiment = ?", (experiment,)).fetchone()
        if found != (fingerprint(self.plan, experiment),):
            raise DataError(
                f"{self.path}: experiment {experiment!r} was begun with other materials, stimuli or seed "
                f"than {PLAN} has now; restore {PLAN}, or move {self.path.name} away"
            )


def fingerprint(plan: Plan, experiment: str) -> str:
    """Hash of what the trials of an experiment depend on and show; words and other experiments may change."""
    asked = [asdict(one) | {"title": ""} for one in plan.experiments if one.name == experiment]
    used = {name for one in asked for name in one["stimuli"]}
    materials = [asdict(material) for material in plan.materials]
    for material in materials:
        material["stimuli"] = {name: what for name, what in material["stimuli"].items() if name in used}
    return hashlib.sha256(json.dumps([plan.seed, asked, materials], sort_keys=True).encode()).hexdigest()


def observer_name(number: int) -> str:
    """What an observer is called in answers; numbers count from 1 through all experiments of a database."""
    return f"observer-{number:03d}"


def now() -> str:
    """The time in ISO 8601, UTC, with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _state(db: sqlite3.Connection, token: str) -> State:
    row = db.execute(
        "SELECT id, trials, let_in, screen IS NOT NULL, (SELECT COUNT(*) FROM answers WHERE observer = observers.id)"
        " FROM observers WHERE token = ?",
        (token,),
    ).fetchone()
    if row is None:
        raise UnknownObserverError("this link is not known")
    # What it gives that cannot be is a ValueError for who knows the file.
    observer, count, eligible, checked, position = msgspec.convert(row, tuple[int, int, int | None, int, int])
    if not 0 <= position <= count:
        raise ValueError(f"{position} answers to {count} trials")
    if eligible is None:
        stage: Stage = "questions"
    elif not eligible:
        stage = "screened"
    elif not checked:
        stage = "screen"
    else:
        stage = "trials" if position < count else "done"
    return State(observer, stage, position, count)
