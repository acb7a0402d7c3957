"""From paths to measured materials: which format a file has is told by its content."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import torch

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.measured.bands import BANDS, RGB
from torchbrdf.measured.find import Paths, by_format, find_files
from torchbrdf.measured.format import FORMATS, BrdfFormat
from torchbrdf.measured.measured import Measured
from torchbrdf.names import LONGEST_NAME, clean_name
from torchbrdf.reading import reading
from torchbrdf.registry import unknown

# Bytes of a name that are left for the number behind it.
ROOM = 12


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
    groups = by_format(find_files(paths))
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
    return load_groups(by_format(find_files(paths, bad), bad), bad, dtype, device, _with_bands(settings, bands))


def load_groups(
    groups: Mapping[str, Sequence[Path]],
    bad: list[DataError] | None,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
    settings: Mapping[str, str] | None = None,
) -> list[Measured]:
    """As `load_all`, of files whose formats are known.

    Args:
        groups: Files by their formats, as of `by_format`.
        bad: As of `load_all`.
        dtype: As of `load`.
        device: As of `load`.
        settings: As of `load_all`.
    """
    check_settings(groups, settings)
    return [one for name, members in groups.items() for one in open_good(name, members, bad, dtype, device, settings)]


def open_files(
    name: str,
    paths: Sequence[Path],
    dtype: torch.dtype | None,
    device: torch.device | str | None,
    settings: Mapping[str, str] | None,
    names: Sequence[str] | None = None,
) -> Measured:
    """What was measured, of files of one format; names: of the materials, where each file has one."""
    return _measured(name, _opened(name, paths, settings), dtype, device, names)


def _measured(
    name: str,
    source: BrdfFormat,
    dtype: torch.dtype | None,
    device: torch.device | str | None,
    names: Sequence[str] | None,
) -> Measured:
    # A name becomes a file's name and a line on pages: one that a file's stem gives may be anything.
    if names is None:
        names = unique_names([clean_name(one) for one in source.names], source.paths)
    elif len(source.names) != len(names):
        found = f"{len(source.names)} of {len(names)} files"
        raise DataError(
            f"{source.paths[0]}: expected a material a file (one_a_file of the format {name}), found {found}"
        )
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


def open_good(
    name: str,
    paths: Sequence[Path],
    bad: list[DataError] | None,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
    settings: Mapping[str, str] | None = None,
    names: Sequence[str] | None = None,
) -> list[Measured]:
    """What was measured, of those files of one format that can be opened; where bands are kept, one for each of them.

    Args:
        name: Of the format.
        paths: The files.
        bad: Takes the errors of the others; None raises the first.
        dtype: As of `load`.
        device: As of `load`.
        settings: As of `load`.
        names: Of the materials, where each file has one.
    """
    return [
        _measured(name, source, dtype, device, None if names is None else [names[row] for row in rows])
        for rows, source in _alike(name, paths, bad, settings)
    ]


def _alike(
    name: str, paths: Sequence[Path], bad: list[DataError] | None, settings: Mapping[str, str] | None
) -> list[tuple[list[int], BrdfFormat]]:
    """Sources of good files that can be one, and which files they are of; each is read once, where they are joined."""
    kept = (settings or {}).get("bands", RGB) != RGB
    if not kept and (bad is None or not FORMATS[name].is_joined):
        try:
            return [(list(range(len(paths))), _opened(name, paths, settings))]
        except DataError as error:
            if bad is None:
                raise
            if len(paths) == 1:
                bad.append(error)
                return []
    found: dict[object, list[tuple[int, BrdfFormat]]] = {}
    for row, path in enumerate(paths):
        try:
            one = _opened(name, [path], settings)
        except DataError as error:
            if bad is None:
                raise
            bad.append(error)
        else:
            found.setdefault((one.channels, one.wavelengths) if kept else None, []).append((row, one))
    return [
        ([row for row, _ in group], FORMATS[name].joined([source for _, source in group])) for group in found.values()
    ]
