"""Ratings: how glossy, metallic and so on people find materials, on scales from 1 to 5."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.names import check_name
from torchbrdf.perception.datasets.csv_table import check_rows, near, number, read_rows

SOURCE = (
    "the mean ratings of the surveys of Serrano et al. 2016, An intuitive control space for material appearance, "
    "doi:10.1145/2980179.2980242, given at github.com/ana-serrano/Material-app"
)
MEASURED = "_5PCs"
"""The end of the names of pictures that show a measured MERL material, through five principal components of all."""
LABELS = {
    "bright": "brightness",
    "ceramic": "ceramic-like",
    "fabric": "fabric-like",
    "glossy": "glossy",
    "hard": "hard",
    "matte": "matte",
    "metallic": "metallic-like",
    "plastic": "plastic-like",
    "refsharp": "sharpness of reflections",
    "refstrng": "strength of reflections",
    "reftint": "tint of reflections",
    "rough": "rough",
    "rubber": "rubber-like",
    "soft": "soft",
}
"""Attributes of the study for people."""
LOWEST, HIGHEST = 1.0, 5.0


@dataclass(frozen=True)
class Ratings:
    """Mean ratings of R materials on A attributes.

    Args:
        materials: Names of what was shown: MERL's for its measured materials, others for mixtures.
        measured: Whether each is a measured material.
        attributes: Names.
        mean: From 1 to 5, `(R, A)` float64.
        deviation: Standard deviation of single ratings, `(R, A)` float64.
        count: How many people rated each, `(R,)` long.

    Source: A. Serrano, D. Gutierrez, K. Myszkowski, H.-P. Seidel, B. Masia, An intuitive control space for material
    appearance, 2016, doi:10.1145/2980179.2980242.
    """

    materials: list[str]
    measured: list[bool]
    attributes: list[str]
    mean: Tensor
    deviation: Tensor
    count: Tensor

    def __len__(self) -> int:
        return len(self.materials)

    @property
    def standard_error(self) -> Tensor:
        """Of each mean, `(R, A)`; of one rating alone it is not known, and taken as 1."""
        count = self.count[:, None].double()
        return torch.where(count > 1, self.deviation / (count - 1).clamp_min(1).sqrt(), 1.0)

    def select(self, materials: list[str]) -> "Ratings":
        """The ratings of some measured materials, in this order."""
        place = {name: row for row, name in enumerate(self.materials) if self.measured[row]}
        rows = torch.tensor([place[name] for name in materials], dtype=torch.long, device="cpu")
        return Ratings(
            materials,
            [True] * len(materials),
            self.attributes,
            self.mean[rows],
            self.deviation[rows],
            self.count[rows],
        )


def read_ratings(path: Path | str, materials: Collection[str] | None = None) -> Ratings:
    """Read mean ratings from a CSV file: image, n, and for each attribute its mean and sd.

    Args:
        path: The file.
        materials: Names that a measured material may have; by default any.

    Raises:
        DataError: The file is missing, or a line is not as expected.
    """
    path = Path(path)
    head, rows = read_rows(path, "mean ratings", SOURCE)
    attributes = [name.removesuffix("_mean") for name in head if name.endswith("_mean")]
    expected = [*("image", "n"), *(f"{name}{end}" for name in attributes for end in ("_mean", "_sd"))]
    if not attributes or sorted(head) != sorted(expected) or len(set(head)) < len(head):
        found = shown(",".join(head)) if head else "nothing"
        raise DataError(
            f"{path}: line 1: expected image, n, and NAME_mean and NAME_sd of each attribute, found {found}"
        )
    check_rows(path, rows, "mean ratings")
    for name in attributes:
        check_name(name, f"{path}: line 1")
    lines: dict[str, int] = {}
    numbers: list[list[float]] = []
    for line, row in enumerate(rows, 2):
        where = f"{path}: line {line}"
        if len(row) != len(head):
            raise DataError(f"{where}: expected {len(head)} cells, found {len(row)}: {shown(','.join(row))}")
        cells = dict(zip(head, row, strict=True))
        name = check_name(cells["image"].removesuffix(".png"), where)
        if materials is not None and name.endswith(MEASURED) and name.removesuffix(MEASURED) not in materials:
            found = f"{shown(name)}{near(name.removesuffix(MEASURED), materials)}"
            raise DataError(f"{where}: expected one of {len(materials)} materials, found {found}")
        before = lines.setdefault(name, line)
        if before != line:
            raise DataError(f"{where}: {shown(name)} is already in line {before}")
        people = cells["n"]
        if not (people.isascii() and people.isdecimal() and len(people) < 7 and int(people)):
            raise DataError(f"{where}: n: expected a whole number of at least 1, found {shown(people)}")
        means = [number(cells[f"{own}_mean"], LOWEST, HIGHEST, where, f"{own}: a mean") for own in attributes]
        spread = HIGHEST - LOWEST
        deviations = [number(cells[f"{own}_sd"], 0, spread, where, f"{own}: a deviation") for own in attributes]
        numbers.append([float(people), *means, *deviations])
    table = torch.tensor(numbers, dtype=torch.float64, device="cpu")
    counts, mean, deviation = table.split([1, len(attributes), len(attributes)], 1)
    named = [check_name(name.removesuffix(MEASURED), f"{path}: line {line}") for name, line in lines.items()]
    measured = [name.endswith(MEASURED) for name in lines]
    return Ratings(named, measured, attributes, mean, deviation, counts[:, 0].long())
