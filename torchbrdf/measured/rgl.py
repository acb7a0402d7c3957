"""RGL measurements: BRDFs sampled where they are bright, through a warp that the file brings along.

Source: J. Dupuy, W. Jakob, An Adaptive Parameterization for Efficient Material Acquisition and Rendering, 2018,
doi:10.1145/3272127.3275059; the database is at https://rgl.epfl.ch/materials.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.bands import check_same_bands
from torchbrdf.measured.format import FORMATS, BrdfFormat, Interpolation, Lookup, padded_pairs, reopened
from torchbrdf.measured.grid import chunks, interpolate, nearest_rows, nearest_valid, neighbours, weighted_rows
from torchbrdf.measured.rgl_spectra import SETTINGS, material_name, stored
from torchbrdf.measured.tensor_file import MAGIC, TensorFile
from torchbrdf.measured.warp import Warp
from torchbrdf.pairs import Pairs

LOWEST = math.cos(math.radians(89))
"""The least cosine that a stored value is divided by: interpolated towards the horizon, f cos does not quite vanish."""
HORIZON = 1e-5
"""Up to this cosine theta_i is 90 degrees, at which nothing can be measured: those values repeat the angle before."""
LEAST_STEP = 1e-4
"""Between two theta_i, in radians; those of the database are 0.15 apart and more."""
LEAST_VISIBLE, LARGEST_DENSITY, LARGEST_STORED = 1e-6, 1e8, 1e6
"""Bounds of sigma, of densities and of stored values; the database has 0.03, 8e3 and 20."""
TABLES = 32
"""Materials whose tables for `at` are kept, up to 6 MB each in float32."""


class RglFile:
    """RGL file, checked. A stored value is `spectrum = f cos_o 4 sigma(theta_i) / D(h)`, which hardly varies.

    theta_i is the elevation of wi, on a few angles; of wo the file knows the half vector, in coordinates
    u = (sqrt(2 theta_h / pi), (phi_h - phi_i + pi) / 2pi), spread evenly by the warp of `vndf`, the density of visible
    normals. `spectrum` lies on a grid of the evened coordinates, `(T, R, R, C)`.

    Of an anisotropic material there are several phi_i, `phi`, from -pi on, and u has phi_h itself; `spectrum` is
    `(P, T, R, R, C)`. Where they cover half a turn, turning by the other half changes nothing; where a quarter,
    mirroring at x and y.
    """

    def __init__(self, path: Path, told: Mapping[str, str] | None = None) -> None:
        file = TensorFile(path)
        self.phi, self.parts = _azimuths(file)
        around = 1 if self.phi is None else len(self.phi)
        theta = file.array("theta_i", [None])
        size = len(theta)
        if size < 2 or not (theta[0] >= 0 and theta[-1] < math.pi / 2 + 1e-6 and (np.diff(theta) > LEAST_STEP).all()):
            found = ", ".join(f"{angle:.4g}" for angle in theta[:8].tolist()) + (", ..." if size > 8 else "")
            raise DataError(f"{path}: theta_i: expected angles that grow from 0 to pi/2, found {found}")
        density = self._density(file, "vndf", [around, size, None, None])
        spectrum, self.wavelengths, self.colors = stored(file, around, size, told or {})
        if self.phi is None:
            density, spectrum = density[0], spectrum[0]
        if min(spectrum.shape[-2:]) < 2:
            raise DataError(f"{path}: values: expected a grid of 2 x 2 or more, found {spectrum.shape[-2:]}")
        with np.errstate(invalid="ignore"):
            self.finite = (np.abs(spectrum) <= LARGEST_STORED).all(-3)
        if not self.finite.any():
            raise DataError(f"{path}: values: no finite value of at most {LARGEST_STORED:g}")
        self.theta = torch.from_numpy(theta)
        self.warp = Warp(torch.from_numpy(density))
        self.spectrum = torch.from_numpy(np.where(self.finite[..., None], np.moveaxis(spectrum, -3, -1), 0))
        self.normals = torch.from_numpy(self._density(file, "ndf", [None, None]))
        self.visible = torch.from_numpy(self._density(file, "sigma", [None, None], LEAST_VISIBLE))
        self.has_factor = bool(file.array("jacobian", [1], "u")[0])

    @staticmethod
    def _density(file: TensorFile, name: str, shape: Sequence[int | None], least: float = 0) -> np.ndarray:
        value = file.array(name, shape)
        if min(value.shape[-2:]) < 2:
            raise DataError(f"{file.path}: {name}: expected a grid of 2 x 2 or more, found {value.shape[-2:]}")
        inside = (value >= least) & (value <= LARGEST_DENSITY)
        if not inside.all():
            odd = shown(float(value[~inside][0]))
            raise DataError(f"{file.path}: {name}: expected values from {least:g} to {LARGEST_DENSITY:g}, found {odd}")
        if not (value.sum((-2, -1)) > 0).all():
            raise DataError(f"{file.path}: {name}: expected a sum above 0, found only zeros")
        return value

    def factor(self, theta_i: Tensor, x: Tensor, y: Tensor, cos_o: Tensor, phi_i: Tensor | None = None) -> Tensor:
        """What f is in units of the stored value: D(h) / (4 sigma cos_o), where the file keeps D apart."""
        if not self.has_factor:
            return 1 / cos_o.clamp_min(LOWEST)
        turn = torch.full_like(theta_i, 0.5) if phi_i is None else _phi_to_unit(phi_i)
        visible = bilinear(self.visible, theta_to_unit(theta_i), turn)
        return bilinear(self.normals, x, y) / (4 * visible * cos_o.clamp_min(LOWEST))

    def samples(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """wi and wo `(n, 3)`, f `(n, C)` and validity `(n,)` where f was measured: every theta_i, every grid node."""
        height, width = self.spectrum.shape[-3:-1]
        u, v = (torch.linspace(0, 1, size, dtype=torch.float64, device="cpu") for size in (width, height))
        x, y = self.warp.sample(u, v).flatten(1, 2).unbind(-1)
        theta_h, phi_h = x.square() * (math.pi / 2), (2 * y - 1) * math.pi
        half = torch.stack([theta_h.sin() * phi_h.cos(), theta_h.sin() * phi_h.sin(), theta_h.cos()], -1)
        phi_i, theta_i = torch.meshgrid(self._turns(), self.theta, indexing="ij")
        phi_i, theta_i = phi_i.reshape(-1, 1), theta_i.reshape(-1, 1)
        wi = torch.stack([theta_i.sin() * phi_i.cos(), theta_i.sin() * phi_i.sin(), theta_i.cos()], -1)
        toward = (wi * half).sum(-1, keepdim=True)
        wi, wo = wi.expand_as(half), 2 * toward * half - wi
        turn = None if self.phi is None else phi_i.expand_as(x)
        factor = self.factor(theta_i.expand_as(x), x, y, wo[..., 2], turn)
        f = self.spectrum.reshape(*x.shape, -1) * factor[..., None]
        valid = (wi[..., 2] > HORIZON) & (wo[..., 2] > 0) & (toward[..., 0] > 0) & f.isfinite().all(-1)
        valid &= torch.from_numpy(self.finite.reshape(valid.shape))
        f = torch.where(valid[..., None], f, 0)
        return wi.flatten(0, 1), wo.flatten(0, 1), f.flatten(0, 1), valid.flatten()

    def _turns(self) -> Tensor:
        """The azimuths of wi, radians: 0 of an isotropic material."""
        return torch.zeros(1, dtype=torch.float64, device="cpu") if self.phi is None else self.phi

    def coordinates(self, wi: Tensor, wo: Tensor, theta_h: Tensor) -> "Coordinates":
        """Where directions `(N, 3)` are in the file."""
        if self.phi is None:
            theta_i, x, y = _coordinates(wi, wo, theta_h)
            return Coordinates([_fractional(self.theta.to(theta_i), theta_i)], theta_i, None, x, y)
        wi, wo = _moved(wi, wo, self.parts)
        theta_i = torch.atan2((wi[:, 0].square() + wi[:, 1].square()).sqrt(), wi[:, 2])
        phi_i, half = torch.atan2(wi[:, 1], wi[:, 0]), wi + wo
        place = [_fractional(knots.to(theta_i), one) for knots, one in ((self.phi, phi_i), (self.theta, theta_i))]
        y = _phi_to_unit(torch.atan2(half[:, 1], half[:, 0]))
        return Coordinates(place, theta_i, phi_i, theta_to_unit(theta_h), y)


class Coordinates(NamedTuple):
    """Where N pairs of directions are in a file.

    Attributes:
        place: Fractional indices of phi_i, if it is anisotropic, and of theta_i, `(N,)` each.
        theta_i: Elevation of wi, radians, `(N,)`.
        phi_i: Its azimuth as the file has it; None of an isotropic one.
        x: Unit coordinate of the half vector's elevation.
        y: That of its azimuth.
    """

    place: list[Tensor]
    theta_i: Tensor
    phi_i: Tensor | None
    x: Tensor
    y: Tensor


@FORMATS.register("rgl")
class Rgl(BrdfFormat):
    """The format of RGL's `.bsdf` files, isotropic and anisotropic, RGB or spectral.

    A name is the file's without `_rgb` or `_spec`, by which the files of one material differ. Spectra become linear RGB
    unless bands are kept.

    `pairs` are the directions of every measured value, wi at the file's theta_i, `(M, N)`; shorter files are padded
    with weight 0, as are directions below the horizon (what the file says there is extrapolated, and that it is so
    its field `valid` agrees with the warp) and theta_i = 90 degrees. Negative channels, colours out of gamut, are kept.

    The stored values contain cos_o: of two directions at 15 and 65 degrees the quotient f(a, b) / f(b, a) of plain
    stored values is that of the cosines, and the albedo of white paper, 0.79 to 0.97, is their integral without a
    further cosine. Here f is without it.
    """

    format = "rgl"
    settings: ClassVar[Mapping[str, tuple[str, ...]]] = SETTINGS
    suffixes = (".bsdf",)
    is_text = False
    is_joined: ClassVar[bool] = True

    def __init__(
        self,
        paths: Sequence[Path],
        settings: Mapping[str, str] | None = None,
        files: Sequence[RglFile] | None = None,
    ) -> None:
        self.paths, self.told = list(paths), dict(settings or {})
        self.names = [self.name_of(path) for path in paths]
        self._files = [RglFile(path, self.told) for path in paths] if files is None else list(files)
        self.is_anisotropic = any(file.phi is not None for file in self._files)
        first = self._files[0]
        self.channels, self.wavelengths = first.spectrum.shape[-1], first.wavelengths
        check_same_bands(paths, [(file.spectrum.shape[-1], file.wavelengths) for file in self._files])
        self._tables = lru_cache(TABLES)(self._make_tables)
        self._nearest_finite = lru_cache(TABLES)(lambda material: nearest_valid(self._files[material].finite))

    @classmethod
    def joined(cls, sources: Sequence[BrdfFormat]) -> BrdfFormat:
        """One source of several, whose files are not read again."""
        own = [one for one in sources if isinstance(one, Rgl)]
        paths = [path for one in own for path in one.paths]
        files = [file for one in own for file in one._files]
        return sources[0] if len(sources) == 1 else cls(paths, sources[0].told, files)

    @classmethod
    def name_of(cls, path: Path) -> str:
        """Without what tells a file of RGB from the spectral one."""
        return material_name(path.stem)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as the paths of its files."""
        return reopened(self, self.told)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is an RGL file, by its first 12 bytes."""
        return head.startswith(MAGIC)

    @classmethod
    def open(cls, paths: Sequence[Path], settings: Mapping[str, str] | None = None) -> "Rgl":
        """Read and check files; DataError for anything that is not a measurement of RGL's."""
        return cls(paths, settings)

    @cached_property
    def _samples(self) -> tuple[Pairs, Tensor, Tensor]:
        """Pairs `(M, N)`, values `(M, N, C)` and weights `(M, N, 1)`."""
        files = [file.samples() for file in self._files]
        wi, wo, *others = (list(part) for part in zip(*files, strict=True))
        values, valid = (torch.nn.utils.rnn.pad_sequence(part, batch_first=True) for part in others)
        return padded_pairs(wi, wo), values, valid[..., None].double()

    @cached_property
    def pairs(self) -> Pairs:  # type: ignore[override]
        """Where the values were measured, `(M, N)`."""
        return self._samples[0]

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """The measured values and their weights, float64."""
        _, values, weight = self._samples
        return values[materials][:, samples], weight[materials][:, samples]

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs, linear or nearest, through the file's warp from those around (phi_i, theta_i, u).

        wi takes the place of the file's incident direction; a measurement is not exactly reciprocal.
        """
        values = pairs.cos_i.new_empty((len(materials), len(pairs), self.channels))
        filled = torch.zeros(len(materials), dtype=torch.int64, device=pairs.device)
        for part, chunk in chunks(pairs):
            for row, material in enumerate(materials):
                if row < pairs.shape[0]:
                    own = chunk.select([row])
                    above, wi, wo = own.above_horizon[0], own.wi[0], own.wo[0]
                file = self._files[material]
                cells, table = self._tables(material, pairs.dtype, pairs.device)
                place, theta_i, phi_i, x, y = file.coordinates(wi, wo, own.theta_h[0])
                if interpolation == "nearest":
                    place = [one.round() for one in place]
                u, v = file.warp.invert(cells, place, x, y)
                shape = file.spectrum.shape[:-1]
                position = [*place, v * (shape[-2] - 1), u * (shape[-1] - 1)]
                found, missing = interpolate(table, position, shape, interpolation)
                missing &= above
                if missing.any():
                    centre = nearest_rows([axis[missing] for axis in position], shape).cpu().numpy()
                    entries = torch.from_numpy(self._nearest_finite(material)[centre]).to(pairs.device)
                    found[missing] = table[entries, :-1]
                    filled[row] += missing.sum()
                found = found * file.factor(theta_i, x, y, wo[:, 2], phi_i)[:, None]
                values[row, part] = torch.where(above[:, None], found, 0)
        return Lookup(values, filled)

    def _make_tables(self, material: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
        file = self._files[material]
        finite = torch.from_numpy(file.finite).to(file.spectrum)[..., None]
        table = torch.cat([file.spectrum, finite], -1).flatten(0, -2)
        return file.warp.cells().to(device, dtype), table.to(device, dtype)

    def reading(self, material: int) -> dict[str, object]:
        """How the file was read: also what became of its colours."""
        return super().reading(material) | {"colours": self._files[material].colors}

    def has_grain(self, material: int) -> bool:
        """Whether a material has several phi_i."""
        return self._files[material].phi is not None

    def distance_at(self, pairs: Pairs, materials: list[int]) -> Tensor:
        """How far pairs are from the nearest valid sample, degrees: from what a part of a turn stands for, too."""
        if not self.is_anisotropic:
            return super().distance_at(pairs, materials)
        found = []
        for row, material in enumerate(materials):
            own = pairs.select([row if pairs.shape[0] > 1 else 0])
            wi, wo = _moved(own.wi[0], own.wo[0], self._files[material].parts)
            found.append(super().distance_at(Pairs.from_directions(wi[None], wo[None]), [material]))
        return torch.cat(found)

    def is_whole(self, material: int) -> bool:
        """Whether every stored value is a finite one: other readers do not pass over those that are none."""
        return bool(self._files[material].finite.all())

    def details(self, material: int) -> dict[str, object]:
        """How many valid samples have a negative channel, and the share of negative stored values in each channel."""
        _, values, weight = self._samples
        negative = (values[material] < 0).any(-1) & (weight[material, :, 0] > 0)
        file = self._files[material]
        stored = file.spectrum
        grain = {}
        if file.phi is not None:
            said = {1: "", 2: ", and turning by half a turn changes nothing", 4: ", and mirroring changes nothing"}
            grain = {"anisotropic": f"{len(file.phi)} azimuths of the light over {360 // file.parts} degrees"}
            grain["anisotropic"] += said[file.parts]
        return grain | {
            "colours": file.colors,
            "samples with a negative channel": int(negative.sum()),
            "share of stored values that are negative": (stored < 0).double().flatten(0, -2).mean(0).tolist(),
        }


def _azimuths(file: TensorFile) -> tuple[Tensor | None, int]:
    """The azimuths of an anisotropic material, None of an isotropic one; and how many such parts make a whole turn."""
    if "phi_i" not in file.fields or file.fields["phi_i"].shape == (1,):
        return None, 1
    phi = file.array("phi_i", [None])
    if len(phi) < 3 or not (np.abs(phi) <= math.pi + 1e-4).all() or not (np.diff(phi) > LEAST_STEP).all():
        found = ", ".join(f"{angle:.4g}" for angle in phi[:8].tolist())
        raise DataError(f"{file.path}: phi_i: expected one, or three and more that grow from -pi on, found {found}")
    parts = round(2 * math.pi / (phi[-1] - phi[0]))
    if parts not in (1, 2, 4) or not (
        abs(phi[0] + math.pi) < 0.01 and abs(phi[-1] - phi[0] - 2 * math.pi / parts) < 0.01
    ):
        found = f"{phi[0]:.4g} to {phi[-1]:.4g}"
        raise DataError(f"{file.path}: phi_i: expected a whole, a half or a quarter turn from -pi on, found {found}")
    return torch.from_numpy(phi), parts


def _moved(wi: Tensor, wo: Tensor, parts: int) -> tuple[Tensor, Tensor]:
    """Directions turned or mirrored so that wi is in the part of a turn, from -pi on, that a file has."""
    if parts == 1:
        return wi, wo
    below = wi.signbit()  # which tells -0, whose azimuth is -pi, from 0
    y = torch.where(below[:, 1], 1.0, -1.0)
    x = torch.where(below[:, 0], 1.0, -1.0) if parts == 4 else y
    sides = torch.stack([x, y, torch.ones_like(x)], -1).to(wi)
    return wi * sides, wo * sides


def _phi_to_unit(phi: Tensor) -> Tensor:
    """The coordinate of an azimuth, in [0, 1]."""
    return (phi + math.pi) / (2 * math.pi)


def _coordinates(wi: Tensor, wo: Tensor, theta_h: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """theta_i and the unit coordinates of the half vector, `(N,)` each."""
    radius = (wi[:, 0].square() + wi[:, 1].square()).sqrt()
    theta_i = torch.atan2(radius, wi[:, 2])
    ix, iy = torch.where(radius > 0, wi[:, 0], 1), wi[:, 1]
    hx, hy = wi[:, 0] + wo[:, 0], wi[:, 1] + wo[:, 1]
    phi = torch.atan2(ix * hy - iy * hx, ix * hx + iy * hy)
    return theta_i, theta_to_unit(theta_h), _phi_to_unit(phi)


def theta_to_unit(theta: Tensor) -> Tensor:
    """The coordinate of an elevation, of wi or of the half vector, in [0, 1]."""
    return (theta * (2 / math.pi)).sqrt()


def _fractional(knots: Tensor, value: Tensor) -> Tensor:
    """The fractional index of values among growing knots; beyond them that of the last."""
    low = (torch.searchsorted(knots, value.contiguous(), right=True) - 1).clamp(0, len(knots) - 2)
    return low + ((value - knots[low]) / (knots[low + 1] - knots[low])).clamp(0, 1)


def bilinear(grid: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """A grid `(H, W)` at positions in the unit square, of any shape."""
    height, width = grid.shape
    table = grid.to(x).reshape(-1, 1)
    index, weight = neighbours([y.flatten() * (height - 1), x.flatten() * (width - 1)], [height, width])
    return weighted_rows(table, index, weight).reshape(x.shape)
