"""`convert`: one call from a measured file, or a fit, to a file of another format, which is read back and compared."""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.export.api import find_exporter, material_of, sources
from torchbrdf.export.base import EXPORTERS, Brdf, Material
from torchbrdf.export.listing import values_in_bands, wavelengths_of
from torchbrdf.export.materials import find_materials
from torchbrdf.export.tables import TableExporter
from torchbrdf.files import replacing, writable
from torchbrdf.lobes import FitRecord, Lobe
from torchbrdf.measured import Measured, load
from torchbrdf.measured.bands import rgb_weights
from torchbrdf.measured.measured import FAR
from torchbrdf.measured.notices import own_files
from torchbrdf.names import distinct_stems, same_file
from torchbrdf.pairs import Pairs
from torchbrdf.progress import Progress, quiet
from torchbrdf.reading import exists

WITHIN = 75.0
"""Degrees from the normal of both directions up to which what was written is compared with the original."""
COMPARED = 6000
"""Pairs of directions of that: half of them uniform in their angles, half about the highlight."""
# Samples of what was written that are asked how far the original's nearest is, at most.
_ASKED = 50_000
# Of the mean value: differences of smaller values are relative to it.
_SMALL = 1e-3
SAME = 1e-3
"""Of what is exact, the largest relative difference of 95 % of directions, which rounding makes in text."""

Source = Brdf | FitRecord | str | os.PathLike[str]


@dataclass(frozen=True)
class Converted:
    """What was written, how much of it was never measured, and how near it is to the original when it is read again.

    Args:
        material: Its name.
        path: The file.
        to: The format, as exporters are called.
        exact: Whether it holds the measurement's own samples, or is its own file, and what is read back is the same.
        notes: What was resampled, and what the format has no place for.
        samples: In the file, above the horizon.
        extrapolated: How many of them are more than 12 degrees from every sample of the original; None of a model,
            which has values everywhere.
        median: Of the relative difference from the original, within 75 degrees of the normal.
        high: Its 95th percentile.
    """

    material: str
    path: Path
    to: str
    exact: bool
    notes: Sequence[str]
    samples: int
    extrapolated: int | None
    median: float
    high: float

    def lines(self) -> list[str]:
        """All of it in words."""
        near = f"within the measured range ({FAR:g} degrees from one of the original's)"
        if self.extrapolated is None:
            how = "samples of a model: nothing is extrapolated"
        elif self.extrapolated:
            how = f"samples: {self.samples - self.extrapolated} {near}, {self.extrapolated} extrapolated"
        else:
            how = f"samples, all {near}"
        return [
            f"{self.path}  {self.material}: {'exact' if self.exact else 'not exact'}",
            *(f"  {note}" for note in self.notes),
            f"  {self.samples} {how}",
            f"  read back, within {WITHIN:g} degrees of the normal: relative difference {100 * self.median:.2g} % "
            f"(median), {100 * self.high:.2g} % (95th percentile)",
        ]

    def to_dict(self) -> dict[str, object]:
        """All of it as plain values."""
        return {**asdict(self), "path": str(self.path), "notes": list(self.notes)}


def convert(
    source: Source | Sequence[Source],
    out: str | os.PathLike[str],
    to: str | None = None,
    *,
    settings: Mapping[str, str] | None = None,
    bad: list[TorchbrdfError] | None = None,
    progress: Progress = quiet,
) -> list[Converted]:
    """Write measured BRDFs, or fits, in another format, and read back what was written.

    Args:
        source: A file, a folder of files, a `Measured` of one material, a lobe, a record of a fit; or several of those.
        out: The file; or a folder, if it is one, if there are several materials, or if it has no suffix.
        to: The format: "merl", "rgl", "ssdd", "astm", "csv", or another exporter of tables; by default told by the
            suffix of `out`.
        settings: What files do not say, as of `torchbrdf.load`.
        bad: Takes the errors of materials that cannot be converted, so that the others are; None raises the first.
        progress: Of the materials.

    Returns:
        What was written of each material.

    Raises:
        UsageError: The format is unknown, or several materials are to be one file.
        DataError: A file cannot be read or written, or is the source itself; without `bad`.

    Example:
        >>> import torchbrdf
        >>> from torchbrdf.lobes import GGX
        >>> (done,) = torchbrdf.convert(GGX(roughness=0.3), "paint.csv")
        >>> done.samples > 10_000, done.extrapolated, done.median < 0.01
        (True, None, True)
    """
    out = Path(out)
    name = to or to_of(out)
    exporter = find_table(name)
    problems: list[TorchbrdfError] = []
    materials = _materials(source, problems, settings)
    if bad is None and problems:
        raise problems[0]
    done: list[Converted] = []
    places = _places(materials, out, exporter, as_folder=to is not None)
    materials = [_renamed(material, path, materials) for material, path in zip(materials, places, strict=True)]
    read = [file for material in materials for file in sources(material) if file.exists()]
    for k, (material, path) in enumerate(zip(materials, places, strict=True)):
        progress(k, len(materials))
        try:
            _check_place(path, read)
            done.append(_written(material, path, name, exporter))
        except TorchbrdfError as error:
            if bad is None:
                raise
            said = str(error)
            problems.append(error if material.name in said else DataError(f"{material.name}: {said}"))
    progress(len(materials), len(materials))
    if bad is not None:
        bad += problems
    return done


def table_names() -> dict[str, str]:
    """The exporters of tables, by name, and the suffix of each.

    Example:
        >>> table_names()["ssdd"]
        '.ssdd'
    """
    return {name: kind.suffix for name, kind in EXPORTERS.items() if issubclass(kind, TableExporter)}


def to_of(out: Path) -> str:
    """The format that a file's suffix tells; a UsageError where it tells none."""
    known = table_names()
    found = [name for name, suffix in known.items() if suffix == out.suffix.lower()]
    if not found:
        raise UsageError(f"convert: expected a file that ends with {', '.join(known.values())}, or --to, found {out}")
    return found[0]


def find_table(name: str) -> TableExporter:
    """The exporter of tables of a name."""
    exporter = find_exporter(name)
    if not isinstance(exporter, TableExporter):
        raise UsageError(f"convert: expected one of {', '.join(table_names())}, found {name}; see torchbrdf export")
    return exporter


def _materials(
    source: Source | Sequence[Source], bad: list[TorchbrdfError], settings: Mapping[str, str] | None
) -> list[Material]:
    several = list(source) if isinstance(source, Sequence) and not isinstance(source, str) else [source]
    found: list[Material] = []
    for one in several:
        if isinstance(one, str | os.PathLike):
            found += find_materials([one], bad, settings=settings)
        elif isinstance(one, Measured):
            found += [material_of(one.batch([k])) for k in range(len(one))]
        else:
            found.append(material_of(one))
    if not found and not bad:
        raise UsageError("convert: expected at least one material, found none")
    return found


def _places(materials: Sequence[Material], out: Path, exporter: TableExporter, as_folder: bool) -> list[Path]:
    """Where each material is written."""
    as_folder = (exists(out) and out.is_dir()) or not out.suffix or (as_folder and len(materials) != 1)
    if not as_folder:
        if len(materials) > 1:
            raise UsageError(f"convert: expected a folder for {len(materials)} materials, found {out}; say --to")
        return [out] * len(materials)
    folder = writable(out)
    stems = distinct_stems([material.name for material in materials])
    return [folder / f"{stem}{exporter.suffix}" for stem in stems]


def _renamed(material: Material, path: Path, materials: Sequence[Material]) -> Material:
    """A material with a note, where its file is not called as it is since another one's is."""
    alike = [one for one in materials if one is not material and same_file(one.name) == same_file(material.name)]
    if not alike or path.stem == material.name:
        return material
    own = f", read from {material.files[0]}" if material.files else ""
    note = f"called {path.name}{own}: {material.name} is the name of {len(alike)} other{'s' * (len(alike) > 1)}, too"
    return replace(material, notes=(note, *material.notes))


def _check_place(path: Path, read: Sequence[Path]) -> None:
    """Refuse to write over a file that is, or is still to be, converted."""
    if exists(path) and any(path.samefile(one) for one in read):
        raise DataError(f"{path}: expected another file than one that is converted, found the same")


def _written(material: Material, path: Path, to: str, exporter: TableExporter) -> Converted:
    """A material in its file, which is there when it was read back."""
    material = exporter.suited(material)
    writable(path.parent)
    with torch.no_grad(), replacing(path) as part, _named(part, path), own_files():
        exported = exporter.write_file(material, part)
        back = _read_back(part, material.brdf)
        samples, extrapolated = _beyond(material.brdf, back)
        median, high = _differences(material.brdf, back)
    notes = [*material.notes, *(note.replace(str(part), str(path)) for note in exported.notes)]
    if material.brdf.is_anisotropic and not back.is_anisotropic:
        notes.append("the grain is lost: what is read back does not depend on the azimuth of the light")
    exact = exported.exact and high <= SAME
    if exported.exact and not exact:
        notes = ["not exact: samples are as they were, values between them, as read back, are not", *notes]
    return Converted(material.name, path, to, exact, notes, samples, extrapolated, median, high)


@contextmanager
def _named(part: Path, path: Path) -> Iterator[None]:
    """Errors about a temporary file are about the one that it becomes."""
    try:
        yield
    except TorchbrdfError as error:
        raise type(error)(str(error).replace(str(part), str(path)).replace(part.name, path.name)) from error


def _read_back(path: Path, original: Brdf) -> Measured:
    """What was written, in its bands where the reader keeps them and the original has some."""
    back = load(path, dtype=torch.float64)
    if wavelengths_of(original) is None or "bands" not in back.source.settings:
        return back
    return load(path, dtype=torch.float64, settings={"bands": "keep"})


def _beyond(original: Brdf, back: Measured) -> tuple[int, int | None]:
    """How many samples were written, and how many of them are far from all of the original's."""
    valid = ((back.weight[0, :, 0] > 0) & back.pairs.above_horizon[0]).nonzero()[:, 0]
    if isinstance(original, Lobe) or original.stand_in:
        return len(valid), None
    some = valid[torch.linspace(0, len(valid) - 1, min(len(valid), _ASKED), dtype=torch.float64, device="cpu").long()]
    far = original.distance_at(back.pairs.select([0], some))[0] > FAR
    return len(valid), round(len(valid) * far.double().mean().item())


def _differences(original: Brdf, back: Measured) -> tuple[float, float]:
    """Median and 95th percentile of the relative difference from the original."""
    pairs = compared_pairs()
    expected, found = values_in_bands(original, pairs), values_in_bands(back, pairs)
    lengths = wavelengths_of(original)
    if lengths is not None and back.wavelengths is None:
        expected = expected @ torch.from_numpy(rgb_weights(lengths))
    elif expected.shape[1] == 1:  # grey is read as three equal channels
        expected = expected.expand_as(found)
    least = max(_SMALL * expected.abs().mean().item(), 1e-30)
    off = ((found - expected).abs() / expected.abs().clamp_min(least)).flatten()
    return off.median().item(), off.quantile(0.95).item()


def compared_pairs(count: int = COMPARED, seed: int = 0) -> Pairs:
    """Random pairs `(1, n)` within 75 degrees of the normal: half uniform in angles, half about the highlight.

    Args:
        count: Of pairs, about.
        seed: Of the random numbers.
    """
    generator = torch.Generator("cpu").manual_seed(seed)
    u = torch.rand(5, count, dtype=torch.float64, generator=generator, device="cpu")
    most = math.radians(WITHIN)
    theta_i, phi_i, phi = u[0] * most, 2 * math.pi * u[1], 2 * math.pi * u[2]
    # About the highlight: half vectors, denser towards the normal.
    other = torch.where(u[4] < 0.5, u[3] * most, u[3] ** 3 * (math.pi / 2))
    wi, turned = _directions(theta_i, phi_i), _directions(other, phi_i + phi)
    mirrored = 2 * (wi * turned).sum(-1, keepdim=True) * turned - wi
    wo = torch.where((u[4] < 0.5)[:, None], turned, mirrored)
    inside = wo[:, 2] >= math.cos(most)
    return Pairs.from_directions(wi[inside][None], wo[inside][None])


def _directions(theta: Tensor, phi: Tensor) -> Tensor:
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
