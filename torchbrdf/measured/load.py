"""From paths to measured materials: which format a file has is told by its content."""

import logging
import os
import zipfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import torch

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.lobes.parts import MANIFEST, fit_folder
from torchbrdf.lobes.zoo import is_zoo, zoo_record
from torchbrdf.measured.bands import BANDS, RGB
from torchbrdf.measured.format import FORMATS, BrdfFormat
from torchbrdf.measured.measured import Measured
from torchbrdf.measured.rows import is_text
from torchbrdf.names import LONGEST_NAME, clean_name
from torchbrdf.reading import reading
from torchbrdf.registry import unknown

log = logging.getLogger("torchbrdf")

# What commands write beside fits, and pictures of any kind, which nobody takes for measurements.
_WRITTEN = ("fits.csv", "materials.json", "recipe.json", "study.json", "match.json", "check.json", "log.txt")
_PICTURES = (".png", ".jpg", ".exr", ".hdr", ".html", ".pdf", ".svg")
# Bytes of a name that are left for the number behind it.
ROOM = 12

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


def load(
    paths: Paths,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
    settings: Mapping[str, str] | None = None,
    bands: str = RGB,
) -> Measured:
    """Load measured BRDFs from a file, several files, or a folder; all of one format.

    Args:
        paths: Files, or folders, which give the files in them that are of a known format, sorted by name. The format
            is told by a file's content. Or models that come with the package: `zoo:nickel`, `zoo:nickel:gltf`, see
            `torchbrdf.lobes.zoo_names`.
        dtype: Of the values; by default torch's default dtype.
        device: Of the values; by default the CPU.
        settings: What the files do not say and their reader is to take, such as `{"angles": "degrees"}`; a format has
            those in its `settings`.
        bands: What becomes of bands of wavelengths: "rgb", linear RGB by the CIE 1931 observer; or "keep". Formats
            without bands give linear RGB in any case.

    Returns:
        All materials of all files. Names are those of the files, without suffix; where two are the same, with the
        folder's name in front.

    Raises:
        DataError: There is no file, a file is bad, or the formats differ.
        UsageError: The format has no such setting.

    Example:
        >>> from torchbrdf.measured import standins
        >>> measured = load(standins())
        >>> measured.names[:2]
        ['alum-bronze', 'aluminium']
        >>> measured.batch([0], samples=torch.arange(5)).values.shape
        torch.Size([1, 5, 3])
    """
    groups = grouped(paths)
    if len(groups) > 1:
        found = ", ".join(f"{members[0]} is {name}" for name, members in groups.items())
        raise DataError(f"expected files of one format, found {len(groups)}: {found}; load_all takes them all")
    ((name, members),) = groups.items()
    settings = _with_bands(settings, bands)
    check_settings([name], settings)
    return open_files(name, members, dtype, device, settings)


def load_all(
    paths: Paths,
    *,
    bad: list[DataError] | None = None,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
    settings: Mapping[str, str] | None = None,
    bands: str = RGB,
) -> list[Measured]:
    """Load measured BRDFs of mixed formats, one `Measured` for each format found.

    Args:
        paths: As for `load`.
        bad: A list that takes the errors of bad files, so that the others are loaded; None raises the first.
        dtype: As for `load`.
        device: As for `load`.
        settings: As for `load`; each format takes those that it has.
        bands: As for `load`.

    Returns:
        One `Measured` a format, in the order in which the formats were found; several where bands that are kept differ.

    Raises:
        DataError: There is no file; or a file is bad and `bad` is None.

    Example:
        >>> from torchbrdf.measured import standins
        >>> [measured.source.format for measured in load_all([standins()])]
        ['fits']
    """
    groups = grouped(paths, bad)
    settings = _with_bands(settings, bands)
    check_settings(groups, settings)
    found = [
        open_good(name, own, bad, dtype, device, settings)
        for name, members in groups.items()
        for own in alike(name, members, bad, settings)
    ]
    return [one for one in found if one is not None]


def format_of(path: Path) -> str | None:
    """The name of a file's format, by its content, else by its suffix; None if it is neither."""
    head = _head(path)
    for name, source in sorted(FORMATS.items(), key=lambda item: not _ours(item[1])):  # ours before others'
        if head and _recognises(name, source, path, head):
            return name
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


def open_files(
    name: str,
    paths: Sequence[Path],
    dtype: torch.dtype | None,
    device: torch.device | str | None,
    settings: Mapping[str, str] | None,
    names: Sequence[str] | None = None,
) -> Measured:
    """What was measured, of files of one format; names: of the materials, where each file has one."""
    source = _opened(name, paths, settings)
    # A name becomes a file's name and a line on pages: one that a file's stem gives may be anything.
    if names is None:
        names = unique_names([clean_name(one) for one in source.names], source.paths)
    elif len(source.names) != len(names):
        found = f"{len(source.names)} of {len(names)} files"
        raise DataError(f"{paths[0]}: expected a material a file (one_a_file of the format {name}), found {found}")
    source.names = list(names)
    return Measured(source, dtype=dtype, device=device)


def _opened(name: str, paths: Sequence[Path], settings: Mapping[str, str] | None) -> BrdfFormat:
    """The source of some files; whatever a reader of another package raises is an error that names the first."""
    own = {key: value for key, value in (settings or {}).items() if key in FORMATS[name].settings}
    with reading(paths[0], f"a measured BRDF of the format {name}"):
        if own:  # which only those have that take them
            return FORMATS[name].open(paths, own)  # type: ignore[call-arg]
        return FORMATS[name].open(paths)


def check_settings(names: Iterable[str], settings: Mapping[str, str] | None) -> None:
    """Refuse settings that none of some formats has.

    Args:
        names: Of the formats.
        settings: As of `load`.

    Raises:
        UsageError: A setting, or its value, is not known.

    Example:
        >>> check_settings(["astm"], {"angles": "degrees"})
    """
    known = {key: values for name in names for key, values in FORMATS[name].settings.items()}
    known["bands"] = BANDS  # files without them are the same either way
    for key, value in (settings or {}).items():
        if key not in known:
            has = ", ".join(known)
            raise UsageError(f"settings: expected one that {', '.join(names)} has ({has}), found {shown(key)}")
        if value not in known[key]:
            raise unknown(key, value, known[key])


def unique_names(names: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """Names that are names, with the folder in front where they are not unique, and a number behind if need be."""
    count = Counter(names)
    own = [
        name if count[name] == 1 else f"{path.resolve().parent.name}-{name}"
        for name, path in zip(names, paths, strict=True)
    ]
    return number_repeats([clean_name(name, LONGEST_NAME - ROOM) for name in own], "-")


def number_repeats(names: Sequence[str], mark: str) -> list[str]:
    """The names, those that came before with a mark and a number behind."""
    last: Counter[str] = Counter()
    made: dict[str, None] = {}
    for name in names:
        own = name
        while own in made:
            last[name] += 1
            own = f"{name}{mark}{last[name] + 1}"
        made[own] = None
    return list(made)


def _with_bands(settings: Mapping[str, str] | None, bands: str) -> Mapping[str, str] | None:
    """Settings, with that of bands where it is not the default."""
    if bands not in BANDS:
        raise unknown("bands", shown(bands) if not isinstance(bands, str) else bands, BANDS)
    return settings if bands == RGB else {**(settings or {}), "bands": bands}


def alike(
    name: str, paths: Sequence[Path], bad: list[DataError] | None, settings: Mapping[str, str] | None
) -> list[list[Path]]:
    """Files of one format in groups that can be one `Measured`: where bands are kept, good ones with the same bands.

    bad: takes the errors of the others; None raises the first.
    """
    if (settings or {}).get("bands", RGB) == RGB:
        return [list(paths)]
    found: dict[object, list[Path]] = {}
    for path in paths:
        try:
            one = _opened(name, [path], settings)
        except DataError as error:
            if bad is None:
                raise
            bad.append(error)
        else:
            found.setdefault((one.channels, one.wavelengths), []).append(path)
    return list(found.values())


def open_good(
    name: str,
    paths: Sequence[Path],
    bad: list[DataError] | None,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
    settings: Mapping[str, str] | None = None,
    names: Sequence[str] | None = None,
) -> Measured | None:
    """As `open_files`, of those that can be opened; None if there are none.

    bad: takes the errors of the others; None raises the first.
    """
    try:
        return open_files(name, paths, dtype, device, settings, names)
    except DataError:
        if bad is None:
            raise
    good: list[int] = []
    for row, path in enumerate(paths):
        try:
            _opened(name, [path], settings)
        except DataError as error:
            if bad is None:
                raise
            bad.append(error)
        else:
            good.append(row)
    if not good:
        return None
    own = None if names is None else [names[row] for row in good]
    return open_files(name, [paths[row] for row in good], dtype, device, settings, own)


def grouped(paths: Paths, bad: list[DataError] | None = None) -> dict[str, list[Path]]:
    """The files that paths name, see `find_files`, by their formats; bad: takes the errors of those of none."""
    groups: dict[str, list[Path]] = {}
    for path, name in _found(paths, bad).items():
        try:
            groups.setdefault(name or _expect_format(path), []).append(path)
        except DataError as error:
            if bad is None:
                raise
            bad.append(error)
    return groups


def _expect_format(path: Path) -> str:
    name = format_of(path)
    head = _head(path)
    if not head:
        raise DataError(f"{path}: the file is empty; expected a measured BRDF ({_known()})")
    if name is None:
        hints = (source.hint(path, head) for source in FORMATS.values() if _ours(source))
        found = next(filter(None, hints), f"a file that begins with {head[:12]!r}")
        raise DataError(f"{path}: expected a measured BRDF ({_known()}), found {found}")
    return name


def find_files(paths: Paths, bad: list[DataError] | None = None) -> list[Path]:
    """The files that paths name, each once; folders give those in them that are of a known format.

    A name in the zoo is a path, too. A file that is called so comes as its absolute path, which is no such name.
    """
    return list(_found(paths, bad))


def _found(paths: Paths, bad: list[DataError] | None) -> dict[Path, str | None]:
    """The files that paths name, with the formats of those for which these had to be found out."""
    if isinstance(paths, str | os.PathLike):
        paths = [paths]
    files: dict[Path, tuple[Path, str | None]] = {}
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
                files[path] = path, None
                continue
            path = _file(path)
            with reading(path, "measured BRDFs"):  # a name may be too long for the system
                if path.is_dir():
                    for real, own in _folder(path).items():
                        files.setdefault(real, own)
                    continue
                if not path.is_file():
                    raise DataError(f"{path}: {'not a file' if path.exists() else 'no such file or folder'}")
                files.setdefault(path.resolve(), (path, None))
        except DataError as error:
            if bad is None:
                raise
            bad.append(error)
    return dict(files.values())


def _file(path: Path) -> Path:
    """The path of a file, whatever it is called."""
    return path.absolute() if is_zoo(path) else path


def _folder(path: Path) -> dict[Path, tuple[Path, str | None]]:
    """The measured BRDFs of a folder by where they really are, with their formats where suffixes do not tell them."""
    where = path.resolve()
    if fit_folder(path) is not None:
        return {(where / MANIFEST).resolve(): (path / MANIFEST, None)}
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
        found = None if file.suffix.lower() in named else format_of(file)
        if found or file.suffix.lower() in named:
            known[file.resolve() if is_link else where / name] = file, found
        else:
            passed.append(file)
    if not known:
        raise DataError(f"{path}: expected measured BRDFs ({_known()}), found {_count(path, len(inside))}")
    like = {file.suffix for file, _ in known.values()}
    broken = [file for file in passed if file.suffix in like and _is_broken(file)]
    known |= {where / file.name: (file, None) for file in broken}
    _say_passed(path, [file for file in passed if file not in broken])
    return dict(sorted(known.items(), key=lambda item: item[1][0].name))


def _is_broken(path: Path) -> bool:
    """Whether a file of no format is what copying may have left of one: nothing, or a part of an archive."""
    head = _head(path)
    return not head or (head.startswith(b"PK") and not zipfile.is_zipfile(path))


def _say_passed(folder: Path, passed: Sequence[Path]) -> None:
    """Say how many files of a folder are none of ours, unless they are what commands wrote there."""
    others = [file for file in passed if file.name not in _WRITTEN and file.suffix.lower() not in _PICTURES]
    if others:
        count = "1 file" if len(others) == 1 else f"{len(others)} files"
        end = "" if len(others) == 1 else ", ..."
        log.warning("torchbrdf: %s: passed over %s of no known format: %s%s", folder, count, others[0].name, end)


def _count(folder: Path, files: int) -> str:
    """What a folder without measured BRDFs holds."""
    inner = 0 if files else sum(one.is_dir() for one in folder.iterdir())
    return f"no file, and {inner} folders, which are not searched" if inner else f"{files} files, none of them one"


def _known() -> str:
    return ", ".join(" ".join([name, *source.suffixes]) for name, source in FORMATS.items())
