"""Every published fit beside ours of the same model, under every metric."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.errors import UsageError, shown
from torchbrdf.experiment.settings import STANDINS, FitGridRecipe, load_materials
from torchbrdf.recipe import RECIPES, RunFolder

if TYPE_CHECKING:
    from torchbrdf.measured import Measured
    from torchbrdf.perception import PublishedFits

MADE_UP = "made up"


@RECIPES.register("published_fits")
@dataclass(frozen=True)
class PublishedFitsRecipe(FitGridRecipe):
    """Score fits that Ngan, Low and Bagher published under every metric, beside our fits of the same models."""

    name = "published_fits"

    materials: str = field(default="", metadata={"help": "a folder with MERL tables, named as MERL names them"})
    fits: str = field(default="published_fits.json", metadata={"help": "published parameters"})
    sets: tuple[str, ...] = field(default=(), metadata={"help": "names of sets in it; none: all that are known"})
    models: tuple[str, ...] = field(default=(), metadata={"help": "of the sets; none: all"})
    losses: tuple[str, ...] = (
        "rms", "cosine_rms", "solid_angle_cosine_rms", "cube_root", "compressed", "log", "learned",
    )  # fmt: skip
    lobes: int = field(default=1, metadata={"help": "published fits have one", "low": 1, "high": 1})
    diffuse: str = field(default="fit", metadata={"help": "fit, as in the published fits; or 45:0"})
    fitted: int | None = field(
        default=None,
        metadata={
            "help": "materials of each format that we fit, chosen evenly; published fits of all are scored",
            "low": 1, "high": 10_000, "none": ("all", "0"),
        },
    )  # fmt: skip
    every: int = field(
        default=1,
        metadata={"help": "count one of so many pairs, for less time; 7 is near the same", "low": 1, "high": 1000},
    )

    def __post_init__(self) -> None:
        if not self.quick and not self.materials:
            raise UsageError(f"{self.name}: materials: expected a folder; quick=true runs on made-up fits of stand-ins")
        super().__post_init__()

    def expect_names(self, *settings: str) -> None:
        """No model is all models."""
        super().expect_names(*(key for key in settings if key != "models" or self.models))

    def steps(self, folder: RunFolder) -> Path:
        """Our fits, errors of the published ones, report."""
        from torchbrdf.experiment.published import compare_published, models_of
        from torchbrdf.losses import LOSSES, make_loss
        from torchbrdf.report import write_published_report

        published = {} if self.quick else self._read()
        groups, bad = load_materials(STANDINS if self.quick else self.materials, folder, self.quick)
        if self.quick:
            published = {MADE_UP: _made_up(groups[0])}
        groups = [_thinned(group, self.every) for group in groups]
        groups = _known(groups, published)
        chosen = groups if self.fitted is None else _evenly(groups, self.fitted)
        losses = {LOSSES.canonical(name): make_loss(name) for name in self.losses}
        grid = self.make_grid(folder, chosen, losses, models=tuple(models_of(published)), lobes=(1,))
        found = compare_published(grid, published, groups)
        sources = {name: one.source for name, one in published.items()}
        return write_published_report(grid, found, sources, bad)

    def _read(self) -> "dict[str, PublishedFits]":
        """The sets that are asked for."""
        from torchbrdf.experiment.published import models_of
        from torchbrdf.perception import read_published

        found = read_published(self.fits)
        for name in self.sets:
            if name not in found:
                raise UsageError(f"{self.name}: sets: expected some of {', '.join(found)}, found {name!r}")
        kept = {name: one for name, one in found.items() if not self.sets or name in self.sets}
        models = {name: models_of({name: one})[0] for name, one in kept.items()}
        kept = {name: one for name, one in kept.items() if not self.models or models[name] in self.models}
        if not kept:
            raise UsageError(
                f"{self.name}: models: expected some of {', '.join({*models.values()})}, found none of them"
            )
        return kept


def _thinned(measured: "Measured", every: int) -> "Measured":
    """One of so many pairs, in a file's order."""
    import torch

    if every == 1:
        return measured
    return measured.batch(samples=torch.arange(0, len(measured.pairs), every, dtype=torch.int64, device="cpu"))


def _known(groups: "list[Measured]", published: "dict[str, PublishedFits]") -> "list[Measured]":
    """The materials that some set has."""
    names = {name for one in published.values() for name in one.materials}
    rows = [[k for k, name in enumerate(group.names) if name in names] for group in groups]
    if not any(rows):
        raise UsageError(
            f"published_fits: materials: expected some of those that were fitted, such as {shown(min(names))}, "
            f"found {shown(groups[0].names[0])}"
        )
    return [group.batch(own) for group, own in zip(groups, rows, strict=True) if own]


def _evenly(groups: "list[Measured]", count: int) -> "list[Measured]":
    """So many of the materials of each group, or all, evenly along their order."""
    return [
        group.batch([k * len(group) // count for k in range(count)]) if count < len(group) else group
        for group in groups
    ]


def _made_up(measured: "Measured") -> "PublishedFits":
    """Hasty fits in the place of published ones."""
    from torchbrdf.fitting import fit
    from torchbrdf.lobes import Sum, make_model
    from torchbrdf.losses import make_loss
    from torchbrdf.perception import PublishedFits

    found = fit(make_model("ward", 1), measured, make_loss("rms"), strategy="staged", max_theta=60.0, samples=500)
    return PublishedFits(
        MADE_UP, "no publication: hasty fits, to see that all works", list(found.names), Sum(*found.model.components())
    )
