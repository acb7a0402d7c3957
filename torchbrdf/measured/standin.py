"""Fitted models in the place of measurements: the records of a `fits.json`, on MERL's bins."""

import importlib.resources
import logging
import math
import warnings
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchbrdf.errors import one_line
from torchbrdf.lobes import FitRecord, Sum, model_of, read_fits
from torchbrdf.lobes.model import component_kinds
from torchbrdf.lobes.parts import MANIFEST, fit_folder
from torchbrdf.measured.bands import (
    BANDS,
    DEFAULT_ILLUMINANT,
    ILLUMINANTS,
    KEEP,
    bands_in_words,
    check_same_bands,
    colors_label,
)
from torchbrdf.measured.colors import weights_of
from torchbrdf.measured.format import FORMATS, BrdfFormat, Interpolation, Lookup
from torchbrdf.measured.grid import chunks
from torchbrdf.measured.merl import bin_centers
from torchbrdf.pairs import Pairs
from torchbrdf.solvers import Status

# Of a turn.
_GOLDEN = math.pi * (3 - math.sqrt(5))
# How fits end of which nothing is to be shown.
FAILED = (Status.NOT_FINITE, Status.NO_DATA, Status.TOO_FEW_SAMPLES, Status.BAD_START, Status.LOST)


log = logging.getLogger("torchbrdf")


class FailedFitWarning(UserWarning):
    """A fit that failed stands in a material's place.

    Example:
        >>> import warnings
        >>> warnings.simplefilter("ignore", FailedFitWarning)
    """


@FORMATS.register("fits")
class StandIn(BrdfFormat):
    """The format of `fits.json`: models in the place of measurements.

    Each record gives a material, whose values are the model's, anywhere.
    `pairs` are MERL's bins, so that what was made for measured tables can be tried on models; whatever shows them
    says that they are stand-ins. Where a lobe has a grain their half vectors lie at azimuths all
    round. A material with several fits in a file is named with the model, lobes and loss.
    """

    format = "fits"
    settings: ClassVar[Mapping[str, tuple[str, ...]]] = {"bands": BANDS, "illuminant": ILLUMINANTS}
    stand_in = True
    is_sampled = False
    on_merl_bins = True
    one_a_file = False
    is_joined = True

    def __init__(
        self, records: list[FitRecord], paths: Sequence[Path], settings: Mapping[str, str] | None = None
    ) -> None:
        self.records, self.told = records, dict(settings or {})
        self.paths = list(paths)
        materials = [record.material for record in records]
        self.names = [
            record.material if materials.count(record.material) == 1 else _full_name(record) for record in records
        ]
        self.is_anisotropic = any(map(_has_grain, records))
        self.pairs = all_round(bin_centers()) if self.is_anisotropic else bin_centers()
        if self.told.get("bands") == KEEP:
            self._keep_bands()
        for record, where in zip(records, self._origins, strict=True):
            self._weights(record, where)  # says if there are none
        self._models = lru_cache(8)(self._batched)  # a renderer asks for the same ones again and again

    def _keep_bands(self) -> None:
        """Take the channels that all records have."""
        first = self.records[0]
        self.channels, lengths = first.channels, first.wavelengths
        self.wavelengths = None if lengths is None else tuple(lengths)
        check_same_bands(self._origins, [_bands_of(record) for record in self.records])

    @property
    def _origins(self) -> list[str]:
        """Of each record its file, if it has one, and material, for errors."""
        files = [f"{path}: " for path in self.paths] or [""] * len(self.records)
        return [f"{file}{record.material}" for file, record in zip(files, self.records, strict=True)]

    def select(self, materials: list[int]) -> "StandIn":
        """Some materials, with the names that they have here."""
        paths = [self.paths[k] for k in materials] if self.paths else []
        return _named([self.records[k] for k in materials], paths, self.told, [self.names[k] for k in materials])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as its records and names."""
        return _named, (self.records, self.paths, self.told, list(self.names))

    @classmethod
    def joined(cls, sources: Sequence[BrdfFormat]) -> BrdfFormat:
        """One source of several, whose files are not read again."""
        own = [one for one in sources if isinstance(one, StandIn)]
        records = [record for one in own for record in one.records]
        paths = [path for one in own for path in one.paths]
        return sources[0] if len(sources) == 1 else cls(records, paths, sources[0].told)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is a `fits.json`, by the bracket of a list of objects; or the manifest of a folder of fits."""
        return b"".join(head.split()).startswith(b"[{") or (path.name == MANIFEST and fit_folder(path) is not None)

    @classmethod
    def open(cls, paths: Sequence[Path], settings: Mapping[str, str] | None = None) -> "StandIn":
        """Read records of fits; a DataError says what is wrong with which."""
        records: list[FitRecord] = []
        origin: list[Path] = []
        for path in paths:
            found = read_fits(path)
            for record in found:
                if record.status in FAILED:
                    failed = f"the fit failed ({record.status}), its parameters say nothing of the material"
                    warnings.warn(f"{path}: {record.material}: {failed}", FailedFitWarning, stacklevel=2)
            records += found
            origin += [path] * len(found)
        source = cls(records, origin, settings)
        source._announce()
        return source

    def _announce(self) -> None:
        """Say once how the bands of fits become colours."""
        said = {}
        for record, path in zip(self.records[::-1], self.paths[::-1], strict=True):
            found = self._colors_of(record)
            if "colours" in found:
                said[f"{found['bands']} become {found['colours']}"] = path
        for words, path in said.items():
            log.warning("torchbrdf: %s: %s", path, words)

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """Values of models on some bins, float64, and weights 1."""
        values = self.at(self.pairs.select(samples=samples), materials, "linear").values
        return values, torch.ones_like(values[..., :1])

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values of models at any pairs; there is nothing to interpolate."""
        values = pairs.cos_i.new_empty((len(materials), len(pairs), self.channels))
        with torch.no_grad():
            for rows, model, colors in self._models(tuple(materials), pairs.dtype, pairs.device):
                for part, chunk in chunks(pairs):
                    found = model(chunk if pairs.shape[0] == 1 else chunk.select(rows))
                    values[rows, part] = found if colors is None else found @ colors
        return Lookup(values, torch.zeros(len(materials), dtype=torch.int64, device=pairs.device))

    def reading(self, material: int) -> dict[str, object]:
        """How the file was read: also what became of the bands of a fit."""
        return super().reading(material) | self._colors_of(self.records[material])

    def details(self, material: int) -> dict[str, object]:
        """The model, what it is a model of where that is said, and how far its pictures are from the material's."""
        record = self.records[material]
        source = record.extra.get("source")
        facts: dict[str, object] = {"model": record.model, "lobes": record.lobes}
        facts |= {"model of": one_line(source)} if isinstance(source, str) else {}
        facts |= self._colors_of(record)
        facts |= {"status": record.status} if record.status not in ("", Status.CONVERGED) else {}
        facts |= {f"{key} of {scene}": value for scene, own in record.pictures.items() for key, value in own.items()}
        facts |= {"read from": dict(record.reading)} if record.reading else {}
        return facts | {"parameters": dict(record.parameters)}

    def _batched(
        self, materials: tuple[int, ...], dtype: torch.dtype, device: torch.device
    ) -> list[tuple[list[int], Sum, Tensor | None]]:
        """Batched models, one for each kind of model; which of `materials` they are; what makes RGB of their bands."""
        kinds: dict[tuple[object, ...], list[int]] = {}
        for row, material in enumerate(materials):
            record = self.records[material]
            kinds.setdefault((record.model, record.lobes, *_bands_of(record)), []).append(row)
        found = []
        for rows in kinds.values():
            own = [self.records[materials[row]] for row in rows]
            colors = self._weights(own[0])
            model = model_of(own, torch.float32).to(device, dtype)
            found.append((rows, model, None if colors is None else colors.to(device, dtype)))
        return found

    def _weights(self, record: FitRecord, where: str = "") -> Tensor | None:
        """What makes RGB of a record's bands; None where values are to stay what they are."""
        if is_rgb(record) or self.told.get("bands") == KEEP:
            return None
        return weights_of(*_bands_of(record), self._illuminant, where or record.material)

    @property
    def _illuminant(self) -> str:
        return self.told.get("illuminant", DEFAULT_ILLUMINANT)

    def _colors_of(self, record: FitRecord) -> dict[str, object]:
        """The bands of a record, and what became of them."""
        if is_rgb(record):
            return {}
        said: dict[str, object] = {"bands": bands_in_words(*_bands_of(record))}
        if self.told.get("bands") != KEEP and (record.wavelengths or record.channels == 1):
            said["colours"] = colors_label(record.wavelengths or [0.0], self._illuminant)
        return said


def is_rgb(record: FitRecord) -> bool:
    """Whether a fit is one of linear RGB."""
    return record.channels == 3 and record.wavelengths is None


def _bands_of(record: FitRecord) -> tuple[int, tuple[float, ...] | None]:
    return record.channels, None if record.wavelengths is None else tuple(record.wavelengths)


def standins() -> Path:
    """Path of the bundled stand-ins of the paper's ten materials, for `load`.

    assets/README.md says how they were made.

    Example:
        >>> standins().name
        'standins.json'
    """
    return Path(str(importlib.resources.files("torchbrdf.assets") / "standins.json"))


def _has_grain(record: FitRecord) -> bool:
    return any(kind.is_anisotropic for kind in component_kinds(record.model, record.lobes))


def _named(records: list[FitRecord], paths: list[Path], told: Mapping[str, str], names: list[str]) -> StandIn:
    found = StandIn(records, paths, told)
    found.names = names
    return found


def all_round(pairs: Pairs) -> Pairs:
    """The same pairs with half vectors at azimuths all round, in no order: where a surface with a grain is compared.

    Args:
        pairs: `(..., N)`.

    Example:
        >>> angle = torch.tensor([0.1, 0.2])
        >>> all_round(Pairs.from_half_diff(angle, angle, angle)).is_oriented
        True
    """
    phi_h = torch.arange(len(pairs), dtype=torch.float64, device="cpu").mul(_GOLDEN).remainder(2 * math.pi)
    return Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d, phi_h.to(pairs.theta_h).expand(pairs.shape))


def _full_name(record: FitRecord) -> str:
    return "-".join([record.material, record.model, str(record.lobes), record.loss]).removesuffix("-")
