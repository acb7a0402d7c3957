"""Any BRDF as a list of directions and values, for files that have those."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.export.base import Brdf
from torchbrdf.measured import Measured
from torchbrdf.measured.grain import SAID
from torchbrdf.measured.grid import chunks
from torchbrdf.measured.tables import values_at
from torchbrdf.pairs import Pairs

# Where a BRDF without samples of its own is asked: theta_i, degrees; half vectors about the normal, nodes along
# theta_h, denser towards it by the second power, and degrees between those around.
LIGHTS = (0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 74, 78, 81, 84, 87)
HALF_NODES, HALF_STEP = 48, 9
# The same with a grain: azimuths of the light, degrees, and coarser half vectors.
GRAIN_LIGHTS, GRAIN_STEP = (0, 15, 30, 45, 60, 75), 30
GRAIN_NODES, GRAIN_HALF_STEP = 24, 18
# Of directions to the viewer: lower ones are at the horizon.
LOWEST = 0.01


class Listing(NamedTuple):
    """Directions and values.

    Attributes:
        angles: theta_i, phi_i, theta_o and phi_o, radians, `(N, 4)`.
        values: In 1/sr, `(N, C)`.
        wavelengths: Of the bands, nm, C; None of linear RGB and of one band alone.
        is_own: Whether they are the measurement's own samples.
        has_grain: Whether they are of an anisotropic material.
        left_out: Which of the measurement's samples are not among them, in words.
    """

    angles: np.ndarray
    values: np.ndarray
    wavelengths: tuple[float, ...] | None
    is_own: bool
    has_grain: bool
    left_out: str = ""

    @property
    def note(self) -> str:
        """What is listed, in words."""
        if self.is_own:
            rest = f"; left out: {self.left_out}" if self.left_out else ""
            return f"its own {len(self.values)} samples{rest}"
        lights = len(np.unique(self.angles[:, 0].round(6)))
        return f"resampled at {len(self.values)} pairs: {lights} angles of the light, half vectors all around"

    @property
    def grain(self) -> str:
        """What a comment says of the grain, which readers would else have to find out; "" of isotropic materials."""
        return f"{SAID} anisotropic" if self.has_grain else ""

    def columns(self, rgb: tuple[str, str, str], grey: str) -> list[str]:
        """The names of the columns of values: bands by their wavelengths in nm.

        Args:
            rgb: Of three without wavelengths.
            grey: Of one.
        """
        if self.wavelengths is not None:
            return [f"{one:g}nm" for one in self.wavelengths]
        return list(rgb) if self.values.shape[1] == 3 else [grey]


def listing(brdf: Brdf) -> Listing:
    """One material as a list: the samples of a measurement without a grid, else values around each of many mirrors.

    Args:
        brdf: A lobe or a sum of lobes, not batched; or one measured material.

    Raises:
        DataError: It was measured, and no sample is valid.
    """
    wavelengths = wavelengths_of(brdf)
    if isinstance(brdf, Measured) and brdf.is_scattered:
        brdf = brdf.to(dtype=torch.float64)
        valid = (brdf.weight[0, :, 0] > 0).nonzero()[:, 0]
        if not len(valid):
            raise DataError(f"{brdf.names[0]}: expected valid samples, found none")
        pairs = brdf.pairs.select([0], valid)
        angles = _angles(pairs)
        turns = np.round(angles[angles[:, 0] > 1e-6, 1] % (2 * np.pi), 6)
        if not brdf.is_anisotropic and len(np.unique(turns)) > 1:  # which readers would take for those of a grain
            angles[:, 3] -= angles[:, 1]
            angles[:, 1] = 0
        left_out = str(brdf.source.reading(brdf.materials[0]).get("left out", ""))
        return Listing(angles, brdf.values[0, valid].numpy(), wavelengths, True, brdf.is_anisotropic, left_out)
    pairs = _around_mirrors(brdf.is_anisotropic)
    return Listing(_angles(pairs), values_in_bands(brdf, pairs).numpy(), wavelengths, False, brdf.is_anisotropic)


def values_in_bands(brdf: Brdf, pairs: Pairs) -> Tensor:
    """Values of one material at pairs, in all its bands, `(N, C)`, float64; 0 below the horizon.

    Args:
        brdf: A lobe or a sum of lobes, not batched; or one measured material.
        pairs: Where, `(1, N)`, in float64 on the CPU.
    """
    if not isinstance(brdf, Measured):
        return values_at(brdf, pairs)
    return torch.cat([brdf.at(chunk)[0].double() for _, chunk in chunks(pairs)]).nan_to_num(0, 0, 0)


def wavelengths_of(brdf: Brdf) -> tuple[float, ...] | None:
    """Of the bands of a measurement, nm; None of anything else."""
    return brdf.wavelengths if isinstance(brdf, Measured) else None


def _angles(pairs: Pairs) -> np.ndarray:
    """theta and phi of light and viewer, radians, `(N, 4)`."""
    parts = []
    for way in (pairs.wi[0], pairs.wo[0]):
        x, y, z = way.double().cpu().numpy().T
        parts += [np.arctan2(np.hypot(x, y), z), np.where(np.hypot(x, y) > 1e-9, np.arctan2(y, x), 0)]
    return np.stack(parts, -1)


def _around_mirrors(grain: bool) -> Pairs:
    """Pairs `(1, N)` for each of the light's angles: viewers about the mirror direction, by half vectors."""
    lights, count, step = (GRAIN_LIGHTS, GRAIN_NODES, GRAIN_HALF_STEP) if grain else (LIGHTS, HALF_NODES, HALF_STEP)
    turns = np.arange(0, 360, GRAIN_STEP) if grain else np.zeros(1)
    around = np.radians(np.arange(0, 360, step) if grain else np.arange(0, 180 + step, step))
    nodes = np.radians(90) * (np.arange(1, count) / count) ** 2
    theta, phi = (one.ravel() for one in np.meshgrid(nodes, around, indexing="ij"))
    half = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    half = np.concatenate([[[0.0, 0.0, 1.0]], half])
    toward, seen = [], []
    for light in np.radians(lights):
        wi = np.array([np.sin(light), 0, np.cos(light)])
        wo = 2 * (half @ wi)[:, None] * half - wi
        wo = wo[(wo[:, 2] > LOWEST) & (half @ wi > 0)]
        for turn in np.radians(turns if light else turns[:1]):
            turned = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
            seen.append(wo @ turned)
            toward.append(np.broadcast_to(wi @ turned, wo.shape))
    return Pairs.from_directions(*(torch.from_numpy(np.concatenate(one)[None]) for one in (toward, seen)))
