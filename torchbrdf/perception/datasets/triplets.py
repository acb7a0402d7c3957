"""Triplets: which of two materials people find more like a third."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.measured.catalogue import MERL_SHA256

SOURCE = (
    "the answers of Lagunas et al. 2019, A similarity measure for material appearance, doi:10.1145/3306346.3323036, "
    "whose authors give them on the paper's page"
)


def file_order(names: Sequence[str]) -> list[str]:
    """Names in the order of their files, NAME.binary: `chrome-steel` before `chrome`."""
    return sorted(names, key=lambda name: f"{name}.binary")


@dataclass(frozen=True)
class Triplets:
    """Triplets: is material a or material b more like the reference? With the votes for each.

    Args:
        materials: Names, in the order of their files.
        questions: [reference, a, b], indices into materials, `(T, 3)` long.
        votes: For a and for b, `(T, 2)` long.

    Source: M. Lagunas et al., A similarity measure for material appearance, 2019, doi:10.1145/3306346.3323036.
    """

    materials: list[str]
    questions: Tensor
    votes: Tensor

    def __len__(self) -> int:
        return len(self.questions)

    @property
    def decided(self) -> Tensor:
        """Decided questions: whether one candidate has more votes than the other, `(T,)`; the others are ties."""
        return self.votes[:, 0] != self.votes[:, 1]

    def select(self, chosen: Tensor) -> "Triplets":
        """Some of the questions, by index or by mask."""
        return Triplets(self.materials, self.questions[chosen], self.votes[chosen])


def read_triplets(path: Path | str, materials: Sequence[str] | None = None) -> Triplets:
    """Read triplets of Lagunas et al. 2019 from a JSON file.

    The file has `answers` [reference, a, b] and `agreement` [votes for a, votes for b].

    Args:
        path: The file.
        materials: The names that the answers count, in the order of their files; by default the 100 of MERL.

    Raises:
        DataError: The file is missing, or a question or its votes are not as expected.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "triplets.json"
        ...     _ = path.write_text('{"answers": [[0, 1, 2]], "agreement": [[4, 1]]}')
        ...     read_triplets(path, ["nickel", "brass", "nylon"]).votes
        tensor([[4, 1]])
    """
    names = file_order(list(MERL_SHA256)) if materials is None else list(materials)
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: no such file; expected {SOURCE}")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: expected JSON: {str(error).splitlines()[0]}") from None
    if not isinstance(data, dict):
        raise DataError(f"{path}: expected an object with answers and agreement, found {type(data).__name__}")
    questions, votes = (_integers(data, key, width, path) for key, width in (("answers", 3), ("agreement", 2)))
    if len(questions) != len(votes):
        raise DataError(f"{path}: {len(questions)} answers but {len(votes)} agreements; expected one for each")
    _refuse(((questions < 0) | (questions >= len(names))).any(1), questions, path, f"indices 0 to {len(names) - 1}")
    first, a, b = questions.unbind(1)
    _refuse((first == a) | (first == b) | (a == b), questions, path, "three different materials")
    _refuse(((votes < 0).any(1)) | (votes.sum(1) == 0), votes, path, "votes of at least 0, and one at least")
    return Triplets(names, questions, votes)


def _integers(data: dict[str, Any], key: str, width: int, path: Path) -> Tensor:
    """A list of lists of integers, `(T, width)`."""
    rows = data.get(key)
    if not isinstance(rows, list) or not rows:
        raise DataError(f"{path}: {key}: expected a list of {width} integers a question, found {type(rows).__name__}")
    for place, row in enumerate(rows):
        if not isinstance(row, list) or len(row) != width or not all(type(entry) is int for entry in row):
            raise DataError(f"{path}: {key}[{place}]: expected {width} integers, found {row!r}")
    return torch.tensor(rows, dtype=torch.long, device="cpu")


def _refuse(bad: Tensor, rows: Tensor, path: Path, expected: str) -> None:
    if bad.any():
        place = int(bad.nonzero()[0])
        raise DataError(f"{path}: question {place}: expected {expected}, found {rows[place].tolist()}")
