"""Formats whose files list directions and values, in no order that a reader could rely on."""

import logging
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from torchbrdf.errors import DataError
from torchbrdf.measured.angles import UNITS, direction
from torchbrdf.measured.bands import (
    BANDS,
    DEFAULT_ILLUMINANT,
    ILLUMINANTS,
    KEEP,
    RGB,
    bands_in_words,
    check_same_bands,
    colors_label,
    rgb_weights,
)
from torchbrdf.measured.format import BrdfFormat, padded_pairs, reopened
from torchbrdf.measured.grain import GRAINS, Grain, azimuths, grain_of
from torchbrdf.measured.notices import notice
from torchbrdf.measured.summary import ALIKE, are_any_repeated, repeated, summary
from torchbrdf.pairs import Pairs

log = logging.getLogger("torchbrdf")

LEAST_COSINE = 1e-4
"""Directions nearer to the horizon are at it, but for rounding: what is said there is no BRDF's value."""
LARGEST_VALUE = 1e8
"""Larger values, in 1/sr, are no reflectance."""
_AT_HORIZON = "at the horizon"
# The share of samples below 0 that is no longer noise.
_MANY_NEGATIVE = 0.1
# Numbers of directions up to which they are kept for the next file.
_FEW = 1_000_000
QUANTITIES = ("brdf", "brdf_cosine", "reflectance_factor")
SETTINGS: Mapping[str, tuple[str, ...]] = {
    "angles": UNITS,
    "bands": BANDS,
    "grain": GRAINS,
    "illuminant": ILLUMINANTS,
    "quantity": QUANTITIES,
}
"""What a reader may be told that a file does not say, and the values of each."""


@dataclass(frozen=True)
class Listed:
    """What one file says.

    Args:
        angles: theta_i and phi_i of the light, theta_o and phi_o of the viewer, radians, `(N, 4)`; a theta below 0 is
            on the other side.
        values: What was measured, `(N, W)`, nan where nothing was.
        wavelengths: Of the bands, nm, growing, W; None for linear RGB.
        quantity: What the values are, one of `QUANTITIES`.
        facts: What else the file, or how it was read, has to say, by name.
        grain: One of `GRAINS`: whether the file says that it is of an anisotropic material.
        table: What values are interpolated in, of formats that hold one.
    """

    angles: np.ndarray
    values: np.ndarray
    wavelengths: Sequence[float] | None
    quantity: str = "brdf"
    facts: Mapping[str, object] = field(default_factory=dict)
    grain: str = GRAINS[0]
    table: Any = None

    def directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors to the light and to the viewer, `(N, 3)`."""
        theta_i, phi_i, theta_o, phi_o = self.angles.T
        return direction(theta_i, phi_i), direction(theta_o, phi_o)


class _Directions(NamedTuple):
    """The directions of a file's samples, and what follows of them alone: an instrument's files often share them.

    `are_any_repeated` is false where no two samples have the same ones; `has_azimuths` where the light has only one.
    """

    angles: np.ndarray
    wi: np.ndarray
    wo: np.ndarray
    above: np.ndarray
    tensors: tuple[Tensor, Tensor]
    are_any_repeated: bool
    has_azimuths: bool

    @classmethod
    def of(cls, listed: Listed) -> "_Directions":
        """Those of a file."""
        wi, wo = listed.directions()
        for one in (wi, wo):
            one[np.abs(one[:, 2]) <= LEAST_COSINE, 2] = 0
        above = np.minimum(wi[:, 2], wo[:, 2]) > 0
        tensors = torch.from_numpy(wi), torch.from_numpy(wo)
        return cls(listed.angles, wi, wo, above, tensors, are_any_repeated(wi, wo), azimuths(wi[above]) > 1)


_last: list[_Directions] = []


def _directions(listed: Listed) -> _Directions:
    """Those of a file; of the one before, if they are the same."""
    known = _last[:1]
    if not known or not np.array_equal(known[0].angles, listed.angles):
        known = [_Directions.of(listed)]
        _last[:] = known if listed.angles.size <= _FEW else []
    return known[0]


def _left_out(known: _Directions, read: np.ndarray, large: np.ndarray) -> list[str]:
    """Which samples are none, and why: how many of each kind."""
    below = np.minimum(known.wi[:, 2], known.wo[:, 2])
    kinds = {
        "whose light or viewer is below the horizon": ~known.above & (below < 0),
        _AT_HORIZON: ~known.above & (below == 0),
        "without a value": known.above & ~read,
        f"whose values are above {LARGEST_VALUE:g} / sr": large,
    }
    return [f"{int(one.sum())} {kind}" for kind, one in kinds.items() if one.any()]


class Opened(NamedTuple):
    """What was read of one file: directions, values and validity of N samples, facts, and the rest."""

    wi: Tensor
    wo: Tensor
    values: Tensor
    valid: Tensor
    facts: dict[str, object]
    wavelengths: tuple[float, ...] | None
    grain: Grain
    table: Any


class ListedFormat(BrdfFormat):
    """Base of formats whose files list directions and values. A subclass gives `recognises` and `parse`.

    Values become a BRDF in 1/sr when a file is opened, and RGB unless bands are kept; how, `details` says. Negative
    values stay: noise has two sides. Samples that are not finite, too large for a reflectance, or not above the horizon
    get weight 0.

    Args:
        paths: Files that `recognises` said yes to.
        settings: What their reader is told, see `SETTINGS`.
    """

    settings: ClassVar[Mapping[str, tuple[str, ...]]] = SETTINGS
    is_joined: ClassVar[bool] = True

    def __init__(self, paths: Sequence[Path], settings: Mapping[str, str] | None = None) -> None:
        self.paths = list(paths)
        self.names = [path.stem for path in paths]
        self.told = dict(settings or {})
        self._take([self._opened(path) for path in paths])

    def _take(self, read: list[Opened]) -> None:
        """Be the format of what was read of the files."""
        self._read = read
        self.channels, self.wavelengths = read[0].values.shape[1], read[0].wavelengths
        check_same_bands(self.paths, [(one.values.shape[1], one.wavelengths) for one in read])
        self.is_anisotropic = any(map(self.has_grain, range(len(read))))

    @classmethod
    def joined(cls, sources: Sequence[BrdfFormat]) -> BrdfFormat:
        """One source of several, whose files are not read again."""
        if len(sources) == 1:
            return sources[0]
        found = cls.__new__(cls)
        found.paths = [path for one in sources for path in one.paths]
        found.names = [name for one in sources for name in one.names]
        found.told = dict(sources[0].told)
        found._take([read for one in sources if isinstance(one, ListedFormat) for read in one._read])
        return found

    def _opened(self, path: Path) -> Opened:
        listed = self.parse(path)
        if not len(listed.values):
            raise DataError(f"{path}: expected samples, found none")
        values, words, wavelengths = self._in_colors(listed)
        known = _directions(listed)
        wi, wo, above = known.wi, known.wo, known.above
        with np.errstate(invalid="ignore"):
            values *= _factor(listed.quantity, wo[:, 2])
            valid = above & (np.abs(values) <= LARGEST_VALUE).all(1)
            large = above & (np.abs(values) > LARGEST_VALUE).any(1)
            values_read = np.isfinite(values).all(1) | large
        if not valid.any():
            if above.any():
                expected = f"expected values up to {LARGEST_VALUE:g} / sr, found"
                finite = np.abs(values[above])[np.isfinite(values[above])]
                raise DataError(f"{path}: {expected} {f'{finite.min():.3g} and more' if finite.size else 'none'}")
            raise DataError(f"{path}: expected valid samples above the horizon, found none among {len(valid)}")
        facts = {"quantity": _WORDS[listed.quantity], **listed.facts, "colours": words}
        values[~valid] = 0
        grain, told = Grain(False, {}), self.setting("grain", GRAINS[0])
        if known.are_any_repeated and (again := repeated(wi[valid], wo[valid], values[valid])):
            facts["repeated directions"] = again
            if not again.endswith(ALIKE):
                notice(path, f"repeated directions: {again}")
        if said := _left_out(known, values_read, large):
            facts["left out"] = f"{', '.join(said)}, of {len(valid)} samples"
            if any(_AT_HORIZON not in one for one in said):
                notice(path, f"left out: {facts['left out']}")
        negative = (values[valid] < 0).any(1).mean()
        if negative > _MANY_NEGATIVE:
            notice(path, f"{100 * negative:.3g} % of the samples are below 0, as no reflectance is")
        own = listed.grain if told == GRAINS[0] else told
        if known.has_azimuths or own == "anisotropic":
            grain = grain_of(wi[valid], wo[valid], values[valid].mean(-1), own)
        found, good = torch.from_numpy(values), torch.from_numpy(valid)
        return Opened(*known.tensors, found, good, facts | grain.facts, wavelengths, grain, listed.table)

    def _in_colors(self, listed: Listed) -> tuple[np.ndarray, str, tuple[float, ...] | None]:
        """Values as linear RGB, or in bands, how they became so, and the wavelengths of bands."""
        if self.setting("bands", RGB) == KEEP:
            lengths = listed.wavelengths
            count = listed.values.shape[1]
            own = None if lengths is None else tuple(map(float, lengths))
            words = _AS_IT_IS if own is None and count == 3 else f"none: {bands_in_words(count, own)}, as they are"
            return np.array(listed.values, dtype=np.float64), words, own
        return *in_colors(listed, self.setting("illuminant", DEFAULT_ILLUMINANT)), None

    @classmethod
    def open(cls, paths: Sequence[Path], settings: Mapping[str, str] | None = None) -> "ListedFormat":
        """Read and check files; DataError for the first that is bad."""
        source = cls(paths, settings)
        source._announce()
        return source

    def _announce(self) -> None:
        """Say once how bands became colours, where they are so few that others would have been as good."""
        said = {one.facts["colours"]: path for path, one in zip(self.paths[::-1], self._read[::-1], strict=True)}
        for words, path in said.items():
            if words != _AS_IT_IS:
                log.info("torchbrdf: %s: colours: %s", path, words)

    @abstractmethod
    def parse(self, path: Path) -> Listed:
        """What a file says; DataError if it is bad."""

    def setting(self, name: str, default: str) -> str:
        """What the reader was told, or what it takes where it was not."""
        return self.told.get(name, default)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as the paths of its files."""
        return reopened(self, self.told)

    @cached_property
    def _samples(self) -> tuple[Pairs, Tensor, Tensor]:
        """Pairs `(1, N)` where all files have the same, else `(M, N)`; values `(M, N, C)` and weights `(M, N, 1)`."""
        first = self._read[0]
        shared = all(torch.equal(one.wi, first.wi) and torch.equal(one.wo, first.wo) for one in self._read[1:])
        values = pad_sequence([one.values for one in self._read], batch_first=True)
        weight = pad_sequence([one.valid for one in self._read], batch_first=True)[..., None].double()
        if shared:
            return Pairs.from_directions(first.wi[None], first.wo[None]), values, weight
        return padded_pairs([one.wi for one in self._read], [one.wo for one in self._read]), values, weight

    @cached_property
    def pairs(self) -> Pairs:  # type: ignore[override]
        """Where the values were measured."""
        return self._samples[0]

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """The measured values and their weights, float64."""
        _, values, weight = self._samples
        return values[materials][:, samples], weight[materials][:, samples]

    def reading(self, material: int) -> dict[str, object]:
        """How the file was read: also what it says of itself, and what was believed of that."""
        return super().reading(material) | self._read[material].facts

    def details(self, material: int) -> dict[str, object]:
        """What the file says of itself, how it was read, and what its samples are like."""
        one = self._read[material]
        wi, wo, values, valid = (part.numpy() for part in (one.wi, one.wo, one.values, one.valid))
        return {**one.facts, **summary(wi, wo, values, valid, one.grain.is_there)}

    def has_grain(self, material: int) -> bool:
        """Whether a material's samples are anisotropic."""
        return self._read[material].grain.is_there


_AS_IT_IS = "RGB as the file has it"
_WORDS = {
    "brdf": "BRDF, 1/sr",
    "brdf_cosine": "BRDF times the cosine of the viewer's angle; divided by it",
    "reflectance_factor": "reflectance factor; divided by pi",
}


def in_colors(listed: Listed, illuminant: str) -> tuple[np.ndarray, str]:
    """Values as linear RGB, `(N, 3)`, and how they became so."""
    if listed.values.shape[1] == 1:
        return np.repeat(listed.values, 3, 1).astype(np.float64), colors_label([0.0])
    if listed.wavelengths is None:
        return np.array(listed.values, dtype=np.float64), _AS_IT_IS
    with np.errstate(invalid="ignore", over="ignore"):
        found = listed.values @ rgb_weights(listed.wavelengths, illuminant)
    return found, colors_label(listed.wavelengths, illuminant)


def _factor(quantity: str, cos_o: np.ndarray) -> np.ndarray | float:
    """What a quantity is multiplied by to be a BRDF, a number or `(N, 1)`."""
    if quantity == "brdf":
        return 1.0
    return 1 / np.pi if quantity == "reflectance_factor" else 1 / np.maximum(cos_o, LEAST_COSINE)[:, None]
