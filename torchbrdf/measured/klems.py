"""BSDF matrices of LBNL's WINDOW and of Radiance, XML: a value for each patch of light and each patch of viewer.

Source: J. H. Klems, A New Method for Predicting the Solar Heat Gain of Complex Fenestration Systems, 1994; WINDOW's
BSDF XML schema; the frame is that of Radiance (G. Ward).
"""

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.format import FORMATS, Interpolation
from torchbrdf.measured.gridded import crossed, polar
from torchbrdf.measured.listed import SETTINGS, Listed
from torchbrdf.measured.tristimulus import rgb_of_reflected
from torchbrdf.measured.window import (
    BANDS,
    SPECTRAL,
    Block,
    Document,
    WindowFormat,
    is_tree,
    is_window,
    numbers,
    read_window,
    text_of,
)

# The bounds of rings in degrees, from the normal on, and patches of each; files may define others.
_BASES = {
    "lbnl/klems full": ((5, 15, 25, 35, 45, 55, 65, 75, 90), (1, 8, 16, 20, 24, 24, 24, 16, 12)),
    "lbnl/klems half": ((6.5, 19.5, 32.5, 46.5, 61.5, 76.5, 90), (1, 8, 12, 16, 20, 12, 4)),
    "lbnl/klems quarter": ((9, 27, 46, 66, 90), (1, 8, 12, 12, 8)),
}
_MOST_PATCHES = 10_000
# Of rounding in a file, degrees.
_TOLERANCE = 1e-3


class Rings:
    """Patches of a hemisphere: rings about the normal, each parted into equal patches, the first about azimuth 0.

    Args:
        bounds: Where each ring ends, degrees, growing.
        counts: Patches of each.
    """

    def __init__(self, bounds: tuple[float, ...], counts: tuple[int, ...]) -> None:
        starts = (0.0, *bounds[:-1])
        middles = [0.0 if k == 0 and counts[0] == 1 else (starts[k] + bounds[k]) / 2 for k in range(len(bounds))]
        self.bounds = torch.deg2rad(torch.tensor(bounds, dtype=torch.float64, device="cpu"))
        self.middles = torch.deg2rad(torch.tensor(middles, dtype=torch.float64, device="cpu"))
        self.counts = torch.tensor(counts, dtype=torch.int64, device="cpu")
        self.first = self.counts.cumsum(0) - self.counts
        self.size = int(self.counts.sum())

    def angles(self) -> np.ndarray:
        """Angles from the normal and azimuths of the middles of patches, radians, `(size, 2)`."""
        turns = torch.arange(self.size, dtype=torch.int64, device="cpu") - self.first.repeat_interleave(self.counts)
        around = turns.double() * (2 * math.pi) / self.counts.repeat_interleave(self.counts)
        return torch.stack([self.middles.repeat_interleave(self.counts), around], -1).numpy()

    def around(self, theta: Tensor, phi: Tensor, interpolation: Interpolation) -> tuple[Tensor, Tensor]:
        """Patches of directions and their weights, `(N, k)`: the one that it is in, or the four about it."""
        bounds, middles = self.bounds.to(theta), self.middles.to(theta)
        last = len(bounds) - 1
        if interpolation == "nearest":
            ring = torch.searchsorted(bounds, theta.contiguous(), right=True).clamp(max=last)
            patch, _ = self._turned(ring, phi + math.pi / self.counts.to(theta.device)[ring])
            return patch[:, None], torch.ones_like(theta)[:, None]
        low = (torch.searchsorted(middles, theta.contiguous(), right=True) - 1).clamp(0, max(last - 1, 0))
        high = (low + 1).clamp(max=last)
        apart = torch.where(high > low, middles[high] - middles[low], 1)
        share = ((theta - middles[low]) / apart).clamp(0, 1)
        patches, weights = [], []
        for ring, part in ((low, 1 - share), (high, share)):
            patch, along = self._turned(ring, phi)
            start, count = self.first.to(theta.device)[ring], self.counts.to(theta.device)[ring]
            patches += [patch, start + (patch - start + 1) % count]
            weights += [part * (1 - along), part * along]
        return torch.stack(patches, -1), torch.stack(weights, -1)

    def _turned(self, ring: Tensor, phi: Tensor) -> tuple[Tensor, Tensor]:
        """The patch of a ring whose middle is at an azimuth or before it, and how far on it is, in patches."""
        count = self.counts.to(phi.device)[ring]
        place = phi * count / (2 * math.pi)
        low = place.floor()
        return self.first.to(phi.device)[ring] + low.to(torch.int64) % count, place - low


class _Patches(NamedTuple):
    """Every patch of light with every patch of viewer, light varying fastest.

    The patch of light at azimuth 0 is that with the mirror direction at azimuth 0.

    Attributes:
        light: Patches of light.
        viewer: Patches of viewer.
        turn: 1 where azimuths are counted as in the file, -1 where the other way round.
    """

    light: Rings
    viewer: Rings
    turn: int
    is_anisotropic: bool = True

    def angles(self) -> np.ndarray:
        """theta_i, phi_i, theta_o, phi_o of the middles of patches, radians, `(N, 4)`."""
        found = crossed(self.light.angles(), self.viewer.angles())
        found[:, 1] += math.pi
        found[:, 1::2] *= self.turn
        return found

    def around(self, wi: Tensor, wo: Tensor, interpolation: Interpolation) -> tuple[Tensor, Tensor]:
        """Pairs of the patches about light and viewer."""
        (theta_i, phi_i), (theta_o, phi_o) = polar(wi), polar(wo)
        light, part = self.light.around(theta_i, self.turn * phi_i - math.pi, interpolation)
        viewer, share = self.viewer.around(theta_o, self.turn * phi_o, interpolation)
        rows = viewer[:, :, None] * self.light.size + light[:, None, :]
        return rows.flatten(1), (share[:, :, None] * part[:, None, :]).flatten(1)


@FORMATS.register("klems")
class Klems(WindowFormat):
    """The format of WINDOW's BSDF XML, patches of Klems' bases or of one that the file defines; anisotropic.

    A value is a mean over two patches. Asked for as "nearest" it is constant on them; as "linear" it is linear in the
    angles between their middles.
    """

    format = "klems"
    colors = ("cie-x", "visible", "cie-z")
    has_spectra = True
    settings: ClassVar = {
        **WindowFormat.settings,
        "band": ("auto", *BANDS, SPECTRAL),
        **{name: SETTINGS[name] for name in ("bands", "illuminant")},
    }

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is such a file, by its root, and no tensor tree."""
        return is_window(path, head) and not is_tree(path)

    def gridded(self, path: Path) -> tuple[Listed, _Patches]:
        """What a file says."""
        document = read_window(path)
        structure = document.structure.lower().removesuffix("s")
        if structure not in ("column", "row"):
            found = shown(document.structure)
            raise DataError(f"{path}: IncidentDataStructure: expected Columns, Rows or a TensorTree, found {found}")
        chosen = self.chosen(path, document)
        rings = [_rings(path, document, block) for block in chosen.blocks.values()]
        light, viewer, names = rings[0]
        if any((one.size, other.size) != (light.size, viewer.size) for one, other, _ in rings):
            raise DataError(f"{path}: expected values of all bands at the same patches, found others")
        by_row = structure == "row"
        matrices = [_matrix(path, block, light.size, viewer.size, by_row) for block in chosen.blocks.values()]
        values = np.stack(matrices, -1)
        patches = _Patches(light, viewer, 1 if chosen.side == "back" else -1)
        facts = {
            "angles": f"patches of {shown(names)}; the mirror direction of a patch is the patch of its number",
            "values": "means over patches; between their middles linear in the angles",
            **chosen.facts,
        }
        if tuple(chosen.blocks) == self.colors:
            values = rgb_of_reflected(values)
            facts["tristimulus values"] = "made linear RGB (BT.709); what reflects all alike is white"
        listed = Listed(patches.angles(), values, chosen.wavelengths, self.setting("quantity", "brdf"), facts)
        return listed, patches


def _rings(path: Path, document: Document, block: Block) -> tuple[Rings, Rings, str]:
    """The patches of light and of viewer, and what their bases are called."""
    defined = {}
    for element in document.definition.findall("AngleBasis"):
        defined[text_of(element, "AngleBasisName").lower()] = element
    found, names = [], []
    for which in ("ColumnAngleBasis", "RowAngleBasis"):
        name = block.said(which) or (next(iter(defined)) if len(defined) == 1 else "")
        names.append(name)
        own = defined.get(name.lower())
        if own is not None and (name.lower() not in _BASES or own.find("AngleBasisBlock/ThetaBounds") is not None):
            found.append(_defined(path, name, own))
        elif name.lower() in _BASES:
            found.append(Rings(*_BASES[name.lower()]))
        else:
            known = shown(", ".join([*defined, *_BASES]), 120)
            raise DataError(f"{path}: {which}: expected one of {known}, found {shown(name)}")
    return found[0], found[1], " and ".join(dict.fromkeys(names))


def _defined(path: Path, name: str, element: ET.Element) -> Rings:
    """A basis as the file defines it."""
    where = f"AngleBasis {shown(name)}"
    bounds: list[float] = []
    counts: list[int] = []
    rings = element.findall("AngleBasisBlock")
    given = any(ring.find("ThetaBounds") is not None for ring in rings)
    limits = [_limits(path, where, ring) for ring in rings] if given else _by_middles(path, where, rings)
    for ring, limit in zip(rings, limits, strict=True):
        count = text_of(ring, "nPhis")
        found = [*limit, *numbers(path, where, count)]
        before = bounds[-1] if bounds else 0.0
        good = len(found) == 3 and abs(found[0] - before) <= _TOLERANCE and before < found[1] <= 90 + _TOLERANCE
        if not (good and found[2] >= 1 and found[2] == math.floor(found[2]) and found[2] <= _MOST_PATCHES):
            expected = f"expected a ring from {before:g} degrees on and its count of patches"
            raise DataError(f"{path}: {where}: {expected}, found {shown(' '.join([*map(str, limit), count]))}")
        bounds.append(min(float(found[1]), 90.0))
        counts.append(int(found[2]))
    if not 0 < sum(counts) <= _MOST_PATCHES:
        raise DataError(f"{path}: {where}: expected 1 to {_MOST_PATCHES} patches, found {sum(counts)}")
    return Rings(tuple(bounds), tuple(counts))


def _limits(path: Path, where: str, ring: ET.Element) -> list[float]:
    """Where a ring begins and ends, degrees; that of the normal may begin below 0."""
    texts = [text_of(ring, f"ThetaBounds/{one}") for one in ("LowerTheta", "UpperTheta")]
    found = numbers(path, where, " ".join(texts)).tolist()
    return [max(found[0], 0.0), *found[1:]] if found else []


def _by_middles(path: Path, where: str, rings: list[ET.Element]) -> list[list[float]]:
    """The same by the middles of rings, from the horizon on: a file needs not give more."""
    middles = numbers(path, where, " ".join(text_of(ring, "Theta") for ring in rings))
    limits: list[list[float]] = []
    end = 90.0
    for middle in middles[::-1]:
        limits.append([max(2 * middle - end, 0.0), end])
        end = 2 * middle - end
    return limits[::-1] if len(limits) == len(rings) else [[]] * len(rings)


def _matrix(path: Path, block: Block, light: int, viewer: int, by_row: bool) -> np.ndarray:
    """Values of all pairs of patches, light varying fastest, `(viewer light,)`."""
    where = f"{block.direction}, {block.band}"
    found = numbers(path, where, block.said("ScatteringData"))
    if len(found) != light * viewer:
        raise DataError(f"{path}: {where}: expected {light} x {viewer} numbers, found {len(found)}")
    return found.reshape(light, viewer).T.reshape(-1) if by_row else found
