"""Which files are measured BRDFs, and of which format: told by their content."""

import logging
import os
import zipfile
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

from torchbrdf.errors import DataError
from torchbrdf.lobes.parts import MANIFEST, fit_folder
from torchbrdf.lobes.zoo import is_zoo, zoo_record
from torchbrdf.measured.format import FORMATS, BrdfFormat
from torchbrdf.measured.rows import is_text
from torchbrdf.reading import reading

log = logging.getLogger("torchbrdf")

# What commands write beside fits, and pictures of any kind, which nobody takes for measurements.
_WRITTEN = ("fits.csv", "materials.json", "recipe.json", "study.json", "match.json", "check.json", "log.txt")
_PICTURES = (".png", ".jpg", ".exr", ".hdr", ".html", ".pdf", ".svg")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


def format_of(path: Path) -> str | None:
    """The name of a file's format, by its content, else by its suffix; None if it is neither."""
    return _looked_at(path)[0]


def _looked_at(path: Path) -> tuple[str | None, bytes]:
    """The format of a file and its first bytes; a file that stays as it is is looked at once."""
    if is_zoo(path):
        return _look(path, ())
    try:
        status = path.stat()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    known = hash(tuple(FORMATS.values()))  # a format may be registered in between
    return _look(path, (status.st_dev, status.st_ino, status.st_mtime_ns, status.st_size, known))


@lru_cache(1 << 17)  # of a folder of so many files each is looked at once
def _look(path: Path, stamp: tuple[object, ...]) -> tuple[str | None, bytes]:
    head = _head(path)
    return _format_of(path, head), head


def _format_of(path: Path, head: bytes) -> str | None:
    for name, source in sorted(FORMATS.items(), key=lambda item: not _ours(item[1])):  # ours before others'
        if head and _recognises(name, source, path, head):
            return name
    if head.startswith(_UTF_16):
        return None
    by_suffix = (name for name, source in FORMATS.items() if path.suffix.lower() in source.suffixes)
    return next((name for name in by_suffix if FORMATS[name].is_text or not is_text(head)), None)


def _head(path: Path) -> bytes:
    """The first bytes of a file; of a name in the zoo those of a `fits.json`."""
    if is_zoo(path):
        return b"[{"
    try:
        with path.open("rb") as file:
            return file.read(64)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def _ours(source: type[BrdfFormat]) -> bool:
    return source.__module__.startswith("torchbrdf.")


def _recognises(name: str, source: type[BrdfFormat], path: Path, head: bytes) -> bool:
    """Whether a file is of a format; another package's that fails on a file does not know it."""
    try:
        return source.recognises(path, head)
    except Exception as error:
        if _ours(source):
            raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        log.warning("torchbrdf: format %r of %s failed on %s: %s", name, source.__module__, path, reason)
        return False


def by_format(paths: Sequence[Path], bad: list[DataError] | None = None) -> dict[str, list[Path]]:
    """Files by their formats; bad: takes the errors of those of none."""
    groups: dict[str, list[Path]] = {}
    for path in paths:
        try:
            groups.setdefault(_expect_format(path), []).append(path)
        except DataError as error:
            if bad is None:
                raise
            bad.append(error)
    return groups


def _expect_format(path: Path) -> str:
    name, head = _looked_at(path)
    if not head:
        raise DataError(f"{path}: the file is empty; expected a measured BRDF ({_known()})")
    if name is None:
        hints = [source.hint(path, head) for source in FORMATS.values() if _ours(source)]
        if head.startswith(_UTF_16):
            hints = ["text in UTF-16, or nothing known: save it as UTF-8"]
        found = next(filter(None, hints), f"a file that begins with {head[:12]!r}")
        raise DataError(f"{path}: expected a measured BRDF ({_known()}), found {found}")
    return name


def find_files(paths: Paths, bad: list[DataError] | None = None) -> list[Path]:
    """The files that paths name, each once; folders give those in them that are of a known format.

    A name in the zoo is a path, too. A file that is called so comes as its absolute path, which is no such name.
    """
    if isinstance(paths, str | os.PathLike):
        paths = [paths]
    files: dict[Path, Path] = {}
    asked = list(paths)
    if not asked:
        raise DataError(f"no file was given; expected measured BRDFs ({_known()})")
    for given in asked:
        try:
            if given == "":  # which a Path takes for this folder
                raise DataError(f"expected a path of measured BRDFs ({_known()}), found an empty one")
            path = Path(given)
            if is_zoo(given):
                zoo_record(given)  # says if there is none
                files[path] = path
                continue
            path = _file(path)
            with reading(path, "measured BRDFs"):  # a name may be too long for the system
                if path.is_dir():
                    for real, file in _folder(path).items():
                        files.setdefault(real, file)
                    continue
                if not path.is_file():
                    raise DataError(f"{path}: {'not a file' if path.exists() else 'no such file or folder'}")
                files.setdefault(path.resolve(), path)
        except DataError as error:
            if bad is None:
                raise
            bad.append(error)
    return list(files.values())


def _file(path: Path) -> Path:
    """The path of a file, whatever it is called."""
    return path.absolute() if is_zoo(path) else path


def _folder(path: Path) -> dict[Path, Path]:
    """The measured BRDFs of a folder, by where they really are."""
    where = path.resolve()
    if fit_folder(path) is not None:
        return {(where / MANIFEST).resolve(): path / MANIFEST}
    try:
        with os.scandir(path) as entries:
            inside = sorted(
                (entry.name, entry.is_symlink()) for entry in entries if entry.name[0] != "." and entry.is_file()
            )
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    named = {suffix for source in FORMATS.values() for suffix in source.suffixes}
    known, passed = {}, []
    for name, is_link in inside:
        file = _file(path / name)
        if file.suffix.lower() in named or format_of(file):
            known[file.resolve() if is_link else where / name] = file
        else:
            passed.append(file)
    if not known:
        raise DataError(f"{path}: expected measured BRDFs ({_known()}), found {_count(path, len(inside))}")
    like = {file.suffix for file in known.values()}
    broken = [file for file in passed if file.suffix in like and _is_broken(file)]
    known |= {where / file.name: file for file in broken}
    _say_passed(path, [file for file in passed if file not in broken])
    return dict(sorted(known.items(), key=lambda item: item[1].name))


def _is_broken(path: Path) -> bool:
    """Whether a file of no format is what copying may have left of one: nothing, or a part of an archive."""
    head = _head(path)
    return not head or (head.startswith(b"PK") and not zipfile.is_zipfile(path))


def _say_passed(folder: Path, passed: Sequence[Path]) -> None:
    """Say how many files of a folder are no measurements, and which; nothing where there are only those of commands."""
    written = [file for file in passed if file.name in _WRITTEN]
    pictures = [file for file in passed if file.suffix.lower() in _PICTURES]
    others = [file for file in passed if file not in written and file not in pictures]
    if not (pictures or others):
        return
    kinds = {"of no known format": others, "pictures or pages": pictures, "that a command wrote": written}
    parts = [f"{len(own)} {kind} ({_first(own)})" for kind, own in kinds.items() if own]
    count = "1 file" if len(passed) == 1 else f"{len(passed)} files"
    log.warning("torchbrdf: %s: passed over %s: %s", folder, count, ", ".join(parts))


def _first(files: Sequence[Path]) -> str:
    return files[0].name + (", ..." if len(files) > 1 else "")


def _count(folder: Path, files: int) -> str:
    """What a folder without measured BRDFs holds."""
    inner = 0 if files else sum(one.is_dir() for one in folder.iterdir())
    return f"no file, and {inner} folders, which are not searched" if inner else f"{files} files, none of them one"


def _known() -> str:
    return ", ".join(" ".join([name, *source.suffixes]) for name, source in FORMATS.items())
