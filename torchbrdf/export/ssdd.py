"""SSDD, surface scattering distribution data: the open text format of libbsdf and BSDF Processor.

Source: R. Kimura, Surface scattering distribution data (SSDD) file format, version 0.2, 2023,
https://github.com/KimuraRyo/libbsdf.
"""

import math
from pathlib import Path

import numpy as np
import torch

from torchbrdf.errors import one_line
from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Material
from torchbrdf.export.listing import values_in_bands, wavelengths_of
from torchbrdf.export.tables import TableExporter, copied
from torchbrdf.files import write_text
from torchbrdf.measured import Measured, Ssdd, load
from torchbrdf.measured.grid import nearest_valid
from torchbrdf.measured.ssdd import VERSION, half_directions, read_size
from torchbrdf.pairs import Pairs
from torchbrdf.reading import check_unpacked

# Nodes along theta_h, denser towards 0 by the second power; degrees between those along theta_d and phi_d.
HALF_NODES, DIFFERENCE_STEP, AZIMUTH_STEP = 61, 2, 7.5
# The same with a grain, and degrees between azimuths of the half vector.
GRAIN_NODES, GRAIN_DIFFERENCE_STEP, GRAIN_AZIMUTH_STEP, GRAIN_STEP = 31, 7.5, 15, 15
LOWEST = 1e-3


@EXPORTERS.register("ssdd")
class SsddTable(TableExporter):
    """An `.ssdd` in half and difference angles, which follow the highlight; text."""

    suffix = ".ssdd"
    own = Ssdd
    keeps_bands = True

    def write_file(self, material: Material, path: Path) -> Exported:
        """Write the table."""
        brdf = material.brdf
        if isinstance(brdf, Measured) and self.is_own(brdf):
            return copied(path, brdf)
        axes = axes_of(brdf.is_anisotropic)
        channels = 3 if wavelengths_of(brdf) is None else len(wavelengths_of(brdf) or ())
        check_unpacked(path, read_size(math.prod(map(len, axes)), channels))  # before all of it is written
        values = grid_values(brdf, axes)
        write_text(path, _text(material, axes, values))
        size = " x ".join(str(len(axis)) for axis in axes if len(axis) > 1)
        return Exported([path], False, [f"resampled at {size} half and difference angles"], load(path))


def axes_of(grain: bool) -> list[np.ndarray]:
    """theta_h, phi_h, theta_d and phi_d of the grid, degrees; of isotropic materials phi_h is 0."""
    nodes = GRAIN_NODES if grain else HALF_NODES
    difference, azimuth, most = (
        (GRAIN_DIFFERENCE_STEP, GRAIN_AZIMUTH_STEP, 180) if grain else (DIFFERENCE_STEP, AZIMUTH_STEP, 90)
    )
    return [
        90 * np.linspace(0, 1, nodes) ** 2,
        np.arange(0, 361, GRAIN_STEP, dtype=float) if grain else np.zeros(1),
        np.arange(0, 90 + difference / 2, difference, dtype=float),
        np.arange(0, most + azimuth / 2, azimuth, dtype=float),
    ]


def grid_values(brdf: Brdf, axes: list[np.ndarray]) -> np.ndarray:
    """Values at the nodes of a grid, theta_h first, `(T, P, D, A, C)`.

    What is not reciprocal has the mean of both orders. Nodes below the horizon have the value of the nearest node
    above it, since readers interpolate between them.
    """
    places = np.meshgrid(*axes, indexing="ij")
    wi, wo = half_directions(*(np.radians(one.ravel()) for one in places))
    above = np.minimum(wi[:, 2], wo[:, 2]) > LOWEST
    toward, seen = (torch.from_numpy(one[above][None]) for one in (wi, wo))
    ways = Pairs.from_directions(toward, seen), Pairs.from_directions(seen, toward)
    mean = (values_in_bands(brdf, ways[0]) + values_in_bands(brdf, ways[1])).numpy() / 2
    found = np.zeros((len(above), mean.shape[1]))
    found[above] = mean
    found = found[nearest_valid(above.reshape(places[0].shape))]
    return found.reshape(*places[0].shape, -1)


def _text(material: Material, axes: list[np.ndarray], values: np.ndarray) -> str:
    """The whole file."""
    wavelengths = wavelengths_of(material.brdf)
    grain = len(axes[1]) > 1
    model = {1: "monochrome", 3: "rgb"}.get(values.shape[-1], "") if wavelengths is None else "spectrum"
    lists = {f"PARAM{k}_LIST": _numbers(axis) for k, axis in enumerate(axes) if k != 1 or grain}
    head = {
        "VERSION": VERSION,
        "SOFTWARE": "torchbrdf",
        "DATA_TYPE": "brdf",
        "COLOR_MODEL": model,
        **({} if wavelengths is None else {"WAVELENGTH_LIST": " ".join(f"{one:g}" for one in wavelengths)}),
        "PARAM_TYPE": "half_difference_coordinate_system",
        "REDUCTION_TYPE": "reciprocity" if grain else "bilateral_symmetry reciprocity",
        **lists,
        "NAME": one_line(material.name),
        "SOURCE_TYPE": "measured" if isinstance(material.brdf, Measured) else "generated",
        "DATA": "ascii",
    }
    # The first axis runs fastest.
    rows = np.moveaxis(values, -1, 0).reshape(values.shape[-1], -1, order="F").T
    lines = [f"{key} {value}" for key, value in head.items()]
    lines += [" ".join(f"{number:.7g}" for number in row) for row in rows.tolist()]
    return "\n".join(lines) + "\n"


def _numbers(axis: np.ndarray) -> str:
    return " ".join(f"{one:.9g}" for one in axis)
