"""Opinions: how far people find approximations from the material that they approximate."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.names import check_name
from torchbrdf.perception.datasets.csv_table import check_head, check_rows, near, number, read_rows

SOURCE = (
    "the opinions of Lavoue, Bonneel, Farrugia and Soler 2021, Perceptual quality of BRDF approximations: dataset and "
    "metrics, doi:10.1111/cgf.142636, given at github.com/nbonneel/PerceptualBRDF"
)
VOTES = 30


@dataclass(frozen=True)
class Opinions:
    """Mean opinion scores of approximations of materials, a row for each method and material.

    Args:
        methods: Of each of R rows, a name.
        materials: Of each row, a name.
        distance: (5 - MOS) / 4, 0 at best and 1 at worst, `(R,)` float64; MOS is the mean of about 30 opinions from
            1 (very different) to 5 (no difference).

    Source: G. Lavoue, N. Bonneel, J.-P. Farrugia, C. Soler, Perceptual quality of BRDF approximations: dataset and
    metrics, 2021, doi:10.1111/cgf.142636.
    """

    methods: list[str]
    materials: list[str]
    distance: Tensor

    def __len__(self) -> int:
        return len(self.methods)

    @property
    def standard_error(self) -> Tensor:
        """Standard error of each distance, `(R,)`: sqrt(max(0.2 (-MOS^2 + 6 MOS - 5), 0.15) / 30) / 4.

        The spread of single opinions is not published; the variance is modelled as a fifth of the largest that a mean
        opinion between 1 and 5 allows, (MOS - 1)(5 - MOS), and 0.15 at least.
        """
        mos = 5 - 4 * self.distance
        variance = (0.2 * (-mos.square() + 6 * mos - 5)).clamp_min(0.15)
        return (variance / VOTES).sqrt() / 4

    def select(self, rows: list[int]) -> "Opinions":
        """Opinions of some of the rows, by index."""
        return Opinions(
            [self.methods[row] for row in rows],
            [self.materials[row] for row in rows],
            self.distance[torch.tensor(rows, dtype=torch.long, device="cpu")],
        )


def read_opinions(path: Path | str, materials: Collection[str] | None = None) -> Opinions:
    """Read mean opinions from a CSV file with the columns method, material, distance.

    Args:
        path: The file.
        materials: Names that a material may have; by default any.

    Raises:
        DataError: The file is missing, or a line is not as expected.
    """
    path = Path(path)
    head, rows = read_rows(path, "opinions", SOURCE)
    check_head(path, head, ["method", "material", "distance"])
    check_rows(path, rows, "opinions")
    lines: dict[tuple[str, str], int] = {}
    distance = []
    for line, row in enumerate(rows, 2):
        where = f"{path}: line {line}"
        if len(row) != 3:
            found = shown(",".join(row))
            raise DataError(f"{where}: expected a method, a material and a distance, found {found}")
        method, material = (check_name(name, where) for name in row[:2])
        if materials is not None and material not in materials:
            found = f"{shown(material)}{near(material, materials)}"
            raise DataError(f"{where}: expected one of {len(materials)} materials, found {found}")
        distance.append(number(row[2], 0, 1, where, "a distance"))
        before = lines.setdefault((method, material), line)
        if before != line:
            raise DataError(f"{where}: {method} of {material} is already in line {before}")
    methods, named = map(list, zip(*lines, strict=True))
    return Opinions(methods, named, torch.tensor(distance, dtype=torch.float64, device="cpu"))
