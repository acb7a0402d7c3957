"""Triplets: which of two materials people find more like a third."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.measured.catalogue import MERL_SHA256
from torchbrdf.reading import exists, read_json

SOURCE = (
    "the answers of Lagunas et al. 2019, A similarity measure for material appearance, doi:10.1145/3306346.3323036, "
    "whose authors give them on the paper's page"
)


# More than any question was ever put to.
MOST_VOTES = 1_000_000
_Index = Annotated[int, msgspec.Meta(ge=0, lt=2**31)]
_Votes = Annotated[int, msgspec.Meta(ge=0, le=MOST_VOTES)]


class _File(msgspec.Struct):
    """What a file of triplets holds."""

    answers: Annotated[list[tuple[_Index, _Index, _Index]], msgspec.Meta(min_length=1)]
    agreement: list[tuple[_Votes, _Votes]]


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
    if not exists(path):
        raise DataError(f"{path}: no such file; expected {SOURCE}")
    data: _File = read_json(path, _File, "answers to triplets and their agreement")
    if len(data.answers) != len(data.agreement):
        counts = f"{len(data.answers)} answers but {len(data.agreement)} agreements"
        raise DataError(f"{path}: {counts}; expected one for each")
    questions, votes = (torch.tensor(rows, dtype=torch.int64, device="cpu") for rows in (data.answers, data.agreement))
    _refuse((questions >= len(names)).any(1), questions, path, f"indices 0 to {len(names) - 1}")
    first, a, b = questions.unbind(1)
    _refuse((first == a) | (first == b) | (a == b), questions, path, "three different materials")
    _refuse(votes.sum(1) == 0, votes, path, "one vote at least")
    return Triplets(names, questions, votes)


def _refuse(bad: Tensor, rows: Tensor, path: Path, expected: str) -> None:
    if bad.any():
        place = int(bad.nonzero()[0])
        raise DataError(f"{path}: question {place}: expected {expected}, found {rows[place].tolist()}")
