"""Fitted models in the place of measurements: the records of a `fits.json`, on MERL's bins."""

import importlib.resources
import math
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import one_line
from torchbrdf.lobes import FitRecord, Sum, model_of, read_fits
from torchbrdf.lobes.model import component_kinds
from torchbrdf.measured.format import FORMATS, BrdfFormat, Interpolation, Lookup
from torchbrdf.measured.grid import chunks
from torchbrdf.measured.merl import bin_centers
from torchbrdf.pairs import Pairs
from torchbrdf.solvers import Status

# Of a turn.
_GOLDEN = math.pi * (3 - math.sqrt(5))
# How fits end of which nothing is to be shown.
FAILED = (Status.NOT_FINITE, Status.NO_DATA, Status.TOO_FEW_SAMPLES, Status.BAD_START, Status.LOST)


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
    stand_in = True
    on_merl_bins = True

    def __init__(self, records: list[FitRecord], paths: Sequence[Path]) -> None:
        self.records = records
        self.paths = list(paths)
        materials = [record.material for record in records]
        self.names = [
            record.material if materials.count(record.material) == 1 else _full_name(record) for record in records
        ]
        self.is_anisotropic = any(map(_has_grain, records))
        self.pairs = _turned(bin_centers()) if self.is_anisotropic else bin_centers()
        self._models = lru_cache(8)(self._batched)  # a renderer asks for the same ones again and again

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as its records."""
        return StandIn, (self.records, self.paths)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is a `fits.json`, by the bracket of a list of objects."""
        return b"".join(head.split()).startswith(b"[{")

    @classmethod
    def open(cls, paths: Sequence[Path]) -> "StandIn":
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
        return cls(records, origin)

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """Values of models on some bins, float64, and weights 1."""
        values = self.at(self.pairs.select(samples=samples), materials, "linear").values
        return values, torch.ones_like(values[..., :1])

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values of models at any pairs; there is nothing to interpolate."""
        values = pairs.cos_i.new_empty((len(materials), len(pairs), 3))
        with torch.no_grad():
            for rows, model in self._models(tuple(materials), pairs.dtype, pairs.device):
                for part, chunk in chunks(pairs):
                    own = chunk if pairs.shape[0] == 1 else chunk.select(rows)
                    values[rows, part] = model(own)
        return Lookup(values, torch.zeros(len(materials), dtype=torch.int64, device=pairs.device))

    def details(self, material: int) -> dict[str, object]:
        """The model, what it is a model of where that is said, and how far its pictures are from the material's."""
        record = self.records[material]
        source = record.extra.get("source")
        facts: dict[str, object] = {"model": record.model, "lobes": record.lobes}
        facts |= {"model of": one_line(source)} if isinstance(source, str) else {}
        facts |= {"status": record.status} if record.status not in ("", Status.CONVERGED) else {}
        facts |= {f"{key} of {scene}": value for scene, own in record.pictures.items() for key, value in own.items()}
        return facts | {"parameters": dict(record.parameters)}

    def _batched(
        self, materials: tuple[int, ...], dtype: torch.dtype, device: torch.device
    ) -> list[tuple[list[int], Sum]]:
        """Batched models, one for each kind of model, and which of `materials` they are."""
        kinds: dict[tuple[str, int], list[int]] = {}
        for row, material in enumerate(materials):
            record = self.records[material]
            kinds.setdefault((record.model, record.lobes), []).append(row)
        return [
            (rows, model_of([self.records[materials[row]] for row in rows], torch.float32).to(device, dtype))
            for rows in kinds.values()
        ]


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


def _turned(pairs: Pairs) -> Pairs:
    """The same pairs with half vectors at azimuths all round, in no order."""
    phi_h = torch.arange(len(pairs), dtype=torch.float64, device="cpu") * _GOLDEN
    return Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d, phi_h.remainder(2 * math.pi)[None])


def _full_name(record: FitRecord) -> str:
    return "-".join([record.material, record.model, str(record.lobes), record.loss]).removesuffix("-")
