"""Who preferred what to what how often: answers as counts."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.reading import LIMIT_VARIABLE, largest
from torchbrdf.registry import unknown
from torchbrdf.study.answers import Answer


@dataclass(frozen=True)
class Comparisons:
    """Paired comparisons as counts: which observer preferred what to what how often.

    Args:
        materials: Names of the M materials.
        stimuli: The names of each material's stimuli; n is the largest number of them.
        observers: Names of the O observers.
        wins: `(O, M, n, n)`, float64; wins[o, m, i, j] says how often observer o preferred stimulus i of material m to
            stimulus j. Materials with fewer stimuli are padded with zeros.

    Raises:
        ShapeError: The shapes do not fit together, or wins are not float64.

    Example:
        >>> from torchbrdf.study import Answer
        >>> comparisons = Comparisons.from_answers([Answer("ann", "gloss", "nickel", "ward", "cook", chosen="cook")])
        >>> comparisons.stimuli, comparisons.total.tolist()
        ([['ward', 'cook']], [[[0.0, 0.0], [1.0, 0.0]]])
    """

    materials: list[str]
    stimuli: list[list[str]]
    observers: list[str]
    wins: Tensor

    def __post_init__(self) -> None:
        n = max((len(names) for names in self.stimuli), default=0)
        expected = (len(self.observers), len(self.materials), n, n)
        if tuple(self.wins.shape) != expected or len(self.stimuli) != len(self.materials):
            raise ShapeError(f"comparisons: wins: expected {expected}, found {(*self.wins.shape,)}")
        if self.wins.dtype != torch.float64:
            raise ShapeError(f"comparisons: wins: expected float64, found {self.wins.dtype}")

    @classmethod
    def from_answers(cls, answers: Iterable[Answer], experiment: str | None = None) -> "Comparisons":
        """Counts of the trials among answers of one experiment; repeats and catch trials do not count.

        Args:
            answers: Of observers; names are numbered in the order of their first appearance.
            experiment: Its name; may be left out if there is one only.

        Raises:
            UsageError: There are several experiments and none is named, or no such one.
            DataError: There is no trial, or the counts are larger than `reading.largest`.
        """
        trials = [answer for answer in one_experiment(answers, experiment) if answer.kind == "trial"]
        if not trials:
            raise DataError("comparisons: expected answers to trials, found none")
        observers = _numbered(answer.observer for answer in trials)
        materials = _numbered(answer.material for answer in trials)
        stimuli: list[dict[str, int]] = [{} for _ in materials]
        places = []
        for answer in trials:
            m = materials[answer.material]
            for name in (answer.left, answer.right):
                stimuli[m].setdefault(name, len(stimuli[m]))
            places.append((observers[answer.observer], m, stimuli[m][answer.chosen], stimuli[m][answer.rejected]))
        n = max(len(names) for names in stimuli)
        size = 8 * len(observers) * len(materials) * n * n
        if size > largest():
            raise DataError(
                f"comparisons: expected at most {largest()} bytes of counts, found {size}: {len(observers)} observers, "
                f"{len(materials)} materials, {n} stimuli; {LIMIT_VARIABLE} raises the limit"
            )
        wins = torch.zeros(len(observers), len(materials), n, n, dtype=torch.float64, device="cpu")
        index = torch.tensor(places, dtype=torch.int64, device="cpu").unbind(1)
        wins.index_put_(index, torch.ones(len(places), dtype=torch.float64, device="cpu"), accumulate=True)
        return cls(list(materials), [list(names) for names in stimuli], list(observers), wins)

    @property
    def total(self) -> Tensor:
        """Wins of all observers together, `(M, n, n)`."""
        return self.wins.sum(0)

    @property
    def compared(self) -> Tensor:
        """How often each pair was compared, `(M, n, n)`, symmetric."""
        total = self.total
        return total + total.mT

    @property
    def present(self) -> Tensor:
        """Which stimuli were compared with any other, `(M, n)`, bool."""
        return (self.compared > 0).any(-1)

    def select(self, observers: Sequence[int]) -> "Comparisons":
        """Comparisons of some observers, by their numbers; materials and stimuli stay where they are."""
        return replace(
            self,
            observers=[self.observers[k] for k in observers],
            wins=self.wins[torch.tensor(observers, dtype=torch.int64, device="cpu")],
        )

    def check_connected(self) -> None:
        """Refuse comparisons that do not link all stimuli of a material: parts have no known distance.

        Raises:
            DataError: Names the material, and a stimulus of each part.
        """
        compared, present = self.compared, self.present
        whole = connected(compared)
        if bool(whole.all()):
            return
        m = int((~whole).nonzero()[0])
        parts = reachable(compared[m])[present[m]].unique(dim=0)
        named = ", ".join(repr(self.stimuli[m][int(part.nonzero()[0])]) for part in parts)
        raise DataError(
            f"{self.materials[m]}: expected comparisons that link all stimuli, found {len(parts)} parts without a "
            f"comparison between them, those of {named}"
        )


def one_experiment(answers: Iterable[Answer], experiment: str | None) -> list[Answer]:
    """The answers of one experiment; a UsageError if there are several and none is named, or no such one."""
    answers = list(answers)
    names = list(_numbered(answer.experiment for answer in answers))
    if experiment is None:
        if len(names) > 1:
            raise UsageError(f"answers: expected the name of one experiment, found {', '.join(names)}")
        return answers
    if answers and experiment not in names:
        raise unknown("experiment", experiment, names)
    return [answer for answer in answers if answer.experiment == experiment]


def _numbered(names: Iterable[str]) -> dict[str, int]:
    """Each name once, in order of first appearance, and its number."""
    return {name: k for k, name in enumerate(dict.fromkeys(names))}


def reachable(compared: Tensor) -> Tensor:
    """Which stimuli are linked by a chain of comparisons: symmetric counts `(..., n, n)` to bool `(..., n, n)`.

    Each stimulus is linked with itself. By squaring the matrix of links until chains of any length are in it.
    """
    n = compared.shape[-1]
    links = ((compared > 0) | torch.eye(n, dtype=torch.bool, device="cpu")).to(torch.float32)
    for _ in range(math.ceil(math.log2(max(n - 1, 1)))):
        links = (links @ links > 0).to(torch.float32)
    return links > 0


def connected(compared: Tensor) -> Tensor:
    """Whether all stimuli that were compared are linked: symmetric counts `(..., n, n)` to bool `(...)`."""
    present = (compared > 0).any(-1)
    both = present[..., :, None] & present[..., None, :]
    if bool(
        (compared > 0).logical_or(~both).logical_or(torch.eye(compared.shape[-1], dtype=torch.bool, device="cpu")).all()
    ):
        return torch.ones(compared.shape[:-2], dtype=torch.bool, device="cpu")
    return (reachable(compared) | ~both).all(-1).all(-1)
