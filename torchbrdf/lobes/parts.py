"""Folders of many fits: parts of blocks of materials, each written once and whole, and a manifest that lists them.

fits/part-00017.jsonl    a head, which says what follows, and a record a line
manifest.json            the settings of all fits, their hash, the materials, and where each part begins
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from torchbrdf.errors import DataError, shown
from torchbrdf.files import finite, locked, write_bytes, write_text
from torchbrdf.lobes.records import FitRecord
from torchbrdf.reading import read_bytes, read_json

MANIFEST, PARTS, FITS, TABLE = "manifest.json", "fits", "fits.json", "fits.csv"
VERSION = 1
# Records of a part that is made of an old file.
TAKEN_UP = 500
# Seconds; others hold the lock for as long as it takes to write a part.
LOCK_WAIT = 60.0


class Input(NamedTuple):
    """A material that is to be fitted.

    Attributes:
        name: Of the material.
        digest: Of its file (`file:...`) or of its values; empty where nobody knows.
        path: Of its file, as it was given; empty if it came from none.
    """

    name: str
    digest: str = ""
    path: str = ""


@dataclass(frozen=True)
class Manifest:
    """What the fits of a folder are.

    Args:
        version: Of this format.
        settings: Those of all fits.
        hash: Of the settings.
        parts: The first input of each part.
        inputs: All materials.
    """

    version: int
    settings: dict[str, Any]
    hash: str
    parts: list[int] = field(default_factory=list)
    inputs: list[Input] = field(default_factory=list)

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "Manifest":
        """One without any material."""
        return cls(VERSION, dict(settings), settings_hash(settings))

    def block(self, part: int) -> list[Input]:
        """The materials of a part."""
        end = self.parts[part + 1] if part + 1 < len(self.parts) else len(self.inputs)
        return self.inputs[self.parts[part] : end]

    @cached_property
    def place(self) -> dict[str, tuple[int, int]]:
        """Of each material, its part and its index among the inputs."""
        found: dict[str, tuple[int, int]] = {}
        for part in range(len(self.parts)):
            for row, one in enumerate(self.block(part), self.parts[part]):
                found[one.name] = part, row
        return found

    def with_block(self, inputs: Sequence[Input]) -> "Manifest":
        """With one more part, of these materials."""
        return replace(self, parts=[*self.parts, len(self.inputs)], inputs=[*self.inputs, *inputs])

    def text(self) -> str:
        """As a file: an input a line."""
        head = {"version": self.version, "settings": self.settings, "hash": self.hash, "parts": self.parts}
        inputs = ",\n".join(json.dumps(list(one)) for one in self.inputs)
        return json.dumps(head, indent=1)[:-2] + f',\n "inputs": [\n{inputs}\n ]\n}}\n'


def settings_hash(settings: Mapping[str, Any]) -> str:
    """Of settings, whatever order they are in."""
    return hashlib.sha256(json.dumps(dict(settings), sort_keys=True).encode()).hexdigest()[:16]


def part_name(part: int) -> str:
    """Of the file of a part.

    Example:
        >>> part_name(17)
        'part-00017.jsonl'
    """
    return f"part-{part:05d}.jsonl"


def fit_folder(path: Path) -> Path | None:
    """The folder of fits in parts that a path names, itself or by its manifest; None if it names none."""
    folder = path.parent if path.name == MANIFEST else path
    return folder if (folder / MANIFEST).is_file() and (folder / PARTS).is_dir() else None


class FitFolder:
    """The fits of a folder; several processes may add to it at the same time.

    Args:
        path: The folder.

    Example:
        >>> import tempfile
        >>> from torchbrdf.lobes import Lambert, Sum, Ward, parameters
        >>> record = FitRecord("paint", "ward", 1, parameters(Sum(Lambert(), Ward())))
        >>> with tempfile.TemporaryDirectory() as name:
        ...     folder = FitFolder(name)
        ...     manifest = folder.register({"model": "ward"}, [[Input("paint")]])
        ...     folder.add(0, [record])
        ...     [line["material"] for _, line in folder.every()]
        ['paint']
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.manifest_path = self.path / MANIFEST

    def part_path(self, part: int) -> Path:
        """Where the fits of a part are."""
        return self.path / PARTS / part_name(part)

    def manifest(self) -> Manifest:
        """What the manifest says.

        Raises:
            DataError: There is none, or it is none of ours.
        """
        found: Manifest = read_json(self.manifest_path, Manifest, "a manifest of fits")
        where = self.manifest_path
        if found.version != VERSION:
            raise DataError(f"{where}: expected version {VERSION}, found {found.version}")
        if found.hash != (own := settings_hash(found.settings)):
            raise DataError(f"{where}: expected the hash of its settings, {own}, found {shown(found.hash)}")
        starts = found.parts
        if (starts[:1] or [0]) != [0] or starts != sorted(set(starts)) or (starts or [0])[-1] > len(found.inputs):
            raise DataError(f"{where}: parts: expected rising numbers from 0 to {len(found.inputs)}, found others")
        if len(found.place) != len(found.inputs):
            raise DataError(f"{where}: inputs: expected names that differ, found {len(found.place)} of them")
        return found

    def register(self, settings: Mapping[str, Any], blocks: Iterable[Sequence[Input]]) -> Manifest:
        """Add materials that are not there yet; a block of them becomes a part.

        Args:
            settings: Of the fits.
            blocks: Materials that are fitted together.

        Returns:
            The manifest as it is then.

        Raises:
            DataError: The folder has fits with other settings.
        """
        with self.locked():
            before = self.manifest() if self.manifest_path.exists() else Manifest.of(settings)
            self.check_settings(before, settings)
            parts, inputs = list(before.parts), list(before.inputs)
            for block in blocks:
                new = [one for one in block if one.name not in before.place]
                parts += [len(inputs)] if new else []
                inputs += new
            manifest = replace(before, parts=parts, inputs=inputs)
            self._write(manifest)
        return manifest

    def note(self, digests: Mapping[str, str]) -> None:
        """Write down what tells materials from others of their names.

        Args:
            digests: By material.
        """
        with self.locked():
            before = self.manifest()
            inputs = [one._replace(digest=digests.get(one.name, one.digest)) for one in before.inputs]
            self._write(replace(before, inputs=inputs))

    def take_up(self, settings: Mapping[str, Any], records: Sequence[FitRecord], inputs: Sequence[Input]) -> None:
        """Make a folder of parts of one that has a `fits.json` alone.

        Args:
            settings: Of the fits.
            records: What the file has.
            inputs: Their materials.
        """
        manifest = Manifest.of(settings)
        blocks = [inputs[k : k + TAKEN_UP] for k in range(0, len(inputs), TAKEN_UP)]
        for block in blocks:
            manifest = manifest.with_block(block)
        lines = {record.material: record.to_json() for record in records}
        with self.locked():
            if not self.manifest_path.exists():  # which another process may have made
                for part, block in enumerate(blocks):
                    own = [lines[one.name] for one in block]
                    write_bytes(self.part_path(part), part_bytes(part, manifest.hash, own))
                self._write(manifest)

    def _write(self, manifest: Manifest) -> None:
        """Write the manifest, unless it is so already."""
        (self.path / PARTS).mkdir(exist_ok=True)
        text = manifest.text()
        if not (self.manifest_path.exists() and self.manifest_path.read_bytes() == text.encode()):
            write_text(self.manifest_path, text)

    def remove_if_empty(self) -> None:
        """Remove manifest and folder if no part was written: nothing came of the work."""
        with self.locked():
            if not any((self.path / PARTS).glob("part-*")):
                self.manifest_path.unlink(missing_ok=True)
                with suppress(OSError):  # it has something else
                    (self.path / PARTS).rmdir()

    def put(self, manifest: Manifest, parts: Mapping[int, bytes]) -> None:
        """Write a manifest, and parts as they are.

        Args:
            manifest: Of all that the folder has then.
            parts: By their numbers.
        """
        with self.locked():
            for part, data in parts.items():
                write_bytes(self.part_path(part), data)
            self._write(manifest)

    def check_settings(self, manifest: Manifest, settings: Mapping[str, Any], whose: str = "") -> None:
        """Refuse to add fits with other settings.

        Args:
            manifest: What there is.
            settings: Of the fits that are to be added.
            whose: What to call them in an error.

        Raises:
            DataError: They are others, and which.
        """
        for key in {**manifest.settings, **settings}:
            had, wanted = (one.get(key) for one in (manifest.settings, settings))
            if had != wanted:
                rest = f" as {whose}" if whose else "; give another folder"
                made = f"{self.manifest_path}: its fits were made with {key} {shown(had)}"
                raise DataError(f"{made}, not {shown(wanted)}{rest}")

    def locked(self) -> Any:
        """Hold the folder, for as long as it takes to write a file."""
        return locked(self.path, wait=LOCK_WAIT)

    def add(self, part: int, records: Sequence[FitRecord], bad: Sequence[str] = ()) -> None:
        """Write records of a part, beside those that it has by now: other processes may have added theirs.

        Args:
            part: Its number.
            records: Of materials of the part.
            bad: Of which status a fit that is there gives way to another.
        """
        with self.locked():
            manifest, path = self.manifest(), self.part_path(part)
            there: dict[str, dict[str, Any]] = {}
            if path.exists():
                there = {line["material"]: line for line in self.lines(part, manifest)}
            new = {record.material: record.to_json() for record in records}
            kept = there | {
                name: line for name, line in new.items() if name not in there or there[name].get("status") in bad
            }
            ordered = [kept[one.name] for one in manifest.block(part) if one.name in kept]
            if ordered != list(there.values()):
                write_bytes(path, part_bytes(part, manifest.hash, ordered))

    def lines(self, part: int, manifest: Manifest) -> list[dict[str, Any]]:
        """The records of a part as they are written; none if it is not there.

        Raises:
            DataError: It was cut short, changed, or is of other settings.
        """
        path = self.part_path(part)
        return read_part(path, part, manifest) if path.exists() else []

    def statuses(self, part: int, manifest: Manifest) -> dict[str, str]:
        """How each fit of a part ended, by material."""
        return {line["material"]: line.get("status", "") for line in self.lines(part, manifest)}

    def every(self, bad: list[DataError] | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
        """All records as they are written, and where, in the order of the manifest, a part at a time.

        Args:
            bad: Takes the errors of bad parts; None raises the first.
        """
        manifest = self.manifest()
        for part in range(len(manifest.parts)):
            try:
                lines = self.lines(part, manifest)
            except DataError as error:
                if bad is None:
                    raise
                bad.append(error)
                continue
            yield from ((f"{self.part_path(part)}: fit {k}", line) for k, line in enumerate(lines))


def part_bytes(part: int, settings: str, records: Iterable[Mapping[str, Any]]) -> bytes:
    """A part as a file.

    Args:
        part: Its number.
        settings: Their hash.
        records: As `FitRecord.to_json` gives them.
    """
    lines = [json.dumps(finite(dict(record)), allow_nan=False) for record in records]
    body = "".join(f"{line}\n" for line in lines).encode()
    head = {"part": part, "settings": settings, "fits": len(lines), "sha256": hashlib.sha256(body).hexdigest()}
    return json.dumps(head).encode() + b"\n" + body


class _Head(NamedTuple):
    part: int
    settings: str
    fits: int
    sha256: str


def read_part(path: Path, part: int, manifest: Manifest) -> list[dict[str, Any]]:
    """The records of a part as they are written.

    Raises:
        DataError: It was cut short, changed, or is not this part of these fits.
    """
    data = read_bytes(path, "a part of fits")
    first, _, body = data.partition(b"\n")
    try:
        head = _Head(**json.loads(first))
    except (ValueError, TypeError, RecursionError):
        raise DataError(f"{path}: expected the head of a part of fits, found {shown(first[:40])}") from None
    if head.settings != manifest.hash:
        expected = f"expected fits with the settings {manifest.hash} of {MANIFEST}"
        raise DataError(f"{path}: {expected}, found some with {shown(head.settings)}")
    if head.part != part:
        raise DataError(f"{path}: expected part {part}, found part {shown(head.part)}")
    if hashlib.sha256(body).hexdigest() != head.sha256:
        count = body.count(b"\n")
        how = (
            "it was changed"
            if count == head.fits
            else "it was cut short"
            if body[-1:] != b"\n"
            else "lines are missing"
            if count < head.fits
            else "there are more"
        )
        raise DataError(f"{path}: expected {shown(head.fits)} fits as they were written, found {count}: {how}")
    try:
        lines = [json.loads(line) for line in body.splitlines()]
        names = [line["material"] for line in lines]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise DataError(f"{path}: expected a record of a fit a line, found something else") from None
    own = {one.name for one in manifest.block(part)}
    if len(set(names)) < len(names) or not own.issuperset(names):
        odd = next((name for name in names if name not in own), None)
        found = f"fits of {shown(odd)}" if odd is not None else "a material twice"
        raise DataError(f"{path}: expected fits of the materials of part {part} in {MANIFEST}, found {found}")
    return lines
