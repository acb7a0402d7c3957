"""JOD scores: how many just-objectionable differences people see between a material and an approximation of it."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.names import check_name
from torchbrdf.perception.datasets.csv_table import check_head, check_rows, number, read_rows

SOURCE = (
    "the JOD scores of Kavoosighafi et al. 2025, Perceived quality of BRDF models, doi:10.1111/cgf.70162, given at "
    "github.com/behnazkavoosi/neural-brdf-quality-metric"
)
HEAD = ["material", "model", "level", "DeltaE", "JOD", "class"]
BEST = 10.0
"""The JOD of what looks the same; one less is a difference that 75 % see. Noise takes single scores beyond it."""
# What no score or picture difference goes beyond.
_JOD, _DELTA_E = (-100.0, 12.0), (0.0, 1e4)


@dataclass(frozen=True)
class JodScores:
    """JOD scores of approximations of materials, a row for each.

    Args:
        names: Of each of R rows, that of its approximation's table in the study's data: its material's, `_` and a
            number.
        materials: Of each row, a name.
        methods: Of each row, its model, with its level behind it where the model has several.
        jod: `(R,)` float64; 10 looks the same, and is higher than by chance alone in noisy scores.
        delta_e: Mean colour difference of pictures that the authors give beside it, `(R,)` float64.

    Source: B. Kavoosighafi, R. Mantiuk, S. Hajisharif, E. Miandji, J. Unger, Perceived quality of BRDF models, 2025,
    doi:10.1111/cgf.70162.
    """

    names: list[str]
    materials: list[str]
    methods: list[str]
    jod: Tensor
    delta_e: Tensor

    def __len__(self) -> int:
        return len(self.names)

    @property
    def distance(self) -> Tensor:
        """JOD below what looks the same, `(R,)`."""
        return BEST - self.jod

    def select(self, rows: list[int]) -> "JodScores":
        """Some of the rows, by index."""
        place = torch.tensor(rows, dtype=torch.long, device="cpu")
        names, materials, methods = ([own[row] for row in rows] for own in (self.names, self.materials, self.methods))
        return JodScores(names, materials, methods, self.jod[place], self.delta_e[place])


def read_jod(path: Path | str) -> JodScores:
    """Read JOD scores from a CSV file with the columns material, model, level, DeltaE, JOD, class.

    A material is the name of its table, `_` and a number; class, a bin of scores, is passed over.

    Raises:
        DataError: The file is missing, or a line is not as expected.
    """
    path = Path(path)
    head, rows = read_rows(path, "JOD scores", SOURCE)
    check_head(path, head, HEAD)
    check_rows(path, rows, "JOD scores")
    names: dict[str, int] = {}
    asked: dict[tuple[str, str, str], int] = {}
    scores = []
    for line, row in enumerate(rows, 2):
        where = f"{path}: line {line}"
        if len(row) != len(HEAD):
            raise DataError(f"{where}: expected {len(HEAD)} cells, found {len(row)}: {shown(','.join(row))}")
        name, model = (check_name(text, where) for text in row[:2])
        material, mark, count = name.rpartition("_")
        if not (mark and material and count.isascii() and count.isdecimal()):
            raise DataError(f"{where}: expected a material, _ and a number, found {shown(name)}")
        check_name(material, where)
        if not (row[2].isascii() and row[2].isdecimal() and len(row[2]) < 3):
            raise DataError(f"{where}: expected a level from 0 to 99, found {shown(row[2])}")
        level = str(int(row[2]))
        before = min(names.setdefault(name, line), asked.setdefault((material, model, level), line))
        if before != line:
            raise DataError(f"{where}: {shown(name)}, or {model} {level} of {material}, is already in line {before}")
        scores.append([number(row[4], *_JOD, where, "a JOD"), number(row[3], *_DELTA_E, where, "a colour difference")])
    several = {model for _, model, level in asked if level != "0"}
    jod, delta_e = torch.tensor(scores, dtype=torch.float64, device="cpu").unbind(1)
    return JodScores(
        list(names),
        [material for material, _, _ in asked],
        [f"{model}-{level}" if model in several else model for _, model, level in asked],
        jod,
        delta_e,
    )
