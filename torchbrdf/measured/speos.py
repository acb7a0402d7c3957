"""Measured BSDFs of Ansys Speos: `.anisotropicbsdf`, text and binary, and `.brdf`, text.

Source: Ansys Speos' documentation, Structure of Anisotropic BSDF Files, and Structure of BRDF files; the binary kind is
that of version 9, whose fields are those of the text.
"""

import math
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.bands import LONGEST
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import SETTINGS, Listed, ListedFormat
from torchbrdf.measured.rows import text_lines
from torchbrdf.measured.speos_file import BinaryCursor, Cursor, TextCursor
from torchbrdf.reading import check_unpacked, read_bytes

MARK = b"OPTIS - "
_EXPECTED = "a measured BSDF of Speos"
_BOM = b"\xef\xbb\xbf"
_KINDS = {"optis - anisotropic bsdf surface file": "anisotropic", "optis - brdf surface file": "spectral"}
_QUANTITIES = {0: "brdf_cosine", 1: "brdf"}
# Where the visible range ends, nm.
_ENDS = (380.0, 780.0)
_BYTES_A_SAMPLE = 200
# Of rounding in a file, degrees.
_TOLERANCE = 1e-3
# The mirror direction is looked for with light at 20 to 80 degrees, within 5 of it; so much brighter is another one.
_TILTED, _TILTED_RANGE, _MIRROR_NEAR, _BRIGHTER = 50.0, 30.0, 5.0, 1.1


class _Table(NamedTuple):
    """Values `(A, B)` over theta and phi of the viewer, degrees."""

    theta: np.ndarray
    phi: np.ndarray
    values: np.ndarray

    def reflected(self, quantity: str) -> float:
        """The sum of the values over the hemisphere, with the cosine where they are without."""
        theta, phi = np.radians(self.theta), np.radians(self.phi)
        weight = np.sin(theta) * (np.cos(theta) if quantity == "brdf" else 1)
        around = self.values
        if len(phi) == 1:
            rings = around[:, 0] * 2 * math.pi
        elif phi[-1] - phi[0] <= math.pi + 1e-6:  # half of it, and the other half is the same
            rings = np.trapezoid(around, phi, axis=1) * (2 * math.pi / (phi[-1] - phi[0]))
        else:
            gap = max(2 * math.pi - (phi[-1] - phi[0]), 0)
            rings = np.trapezoid(around, phi, axis=1) + gap * (around[:, 0] + around[:, -1]) / 2
        return float(np.trapezoid(rings * weight, theta))


@FORMATS.register("speos")
class Speos(ListedFormat):
    """The format of Speos' measured BSDFs; only the reflection is read.

    A file gives shapes and how much is reflected: of `.anisotropicbsdf` at one angle of the light for each wavelength,
    by which all values are scaled, and of `.brdf` for each table. At phi = 0 lies the mirror direction, as Speos'
    documentation has it, unless there it is darker than at phi = 180: there are such files.
    """

    format = "speos"
    settings: ClassVar = {
        **{name: values for name, values in SETTINGS.items() if name not in ("angles", "quantity")},
        "mirror": ("auto", "0", "180"),
    }

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is a file of Speos', by its first words."""
        return head.removeprefix(_BOM).startswith(MARK)

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        data = read_bytes(path, _EXPECTED).removeprefix(_BOM)
        first = data[:200].splitlines()[0].decode("latin-1").strip()
        name, _, version = first.lower().rpartition(" v")
        if name not in _KINDS:
            known = ", ".join(_KINDS)
            raise DataError(f"{path}: expected {_EXPECTED} ({known}), found {shown(first)}")
        cursor = _opened(path, data)
        if _KINDS[name] == "spectral":
            if isinstance(cursor, BinaryCursor):
                raise DataError(f"{path}: expected a .brdf in text, which Speos can save, found a binary one")
            listed = _spectral(path, cursor)
        else:
            listed = _anisotropic(path, cursor)
        facts = {"kind": f"{name}, version {version}, {'binary' if isinstance(cursor, BinaryCursor) else 'text'}"}
        if left := cursor.left():
            facts["passed over"] = f"{left} behind the reflection"
        at, facts["angles"] = _mirror(listed, self.setting("mirror", "auto"))
        angles = listed.angles + np.radians([0, at, 0, 0])
        return Listed(angles, listed.values, listed.wavelengths, listed.quantity, {**facts, **listed.facts})


def _mirror(listed: Listed, told: str) -> tuple[float, str]:
    """The phi at which the mirror direction lies, degrees, and how that is known, in words.

    Args:
        listed: Samples, as if it were 0.
        told: What the reader was told.
    """
    words = "degrees; the mirror direction is at phi ="
    light, _, viewer, _ = np.degrees(listed.angles).T
    turn = np.degrees(listed.angles[:, 3] - listed.angles[:, 1]) % 360
    near = (np.abs(light - _TILTED) <= _TILTED_RANGE) & (np.abs(light - viewer) <= _MIRROR_NEAR)
    there, back = near & (np.abs(turn - 180) <= _MIRROR_NEAR), near & (np.abs((turn + 180) % 360 - 180) <= _MIRROR_NEAR)
    times = 0.0
    if there.any() and back.any():
        times = float(listed.values[back].mean() / max(listed.values[there].mean(), 1e-30))
    if told != "auto":
        return float(told), f"{words} {told}, as was told"
    if times <= _BRIGHTER:
        return 0.0, f"{words} 0, as Speos' documentation has it; --read mirror=180 says otherwise"
    said = f"where values are {times:.2g} times as high as at 0, where Speos' documentation has it"
    return 180.0, f"{words} 180, {said}; --read mirror=0 says otherwise"


def _opened(path: Path, data: bytes) -> Cursor:
    """The file behind its header and the mode, which says whether it is text."""
    start = data[:300].splitlines(keepends=True)
    mode = start[1][:1] if len(start) > 1 else b""
    if mode == b"1":
        return BinaryCursor(path, data, len(start[0]) + 1)
    if mode != b"0" or start[1].strip() != b"0":
        raise DataError(f"{path}: line 2: expected the mode 0 of text or 1, found {shown(b''.join(start[1:2])[:20])}")
    cursor = TextCursor(path, "\n".join(text_lines(path, _EXPECTED)))
    for _ in range(3):  # header, mode, comment
        cursor.line()
    cursor.skip_text()
    return cursor


def _flags(cursor: Cursor, values: np.ndarray, what: str) -> list[bool]:
    if not np.isin(values, (0, 1)).all():
        raise cursor.bad(f"0 or 1, {what}", shown(values.tolist()))
    return [bool(one) for one in values]


def _angles(cursor: Cursor, found: np.ndarray, what: str, largest: float) -> np.ndarray:
    """Angles in degrees, which have to grow."""
    inside = len(found) and np.isfinite(found).all() and found.min() >= -_TOLERANCE
    if not (inside and found.max() <= largest + _TOLERANCE and (np.diff(found) > 0).all()):
        raise cursor.bad(f"growing angles {what} from 0 to {largest:g} degrees", shown(found.tolist()))
    return found


def _lights(cursor: Cursor, found: np.ndarray) -> np.ndarray:
    """Angles of the light in degrees, in the order of their tables; none comes twice."""
    _angles(cursor, np.sort(found), "of the light", 90)
    return found


def _tables(cursor: Cursor, count: int) -> list[_Table]:
    """So many tables."""
    tables = []
    for _ in range(count):
        table = _Table(*cursor.table())
        _angles(cursor, table.theta, "theta", 180)
        _angles(cursor, table.phi, "phi", 360)
        tables.append(table)
    return tables


def _of_reflection(cursor: Cursor, tables: list[_Table]) -> list[_Table]:
    """Tables whose viewers are above the surface."""
    for table in tables:
        _angles(cursor, table.theta, "theta of a reflection", 90)
        if not np.isfinite(table.values).all():
            raise cursor.bad("finite values", shown(float(table.values[~np.isfinite(table.values)][0])))
    return tables


def _wavelengths(cursor: Cursor, found: np.ndarray) -> np.ndarray:
    if not (len(found) and found[0] > 0 and (np.diff(found) > 0).all() and found[-1] < LONGEST):
        raise cursor.bad("growing wavelengths, in nm", shown(found.tolist()))
    return found


def _anisotropic(path: Path, cursor: Cursor) -> Listed:
    """An `.anisotropicbsdf`: tables for angles of the grain and of the light, and one spectrum."""
    if isinstance(cursor, TextCursor):
        cursor.numbers(3, "the anisotropy vector")
        reflects, transmits = _flags(cursor, cursor.numbers(2, "reflection and transmission"), "parts")
        (kind,) = _flags(cursor, cursor.numbers(1, "the kind of values"), "the kind of values")
    else:
        cursor.fields("2i", "a header")
        cursor.skip_text()
        cursor.skip_text()
        cursor.numbers(3, "the anisotropy vector")
        kind, reflects, transmits = _flags(cursor, np.array(cursor.fields("3b", "parts")), "parts")
        cursor.numbers(2, "indices of refraction")
        _flags(cursor, np.array(cursor.fields("2b", "parts")), "parts")
    if not reflects:
        raise DataError(f"{path}: expected a reflection, found {'only a transmission' if transmits else 'none'}")
    parts = []
    for _ in range(reflects + transmits):
        turns = _angles(cursor, cursor.array("of the grain"), "of the grain", 360)
        lights = [_lights(cursor, cursor.array("of the light")) for _ in turns]
        parts.append((turns, lights))
    spectra = []
    for _ in parts:
        at = cursor.numbers(2, "angles of the light that the spectrum is of")
        if isinstance(cursor, TextCursor):
            cursor.line()
        else:
            cursor.skip_text()
        spectra.append((at, cursor.spectrum()))
    turns, lights = parts[0]
    tables = _of_reflection(cursor, _tables(cursor, sum(map(len, lights))))
    quantity = _QUANTITIES[int(kind)]
    at, spectrum = spectra[0]
    factor = _factor(cursor, tables, turns, lights, at, quantity)
    waves, shares = _spectrum(cursor, spectrum)
    angles, values = _samples(
        path, tables, [(turn, light) for turn, own in zip(turns, lights, strict=True) for light in own]
    )
    facts: dict[str, object] = {
        "angles of the grain, degrees": " ".join(f"{turn:g}" for turn in turns[:12]),
        "scale": f"{factor:.4g}, so that light at {at[0]:g} degrees has the reflectance of the file: "
        f"{' '.join(f'{100 * one:.4g}' for one in shares[:6])} %",
        "parts": "reflection and transmission; the reflection is read" if transmits else "reflection",
    }
    bands = None if len(shares) == 1 else waves.tolist()
    return Listed(angles, values[:, None] * factor * shares, bands, quantity, facts)


def _factor(
    cursor: Cursor, tables: list[_Table], turns: np.ndarray, lights: list[np.ndarray], at: np.ndarray, quantity: str
) -> float:
    """What values times this reflect at the light that the spectrum is of: all of it.

    Between two angles of the light it is interpolated, and below the first it is that of the first.
    """
    turn = int(np.abs(turns - at[1]).argmin())
    first = sum(map(len, lights[:turn]))
    own = tables[first : first + len(lights[turn])]
    reflected = np.array([table.reflected(quantity) for table in own])
    order = np.argsort(lights[turn])
    found = float(np.interp(at[0], lights[turn][order], reflected[order]))
    if not (math.isfinite(found) and found > 0):
        raise cursor.bad("tables that reflect something", f"{found:g}")
    return 1 / found


def _spectrum(cursor: Cursor, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths and reflectances, 0 to 1: one where all are the same, else also at the ends of the visible range."""
    waves = _wavelengths(cursor, rows[:, 0])
    shares = rows[:, 1] / 100
    if not (np.isfinite(shares).all() and shares.min() >= 0):
        raise cursor.bad("reflectances from 0 % on", shown(rows[:, 1].tolist()))
    if np.ptp(shares) <= 1e-9:
        return waves[:1], shares[:1]
    every = np.unique([*waves, *(one for one in _ENDS if waves[0] < one < waves[-1])])
    return every, np.interp(every, waves, shares)


def _samples(path: Path, tables: list[_Table], lights: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Angles `(N, 4)` and values `(N,)` of tables, each of a turn of the grain and an angle of the light."""
    check_unpacked(path, _BYTES_A_SAMPLE * sum(table.values.size for table in tables))
    angles, values, seen = [], [], set()
    for table, (turn, light) in zip(tables, lights, strict=True):
        place = (round(turn % 360, 6), light)
        if place in seen:  # a whole turn
            continue
        seen.add(place)
        phi = table.phi[table.phi < table.phi[0] + 360 - _TOLERANCE]
        theta_o, phi_o = (one.reshape(-1) for one in np.meshgrid(table.theta, phi, indexing="ij"))
        of_light = np.broadcast_to([light, 180 - turn], (len(theta_o), 2))
        angles.append(np.concatenate([of_light, np.stack([theta_o, phi_o - turn], -1)], 1))
        values.append(table.values[:, : len(phi)].reshape(-1))
    return np.radians(np.concatenate(angles)), np.concatenate(values)


def _spectral(path: Path, cursor: TextCursor) -> Listed:
    """A `.brdf`: a table for each angle of the light and each wavelength."""
    reflects, transmits = _flags(cursor, cursor.numbers(2, "reflection and transmission"), "parts")
    (kind,) = _flags(cursor, cursor.numbers(1, "the kind of values"), "the kind of values")
    if not reflects:
        raise DataError(f"{path}: expected a reflection, found {'only a transmission' if transmits else 'none'}")
    size, bands = cursor.counts(2, "of angles of the light and wavelengths")
    lights = _lights(cursor, cursor.numbers(size, "angles of the light"))
    waves = _wavelengths(cursor, cursor.numbers(bands, "wavelengths"))
    quantity = _QUANTITIES[int(kind)]
    angles: list[np.ndarray] = []
    values = []
    for light in lights:
        columns = []
        for _ in waves:
            (percent,) = cursor.numbers(1, "a reflectance in percent")
            (table,) = _of_reflection(cursor, _tables(cursor, 1))
            reflected = table.reflected(quantity)
            if not (math.isfinite(percent) and percent >= 0 and (reflected > 0 or not percent)):
                raise cursor.bad("a table that reflects something, and how much", f"{percent:g} and {reflected:g}")
            place, column = _samples(path, [table], [(0.0, light)])
            columns.append(column * (percent / 100 / reflected if percent else 0))
            if len(columns) > 1 and not np.array_equal(place, angles[-1]):
                raise cursor.bad("the same angles for all wavelengths", "others")
            if len(columns) == 1:
                angles.append(place)
        values.append(np.stack(columns, -1))
    facts = {
        "scale": "each table such that it reflects what the file says",
        "parts": "reflection and transmission; the reflection is read" if transmits else "reflection",
    }
    return Listed(np.concatenate(angles), np.concatenate(values), waves.tolist(), quantity, facts)
