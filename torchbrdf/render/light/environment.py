"""Light from all around, infinitely far away."""

import importlib.resources
import logging
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.errors import DataError, UsageError
from torchbrdf.images import read_image
from torchbrdf.parallel import thread_map
from torchbrdf.precision import undisturbed
from torchbrdf.render.light.octahedral import padded, texel_centers, to_sphere, to_square
from torchbrdf.render.light.studio import make_studio

# Texels along a side of the map that an environment is kept as; 0.4 degrees each.
RESOLUTION = 512
_SUPERSAMPLING = 4
_STRIP = 8
# A picture wider than this is averaged down first, since the map could not show more.
_WIDEST = 4 * RESOLUTION
# Resampling and conversion of colours leave negative values, and half floats infinite suns: how many of its values may
# be so before a picture is no light probe.
_MOST_NEGATIVE, _MOST_NOT_FINITE = 0.1, 0.01
# Of a radiance: sums over the sphere, and squares of differences, fit into float32 below it.
_BRIGHTEST = 1e15


@dataclass(frozen=True)
class EnvironmentSamples:
    """Directional lights that stand for an environment.

    Attributes:
        direction: Unit vectors, `(L, 3)`.
        flux: Radiance times solid angle, `(L, 3)`.
    """

    direction: Tensor
    flux: Tensor


class Environment:
    """Environment lighting: radiance from every direction, kept as an equal-area octahedral map and its averages.

    The vertical axis is +y. A latitude-longitude picture (width = 2 height) shows -z in its middle, +x to the right
    of that and +y at its top; Debevec's angular map (square) shows the same, with +z all along its rim.

    Args:
        texels: The octahedral map, `(n, n, 3)`, linear radiance; `from_image` and `from_file` make it.
        rotation: Turns the surroundings about +y, counter-clockwise as seen from above, in degrees.

    Raises:
        UsageError: The rotation is not finite.

    Source: of the conventions, P. Debevec, https://www.pauldebevec.com/Probes/.

    Example:
        >>> white = Environment.from_image(torch.ones(16, 32, 3))
        >>> white.lookup(torch.tensor([[0.0, 1.0, 0.0]]), torch.tensor([0.1]))
        tensor([[1., 1., 1.]])
    """

    def __init__(self, texels: Tensor, rotation: float = 0.0) -> None:
        if not math.isfinite(rotation):
            raise UsageError(f"Environment.rotation: expected degrees, found {rotation}")
        self.texels = texels
        self.rotation = float(rotation)

    @classmethod
    def from_file(cls, path: str | Path, rotation: float = 0.0) -> "Environment":
        """Environment from a `.exr` or Radiance `.hdr` picture, latitude-longitude or angular map.

        What is mended, and refused, is that of `from_image`.

        Raises:
            DataError: The file is no such picture.
        """
        return cls.from_image(read_image(path), rotation, where=str(path))

    @classmethod
    def default(cls, rotation: float = 0.0) -> "Environment":
        """Environment that comes with the package, a grove; `torchbrdf.assets.make_grove` made it."""
        with importlib.resources.as_file(importlib.resources.files("torchbrdf.assets") / "grove.exr") as path:
            return cls.from_file(path, rotation)

    @classmethod
    def find(cls, name: str, rotation: float = 0.0) -> "Environment":
        """Environment of a name: "grove", "studio" (`torchbrdf.render.light.studio`), or a light probe's file.

        Raises:
            DataError: The file is no picture of an environment, or the name is empty.
        """
        if not name:
            raise DataError("environment: expected grove, studio or a file, found ''")
        if name == "grove":
            return cls.default(rotation)
        return cls.from_image(make_studio(), rotation) if name == "studio" else cls.from_file(name, rotation)

    @classmethod
    @undisturbed()
    def from_image(cls, image: Tensor, rotation: float = 0.0, where: str = "environment") -> "Environment":
        """Environment from a linear picture `(H, W, 3)`, area-averaged onto the map.

        Args:
            image: Latitude-longitude (W = 2 H) or angular map (W = H). Negative values and NaN count as 0, infinite
                ones as the largest finite one, and the log says how many there were.
            rotation: As for the class.
            where: What errors call it.

        Raises:
            DataError: It is no such picture; more than 1 in 10 of its values are negative, or 1 in 100 not finite;
                or a radiance is above 1e15.
        """
        _check_shape(image, where)
        height, width = image.shape[:2]
        planes = _mended(image.detach().to(torch.float32), where).movedim(-1, 0)[None]
        if width > _WIDEST:
            planes = F.adaptive_avg_pool2d(planes, (_WIDEST * height // width, _WIDEST))
        find = _angular_map if height == width else _latitude_longitude
        if height != width:
            planes = F.pad(planes, (1, 1, 0, 0), mode="circular")
        fine = RESOLUTION * _SUPERSAMPLING
        step = (torch.arange(fine, dtype=torch.float32, device="cpu") + 0.5) * (2 / fine) - 1

        def strip(rows: Tensor) -> Tensor:
            second, first = torch.meshgrid(rows, step, indexing="ij")
            place = find(to_sphere(first, second), planes.shape[-1])
            samples = F.grid_sample(planes, place[None], mode="bilinear", padding_mode="border", align_corners=False)
            return F.avg_pool2d(samples, _SUPERSAMPLING)

        strips = list(thread_map(strip, step.split(_STRIP * _SUPERSAMPLING)))
        return cls(torch.cat(strips, 2)[0].movedim(0, -1).contiguous(), rotation)

    @cached_property
    @undisturbed()
    def _pyramid(self) -> list[Tensor]:
        """The map and its 2 x 2 averages, down to one texel; exact in energy, since all texels are equal."""
        levels = [self.texels]
        while levels[-1].shape[0] > 1:
            levels.append(_halved(levels[-1]) / 4)
        return levels

    @cached_property
    @undisturbed()
    def _atlas(self) -> tuple[Tensor, Tensor, Tensor]:
        """All levels, padded, as rows of one table; where each starts, and how many texels wide it is.

        Whole numbers that float32 has exactly.
        """
        tables = [padded(level).reshape(-1, 3) for level in self._pyramid]
        numbers = [[sum(map(len, tables[:k])), len(level)] for k, level in enumerate(self._pyramid)]
        starts, sides = torch.tensor(numbers, dtype=torch.float32, device=self.texels.device).T.contiguous()
        return torch.cat(tables), starts, sides

    def _turned(self, directions: Tensor, degrees: float) -> Tensor:
        angle = math.radians(degrees)
        cos, sin = math.cos(angle), math.sin(angle)
        x, y, z = directions.unbind(-1)
        return torch.stack([cos * x + sin * z, y, cos * z - sin * x], -1)

    def lookup(self, directions: Tensor, solid_angle: Tensor) -> Tensor:
        """Radiance `(..., 3)` from unit vectors `(..., 3)`, averaged over about `solid_angle` `(...)` around each.

        Linear within and between levels, and across the borders of the map. Below one texel's solid angle the map is
        interpolated.
        """
        return self.look(directions.movedim(-1, 0), solid_angle).movedim(0, -1)

    def look(self, directions: Tensor, solid_angle: Tensor) -> Tensor:
        """As `lookup`, of unit vectors `(3, ...)`: `(3, ...)`."""
        if self.rotation:
            directions = self._turned(directions.movedim(0, -1), -self.rotation).movedim(-1, 0)
        table, starts, sides = self._atlas
        level = torch.log2(solid_angle.expand(directions.shape[1:]) * (self.texels.shape[0] ** 2 / (4 * math.pi)))
        level = level.mul_(0.5).clamp_(0, len(starts) - 1)
        lower = level.floor()
        upper_share = level.sub_(lower)
        lower = lower.to(torch.int64)
        places = [place.add_(1).mul_(0.5) for place in to_square(directions)]
        rows = torch.empty(*level.shape, 8, dtype=torch.int32, device=level.device)
        weights = torch.empty(*level.shape, 8, dtype=level.dtype, device=level.device)
        for k, share in ((0, 1 - upper_share), (4, upper_share)):
            depth = lower if k == 0 else lower.add_(1).clamp_max_(len(starts) - 1)
            side = sides.take(depth)
            # Texel centres at whole numbers, behind the padding.
            across, down = ((place * side).add_(0.5) for place in places)
            left, top = across.floor(), down.floor()
            across.sub_(left)
            down.sub_(top).mul_(share)
            wide = side.add_(2)
            corner = starts.take(depth).add_(top.mul_(wide)).add_(left).to(torch.int32)
            rows[..., k] = corner
            torch.add(corner, 1, out=rows[..., k + 1])
            corner.add_(wide.to(torch.int32))
            rows[..., k + 2] = corner
            torch.add(corner, 1, out=rows[..., k + 3])
            over = share - down
            right_over = torch.mul(over, across, out=weights[..., k + 1])
            right_under = torch.mul(down, across, out=weights[..., k + 3])
            torch.sub(over, right_over, out=weights[..., k])
            torch.sub(down, right_under, out=weights[..., k + 2])
        found = F.embedding_bag(rows.view(-1, 8), table, per_sample_weights=weights.view(-1, 8), mode="sum")
        return found.T.reshape(directions.shape)

    def light_samples(self, count: int) -> EnvironmentSamples:
        """Importance samples of the environment: at most `count` lights that together have its flux.

        The map is a quadtree. Where the luminance-weighted variance of direction times flux, the leading term of what
        one light in a node's place gets wrong, is largest, the node is split; each leaf becomes a light at its
        luminance-weighted mean direction. Every split adds three lights. The environment's constant part alone gives
        equal squares, a small sun gets small ones.
        """
        if count < 4:
            raise UsageError(f"lights: expected at least 4, found {count}")
        finest = self._pyramid[1].to(torch.float64)  # 0.8 degrees: no light need be smaller
        flux = finest * (4 * math.pi / finest.shape[0] ** 2)
        bright = luminance(flux)[..., None]
        # Sums over each node of flux, luminance, and direction times luminance; then what splitting it would gain.
        sums = torch.cat([flux, bright, texel_centers(finest.shape[0], torch.float64) * bright], -1)
        nodes, gains = [sums], [torch.zeros_like(bright)]
        while nodes[0].shape[0] > 1:
            nodes.insert(0, _halved(nodes[0]))
            bright, moment = nodes[0][..., 3:4], nodes[0][..., 4:]
            variance = bright - moment.square().sum(-1, keepdim=True) / bright.clamp_min(1e-300)
            # never less than a child's, in spite of rounding, so that no node is split before its parent
            largest = F.max_pool2d(gains[0].movedim(-1, 0), 2).movedim(0, -1)
            gains.insert(0, torch.maximum(variance, largest))
        gain = torch.cat([level.flatten() for level in gains[:-1]])
        split = torch.zeros(sum(level.numel() for level in gains), dtype=torch.bool, device="cpu")
        split[gain.argsort(descending=True, stable=True)[: (count - 1) // 3]] = True
        leaves, exists = [], torch.ones(1, 1, dtype=torch.bool, device="cpu")
        for level, divided in zip(nodes, split.split([level.numel() for level in gains]), strict=True):
            divided = exists & divided.reshape(exists.shape)
            leaves.append(level[exists & ~divided & (level[..., 3] > 0)])
            exists = divided.repeat_interleave(2, 0).repeat_interleave(2, 1)
        flux, _, moment = torch.cat(leaves).split([3, 1, 3], -1)
        direction = self._turned(F.normalize(moment, dim=-1), self.rotation)
        return EnvironmentSamples(direction.to(torch.float32), flux.to(torch.float32))


def _halved(texels: Tensor) -> Tensor:
    """Sums of 2 x 2."""
    return texels.unflatten(0, (-1, 2)).unflatten(2, (-1, 2)).sum((1, 3))


def _check_shape(image: Tensor, where: str) -> None:
    if image.dim() != 3 or image.shape[-1] != 3:
        raise DataError(f"{where}: expected a picture (H, W, 3), found {(*image.shape,)}")
    height, width = image.shape[:2]
    if width not in (height, 2 * height):
        raise DataError(
            f"{where}: expected a latitude-longitude map (width = 2 height) or an angular map (width = height), "
            f"found {width} x {height} pixels"
        )


def _mended(image: Tensor, where: str) -> Tensor:
    """A picture of values that are finite and at least 0; see `Environment.from_image`."""
    finite = image.isfinite()
    largest = float(image.nan_to_num(0, 0, 0).amax()) if image.numel() else 0.0
    if not 0 < largest < _BRIGHTEST:
        found = f"up to {largest:.3g}" if largest > 0 else "nothing above 0: the whole picture is black"
        raise DataError(f"{where}: expected finite radiance above 0 and below {_BRIGHTEST:g}, found {found}")
    for bad, most, what, counted in (
        ((image < 0) & finite, _MOST_NEGATIVE, "negative", "0"),
        (~finite, _MOST_NOT_FINITE, "not finite", f"{largest:.4g}, the largest, or as 0 if they are no number"),
    ):
        count = int(bad.sum())
        if not count:
            continue
        row, column, channel = bad.nonzero()[0].tolist()
        found = f"{count} of {image.numel()} ({image[row, column, channel].item():.4g} at row {row}, column {column})"
        if count > most * image.numel():
            raise DataError(f"{where}: expected at most 1 in {1 / most:.0f} values that are {what}, found {found}")
        message = "torchbrdf: %s: values that are %s count as %s: %s"
        logging.getLogger("torchbrdf").warning(message, where, what, counted, found)
    return image.nan_to_num(nan=0.0, posinf=largest, neginf=0.0).clamp_min(0)


def _latitude_longitude(directions: Tensor, padded_width: int) -> Tensor:
    """Where directions lie in a picture with one column more on either side, in grid_sample's coordinates."""
    x, y, z = directions.unbind(-1)
    across = torch.atan2(x, -z) * (padded_width - 2) / (padded_width * math.pi)
    down = torch.atan2((x.square() + z.square()).sqrt(), y) * (2 / math.pi) - 1
    return torch.stack([across, down], -1)


def _angular_map(directions: Tensor, width: int) -> Tensor:
    """Where directions lie in an angular map: the angle from -z is the distance from the middle."""
    x, y, z = directions.unbind(-1)
    flat = (x.square() + y.square()).sqrt()
    ratio = torch.atan2(flat, -z) / (math.pi * flat.clamp_min(1e-12))
    return torch.stack([x * ratio, -y * ratio], -1)
