"""What is tried: models that a target can show, the simplest first, and how much work that may be."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from torchbrdf.errors import UsageError, shown
from torchbrdf.kinds import JOIN, LOBES

if TYPE_CHECKING:
    from torchbrdf.lobes import Lobe

PICTURES = "rendered"
# Of a metric and pictures together: between their names.
AND = "+"
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")


@dataclass(frozen=True)
class Candidate:
    """A model to try.

    Args:
        model: As for `make_model`.
        lobes: As for `make_model`.
        metrics: What it is fitted under: losses of BRDF values, `PICTURES`, or one of the former `AND` these; None:
            the budget's metric, and pictures. Tables have a solver of their own, which pictures alone are too little
            for.

    Example:
        >>> Candidate("ggx", 2).label, Candidate("oren_nayar+ggx+ggx").label
        ('two GGX lobes', 'Oren-Nayar and two GGX lobes')
    """

    model: str
    lobes: int | None = None
    metrics: tuple[str, ...] | None = None

    def losses(self, budget: "Budget") -> tuple[str, ...]:
        """The names of the losses that it is fitted under; `PICTURES` for pictures."""
        if self.metrics is not None:
            return self.metrics
        return (*([budget.metric] if budget.metric else []), PICTURES)

    def make(self) -> "Lobe":
        """The model, at its start."""
        from torchbrdf.lobes import make_model

        return make_model(self.model, self.lobes)

    @property
    def stem(self) -> str:
        """A name for its files."""
        return self.model if self.lobes is None else f"{self.model}-{self.lobes}"

    @property
    def label(self) -> str:
        """What it is, for people; the Lambert term that most models have is not said."""
        from torchbrdf.experiment.labels import model_label
        from torchbrdf.lobes.model import component_kinds

        own = [LOBES[part] for part in self.model.split(JOIN)]
        if own[0].is_material:
            return f"the {model_label(self.model)} material"
        counts: dict[str, int] = {}
        for kind in component_kinds(self.model, self.lobes):
            name = str(LOBES.name_of(kind))
            if kind in own:
                counts[name] = counts.get(name, 0) + 1
        return " and ".join(_counted(name, count) for name, count in counts.items())


def _counted(name: str, count: int) -> str:
    from torchbrdf.experiment.labels import model_label

    return model_label(name) if LOBES[name].is_diffuse else so_many(count, f"{model_label(name)} lobe")


def so_many(count: int, what: str) -> str:
    """A small number as a word, and of what.

    Example:
        >>> so_many(1, "scene"), so_many(12, "scene")
        ('one scene', '12 scenes')
    """
    return f"{NUMBERS[count] if count < len(NUMBERS) else count} {what}{'' if count == 1 else 's'}"


# Models of targets that have one form of material and no tables: what they show has this form. Blender's node is
# written as what OpenPBR's material is.
OWN_MODEL: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"gltf": ("gltf",), "blender": ("openpbr",), "mtlx": ("openpbr",)}
)
OF_TABLES = ("compressed", "log", f"compressed{AND}{PICTURES}")
TABLES = tuple(Candidate("distribution_based", lobes, OF_TABLES) for lobes in (2, 3))
FEW = (Candidate("ggx", 1), Candidate("ggx", 2))
USUAL = (*FEW, Candidate("gtr", 2), Candidate("ggx", 3), *TABLES)
MANY = (
    Candidate("ggx", 1),
    Candidate("gtr", 1),
    Candidate("ggx", 2),
    Candidate("gtr", 2),
    Candidate("oren_nayar+ggx+ggx"),
    Candidate("eon+ggx+ggx"),
    Candidate("ggx", 3),
    Candidate("gtr", 3),
    *TABLES,
)


@dataclass(frozen=True)
class Budget:
    """How much is tried.

    Args:
        name: Of the budget.
        candidates: Simplest first, of targets that can show any.
        metric: The loss of BRDF values that each is fitted under, too; None: none.
        size: Pixels of a side of each picture that fits see.
        views: How many pictures they see, 1 to 3.
        all_of_them: Whether more is tried after a model that cannot be told from the measurement.
        seconds: After which no other candidate is begun.
    """

    name: str
    candidates: tuple[Candidate, ...]
    metric: str | None
    size: int
    views: int
    all_of_them: bool = False
    seconds: float = math.inf


BUDGETS: Mapping[str, Budget] = MappingProxyType(
    {
        "quick": Budget("quick", FEW, None, size=32, views=1),
        "default": Budget("default", USUAL, "learned", size=40, views=2),
        "thorough": Budget("thorough", MANY, "learned", size=64, views=3, all_of_them=True),
    }
)


def find_budget(text: str) -> Budget:
    """A budget by its name; or so many seconds, in which the default's candidates are begun.

    Raises:
        UsageError: It is neither.

    Example:
        >>> find_budget("quick").size, find_budget("90").seconds
        (32, 90.0)
    """
    if text in BUDGETS:
        return BUDGETS[text]
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0 < seconds < math.inf:
        raise UsageError(f"budget: expected {', '.join(BUDGETS)} or a number of seconds, found {shown(text)}")
    return replace(BUDGETS["default"], seconds=seconds)


def candidates_for(target: str, budget: Budget) -> tuple[Candidate, ...]:
    """The models to try for a target, simplest first.

    Args:
        target: The registered name of an exporter.
        budget: How much is tried.

    Returns:
        The target's own model, where it has only that, or the budget's.
    """
    own = tuple(Candidate(name) for name in OWN_MODEL.get(target, ()) if name in LOBES)
    return own or budget.candidates
