"""Measured files that are opened where they are worked on: a million of them need not fit one process."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch

from torchbrdf.errors import DataError
from torchbrdf.measured.find import Paths, by_format, find_files
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.load import check_settings, open_good, unique_names
from torchbrdf.measured.measured import Measured
from torchbrdf.names import clean_name


@dataclass(frozen=True)
class Unopened:
    """Files of one format, each of one material, which have names and are not opened yet.

    Args:
        format: Name of the format.
        paths: The files, M.
        names: Of their materials, M.
        settings: What the files do not say, as of `load`.
        device: Of the values; by default the CPU.

    Example:
        >>> Unopened("merl", [Path("nickel.binary"), Path("nylon.binary")], ["nickel", "nylon"]).batch([1]).names
        ['nylon']
    """

    format: str
    paths: Sequence[Path]
    names: Sequence[str]
    settings: Mapping[str, str] | None = None
    device: torch.device | str | None = None

    def __len__(self) -> int:
        return len(self.paths)

    @cached_property
    def mean_size(self) -> float:
        """Bytes of a file, on average."""
        return sum(path.stat().st_size for path in self.paths) / max(len(self), 1)

    def batch(self, materials: Sequence[int]) -> "Unopened":
        """Some of the files."""
        return replace(self, paths=[self.paths[k] for k in materials], names=[self.names[k] for k in materials])

    def opened(self, bad: list[DataError]) -> list[Measured]:
        """What was measured, of good files; where bands are kept, of files with the same bands together.

        Args:
            bad: Takes the errors of bad files, so that the others are opened.
        """
        return open_good(self.format, self.paths, bad, None, self.device, self.settings, self.names)


def load_later(
    paths: Paths,
    *,
    bad: list[DataError] | None = None,
    device: torch.device | str | None = None,
    settings: Mapping[str, str] | None = None,
) -> list[Measured | Unopened]:
    """As `load_all`, without opening files that have a material each.

    Args:
        paths: As for `load`.
        bad: A list that takes the errors of files of no format, so that the others are found; None raises the first.
        device: As for `load`.
        settings: As for `load_all`.

    Example:
        >>> from torchbrdf.measured import standins
        >>> load_later([standins()])
        [Measured(fits: alum-bronze, aluminium, blue-acrylic, ...; 10 materials, 1096216 pairs)]
    """
    groups = by_format(find_files(paths, bad), bad)
    check_settings(groups, settings)
    found: list[Measured | Unopened] = []
    for name, members in groups.items():
        if FORMATS[name].one_a_file:
            given = unique_names([clean_name(FORMATS[name].name_of(path)) for path in members], members)
            found.append(Unopened(name, members, given, settings, device))
        else:
            found += open_good(name, members, bad, None, device, settings)
    return found
