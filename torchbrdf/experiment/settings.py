"""Settings that recipes share, and how what they name is made or read."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from torchbrdf import kinds
from torchbrdf.errors import DataError, UsageError
from torchbrdf.recipe import Recipe, RunFolder

if TYPE_CHECKING:
    from torchbrdf.experiment.grid import FitGrid
    from torchbrdf.losses import Loss
    from torchbrdf.measured import Measured
    from torchbrdf.perception import BenchmarkData

# Here and in recipes, what works is imported where it is used: wrong settings are refused before torch is imported.
STANDINS = "stand-ins"
# Pairs that the solver sees at most in a quick run, and of how many of a table's pairs there is one.
QUICK_SAMPLES, QUICK_EVERY = 1000, 29
# Bounds of settings, which the options of `torchbrdf fit` have, too.
LOBE_COUNTS = {"low": 1, "high": 8}
ANGLES = {"low": 1.0, "high": 90.0}
FIT_SAMPLES = {"low": 1, "high": 10_000_000}
PICTURE_SIDES = {"low": 16, "high": 4096}


@dataclass(frozen=True)
class FitGridRecipe(Recipe):
    """Settings of a recipe that fits models to materials under losses."""

    materials: str = field(default=STANDINS, metadata={"help": "a file or a folder of measured BRDFs; or stand-ins"})
    models: tuple[str, ...] = ("ward", "cook_torrance", "ashikhmin_shirley")
    losses: tuple[str, ...] = ("rms", "cosine_rms", "cube_root")
    lobes: int = field(default=2, metadata={"help": "specular lobes", **LOBE_COUNTS})
    strategy: str = field(default="global", metadata={"help": "global finds the best fit; staged is the paper's"})
    diffuse: str = field(default="45:0", metadata={"help": "45:0 as in the paper, or fit: every loss chooses its own"})
    max_theta: float = field(
        default=80.0, metadata={"help": "only pairs with both directions below this angle", **ANGLES}
    )
    samples: int | None = field(
        default=20_000, metadata={"help": "pairs that the solver sees, or all", **FIT_SAMPLES, "none": ("all", "0")}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.expect_names("models", "losses")
        for name in self.losses:
            kinds.LOSSES.check(name)
        for name in self.models:
            kinds.check_model(name)
        kinds.STRATEGIES.check(self.strategy)
        kinds.check_word(f"diffuse of {self.name}", self.diffuse, kinds.DIFFUSE_MODES)
        from torchbrdf.lobes.model import lobe_count  # last, as it imports torch

        for name in self.models:
            lobe_count(name, self.lobes)

    def expect_names(self, *settings: str) -> None:
        """A UsageError if one of these settings is empty, or has a name twice."""
        for key in settings:
            names = getattr(self, key)
            if not names:
                raise UsageError(f"{self.name}: {key}: expected at least one name, found none")
            twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
            if twice is not None:
                raise UsageError(f"{self.name}: {key}: expected each name once, found {twice!r} twice")

    def make_grid(
        self,
        folder: RunFolder,
        groups: "list[Measured]",
        losses: "Mapping[str, Loss]",
        *,
        models: tuple[str, ...] = (),
        lobes: tuple[int, ...] = (),
        compare_strategy: str | None = None,
    ) -> "FitGrid":
        """The grid of fits that the settings describe.

        Args:
            folder: Of the run.
            groups: The materials.
            losses: By name.
            models: Where not all of the setting.
            lobes: Numbers of lobes, where there are several.
            compare_strategy: Another strategy.
        """
        from torchbrdf.experiment.grid import FitGrid

        return FitGrid(
            folder,
            groups,
            models or self.models,
            losses,
            lobes=lobes or (self.lobes,),
            strategy=self.strategy,
            compare_strategy=compare_strategy,
            diffuse=self.diffuse,
            max_theta=self.max_theta,
            samples=min(self.samples or QUICK_SAMPLES, QUICK_SAMPLES) if self.quick else self.samples,
            seed=self.seed,
        )


def load_materials(materials: str, folder: RunFolder, quick: bool) -> "tuple[list[Measured], list[str]]":
    """The measured BRDFs of a file or a folder, or the stand-ins.

    Args:
        materials: A path, or `stand-ins`.
        folder: Of the run; its log says what was left out.
        quick: Take two of each format, and few of their pairs.

    Returns:
        The materials by format, and what was left out.

    Raises:
        DataError: There is not one that can be read.

    Example:
        >>> from pathlib import Path
        >>> groups, left_out = load_materials(STANDINS, RunFolder(Path()), quick=True)
        >>> groups[0].names, left_out
        (['alum-bronze', 'aluminium'], [])
    """
    from torchbrdf.measured import load_all, standins

    bad: list[DataError] = []
    groups = load_all(standins() if materials == STANDINS else materials, bad=bad)
    if not groups:
        raise bad[0] if bad else DataError(f"{materials}: no measured BRDFs")
    for error in bad:
        folder.warn(f"left out: {error}")
    if quick:
        groups = [_few(group) for group in groups]
    return groups, [str(error) for error in bad]


def _few(group: "Measured") -> "Measured":
    """Two materials, with one of QUICK_EVERY pairs where they have many."""
    import torch

    count = len(group.pairs)
    every = QUICK_EVERY if count > QUICK_EVERY * QUICK_SAMPLES else 1
    return group.batch(range(min(2, len(group))), torch.arange(0, count, every, dtype=torch.int64, device="cpu"))


@dataclass(frozen=True)
class HumanAnswersRecipe(Recipe):
    """Settings of a recipe that reads materials, their published approximations, and what people answered."""

    materials: str = field(default="", metadata={"help": "a folder with the 100 MERL tables"})
    human: str = field(default="", metadata={"help": "a folder with the published answers"})
    fits: str = field(default="published_fits.json", metadata={"help": "published parameters of approximations"})
    factors: str = field(
        default="npf.bin",
        metadata={
            "help": "non-parametric factors of approximations, method BAGHER; left out where there is no such file"
        },
    )
    triplets: str = field(default="lagunas2019_triplets_train.json", metadata={"help": "a file in `human`"})
    opinions: str = field(default="lavoue2021_distances_train.csv", metadata={"help": "a file in `human`"})
    samples: int = field(
        default=6000, metadata={"help": "pairs, uniform in theta_i, theta_o and phi", "low": 2, "high": 200_000}
    )
    replicates: int = field(
        default=1000, metadata={"help": "bootstrap replicates over materials", "low": 2, "high": 100_000}
    )

    def read_benchmark_data(self) -> "BenchmarkData":
        """The materials, approximations and answers that the settings name."""
        from torchbrdf.perception import read_benchmark_data

        return read_benchmark_data(self.materials, self.human, self.fits, self.factors, self.triplets, self.opinions)
