"""What anybody can write: columns with names, in CSV or in an `.npz`."""

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.angles import in_radians
from torchbrdf.measured.bands import columns_of_bands
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.grain import GRAINS, said_grain
from torchbrdf.measured.listed import Listed, ListedFormat
from torchbrdf.measured.notices import notice
from torchbrdf.measured.rows import head_lines, lines_of, parse_rows
from torchbrdf.reading import npz_arrays, read_bytes

_EXPECTED = "columns theta_i, theta_o, phi and bands"
_NEEDED = ("theta_i", "theta_o")
_AZIMUTHS = ("phi", "phi_i", "phi_o")
_GREY = ("f", "brdf", "value")


@FORMATS.register("columns")
class Columns(ListedFormat):
    """The format of CSV and `.npz` files with named columns: what a user can always write.

    `theta_i` and `theta_o` are the angles of light and viewer from the normal; `phi` is the azimuth between them, or
    `phi_i` and `phi_o` are those of both: at 180 degrees lies the mirror direction. Values are `r`, `g`, `b`, linear
    with the primaries of ITU-R BT.709; or bands, called by their wavelengths in nm (`465nm`); or one column `f`, grey.
    In an `.npz` each column is an array `(N,)`. A line `# grain: anisotropic`, or `isotropic`, in front of the names
    says what else is found out of samples whose light has several azimuths.
    """

    format = "columns"

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether the first line, or the arrays of an `.npz`, have the names of both angles from the normal."""
        if head.startswith(b"PK"):
            return set(_NEEDED) <= set(_arrays(path))
        first = next((line for line in head_lines(path, head) if line[0] != "#"), "")
        return set(_NEEDED) <= set(_names(first))

    @classmethod
    def hint(cls, path: Path, head: bytes) -> str:
        """Which columns a table lacks whose names are some, but not those of both angles."""
        if head.startswith(b"PK"):
            names, kind = _arrays(path), "arrays"
            if not names:
                return "an archive that is damaged, or has no arrays" if path.suffix.lower() == ".npz" else ""
        else:
            first = next((line for line in head_lines(path, head) if line[0] != "#"), "")
            names, kind = _names(first), "columns"
            near = set(names) & {*_NEEDED, *_AZIMUTHS, *_GREY, "r", "g", "b"} or any("theta" in one for one in names)
            if not (near or (path.suffix.lower() in (".csv", ".tsv") and len(names) > 1)):
                return ""
        missing = ", ".join(name for name in _NEEDED if name not in names)
        return f"{kind} {shown(' '.join(names), 90)} without {missing}" if missing else ""

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        data = read_bytes(path, _EXPECTED)
        names, columns, facts, grain = (_packed if data.startswith(b"PK") else _text)(path, data)
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise DataError(f"{path}: expected each column once, found {shown(twice[0])} more often")
        column = dict(zip(names, columns, strict=True))
        for name in _NEEDED:
            if name not in column:
                raise DataError(f"{path}: expected {_EXPECTED}, found {shown(' '.join(names), 90)}")
        if {"phi_i", "phi_o"} <= set(names):
            phi_i, phi_o = column["phi_i"], column["phi_o"]
            if "phi" in names:
                facts["azimuths"] = "those of the columns phi_i and phi_o; phi was passed over"
                notice(path, f"azimuths: {facts['azimuths']}")
        elif "phi" in names:
            phi_i, phi_o = np.zeros_like(column["phi"]), column["phi"]
        else:
            raise DataError(f"{path}: expected a column phi, or phi_i and phi_o, found {shown(' '.join(names), 90)}")
        angles = np.stack([column["theta_i"], phi_i, column["theta_o"], phi_o], -1, dtype=np.float64)
        factor, unit = in_radians(path, angles[:, ::2], angles[:, 1::2], self.setting("angles", "auto"))
        rest = [name for name in names if name not in (*_NEEDED, *_AZIMUTHS)]
        found = columns_of_bands(rest)
        if found is None or (len(rest) == 1 and found[1] is None and rest[0] not in _GREY):
            other = shown(" ".join(rest), 90)
            expected = "expected r, g, b, or bands such as 465nm, which names their wavelengths, or f"
            raise DataError(f"{path}: {expected}, found {other}")
        order, wavelengths = found
        values = np.stack([column[rest[k]] for k in order], -1, dtype=np.float64)
        facts = {"angles": unit, **facts}
        return Listed(factor * angles, values, wavelengths, self.setting("quantity", "brdf"), facts, grain)


def _names(line: str) -> list[str]:
    """The names in a header, whatever parts them."""
    mark = next((one for one in ";\t," if one in line), " ")
    row = next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
    return [name.strip().lower() for name in row if name.strip()]


def _text(path: Path, data: bytes) -> tuple[list[str], Iterable[np.ndarray], dict[str, object], str]:
    """Names, columns and facts of a CSV file, and what it says of a grain."""
    lines = lines_of(data)
    at = next((k for k, line in enumerate(lines) if line and line[0] != "#"), None)
    names = [] if at is None else _names(lines[at])
    if at is None or not set(_NEEDED) <= set(names):
        raise DataError(f"{path}: expected {_EXPECTED}, found {shown(' '.join(names), 90)}")
    rows = parse_rows(path, [line.replace('"', "") for line in lines[at + 1 :]], len(names), at + 2)
    grain = said_grain(line.strip("# ") for line in lines[:at])
    return names, rows.numbers.T, {"mended": rows.mended} if rows.mended else {}, grain


def _packed(path: Path, data: bytes) -> tuple[list[str], Iterable[np.ndarray], dict[str, object], str]:
    """The same of an `.npz`."""
    arrays = npz_arrays(path, data, _EXPECTED)
    size = len(np.atleast_1d(next(iter(arrays.values()), np.empty(0))))
    for name, one in arrays.items():
        if one.shape != (size,) or one.dtype.kind not in "fiu":
            raise DataError(f"{path}: {shown(name)}: expected {size} numbers, found {one.dtype} {one.shape}")
    return [name.lower() for name in arrays], arrays.values(), {}, GRAINS[0]


def _arrays(path: Path) -> list[str]:
    """The names of the arrays of an `.npz`; none of another archive."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            return [name.removesuffix(".npy").lower() for name in archive.namelist() if name.endswith(".npy")]
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError):
        return []
