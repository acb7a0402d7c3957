"""A study: models fitted to materials under losses, scored across them, and drawn. Finished parts are taken up."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError
from torchbrdf.files import write_text
from torchbrdf.fitting import STRATEGIES, cross_score, fit, local_minima, write_csv
from torchbrdf.images import DIFFERENCES, ToneMap, composite, read_image, write_exr, write_png
from torchbrdf.lobes import LOBES, make_model, model_of, read_fits, write_fits
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured, contrast_gloss, distinctness_of_image, load_all, standins
from torchbrdf.recipe import RunFolder
from torchbrdf.render import Scene, render

STANDINS = "stand-ins"
REFERENCE = "reference"
# Image differences that the report speaks of, by their registered names.
SHOWN_DIFFERENCES = ("psnr", "ssim", "delta_e76")
DIFFERENCE = "delta_e76"


@dataclass
class Study:
    """What a study compares, the folder it works in, and its records, one a fit, as in `fits.json`.

    losses: by the names that records and pictures have. beside: another strategy, whose fits with the first number of
    lobes are compared with those of `strategy`.
    """

    folder: RunFolder
    groups: list[Measured]
    models: Sequence[str]
    losses: Mapping[str, Loss]
    lobes: Sequence[int] = (2,)
    strategy: str = "global"
    beside: str | None = None
    diffuse: str = "45:0"
    max_theta: float = 80.0
    samples: int | None = 20_000
    seed: int = 0
    records: list[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        for name in self.models:
            LOBES[name]
        for name in (self.strategy, *([self.beside] if self.beside else [])):
            STRATEGIES[name]
        if self.beside == self.strategy:
            raise UsageError(f"beside: expected another strategy than {self.strategy}, or none")
        names = self.materials
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise UsageError(f"materials: {twice[0]!r} comes twice; give each file a name of its own")

    @property
    def materials(self) -> list[str]:
        """The names of all materials."""
        return [name for group in self.groups for name in group.names]

    @property
    def stand_in(self) -> bool:
        """Whether any material is no measurement."""
        return any(group.stand_in for group in self.groups)

    @cached_property
    def gloss(self) -> dict[str, tuple[float, float]]:
        """Distinctness of image, in degrees, and contrast gloss of each material, sharpest highlight first."""
        found = {
            name: (doi, contrast)
            for group in self.groups
            for name, doi, contrast in zip(
                group.names, distinctness_of_image(group).tolist(), contrast_gloss(group).tolist(), strict=True
            )
        }
        return dict(sorted(found.items(), key=lambda item: item[1][0]))

    @property
    def shown(self) -> list[dict[str, Any]]:
        """The records that are drawn: those of the first number of lobes by the strategy."""
        return self.drawn(self.strategy)

    def drawn(self, strategy: str) -> list[dict[str, Any]]:
        """The records of the first number of lobes by either strategy, in the order of materials, models, losses."""
        return [
            self.record(material, model, loss, strategy=strategy)
            for material in self.materials
            for model in self.models
            for loss in self.losses
        ]

    def record(
        self, material: str, model: str, loss: str, lobes: int | None = None, strategy: str | None = None
    ) -> dict[str, Any]:
        """The record of one fit."""
        wanted = (material, model, loss, lobes or self.lobes[0], strategy or self.strategy)
        keys = ("material", "model", "loss", "lobes", "strategy")
        return next(record for record in self.records if tuple(record[key] for key in keys) == wanted)

    # --- fits -----------------------------------------------------------------------------------------------------

    def fit(self) -> None:
        """Fit everything that `fits.json` does not hold yet, and score it under every loss."""
        path = self.folder.path / "fits.json"
        self.records = read_fits(path) if path.exists() else []
        kinds = [(self.strategy, lobes) for lobes in self.lobes]
        kinds += [(self.beside, self.lobes[0])] if self.beside else []
        advance = self.folder.progress("fits", len(self.materials) * len(self.models) * len(self.losses) * len(kinds))
        advance(len(self.records))
        for strategy, lobes in kinds:
            for model in self.models:
                for group in self.groups:
                    if not self._has(strategy, model, lobes, group):
                        self.records += self._fit(strategy, model, lobes, group, advance)
                        self.save()

    def save(self) -> None:
        """Write `fits.json` and `fits.csv`."""
        write_fits(self.folder.path / "fits.json", self.records)
        write_csv(self.folder.path / "fits.csv", self.records)

    def _has(self, strategy: str, model: str, lobes: int, group: Measured) -> bool:
        keys = ("strategy", "model", "lobes", "material")
        there = {tuple(record[key] for key in keys) for record in self.records}
        return all((strategy, model, lobes, name) in there for name in group.names)

    def _fit(self, strategy: str, model: str, lobes: int, group: Measured, advance: Any) -> list[dict[str, Any]]:
        losses = list(self.losses.values())
        results = [
            fit(
                make_model(model, lobes),
                group,
                loss,
                strategy=strategy,
                diffuse=self.diffuse,
                max_theta=self.max_theta,
                samples=self.samples,
                seed=self.seed,
                progress=advance,
            )
            for loss in losses
        ]
        seen = group.within(self.max_theta)
        cross = cross_score([result.model for result in results], seen, losses)
        outliers = local_minima(cross)
        records = []
        for b, result in enumerate(results):
            for m, record in enumerate(result.records()):
                record["errors"] = {name: cross[a, b, m].item() for a, name in enumerate(self.losses)}
                record["outlier"] = bool(outliers[b, m])
                records.append(record)
            self.folder.log(
                f"{strategy}: {model}, {lobes} lobes, {result.loss}: {len(result.names)} fits, {result.seconds:.1f} s"
            )
        return records

    # --- pictures -------------------------------------------------------------------------------------------------

    def draw(self, scene: Scene, turned: Scene) -> None:
        """Render every material and every fit in one view, and the materials in the turned view of observers.

        Linear pictures are kept as EXR; the tone map is measured over all pictures of the first view, kept in
        `tonemap.json`, and used for every PNG. Image differences are taken in the first view.
        """
        folder = self.folder.path / "renders"
        folder.mkdir(exist_ok=True)
        jobs = [job for job in self._jobs(scene, turned) if not all(self.exr(name).exists() for name in job[2])]
        advance = self.folder.progress("renders", sum(len(names) for _, _, names in jobs))
        for where, brdf, names in jobs:
            for name, picture in zip(names, render(brdf, where), strict=True):
                write_exr(self.exr(name), picture)
                advance(1)
            self.folder.log(f"{len(names)} renders: {names[0]} to {names[-1]}")
        self._compare(scene, turned)

    def exr(self, name: str) -> Any:
        """Where a linear picture is."""
        return self.folder.path / "renders" / f"{name}.exr"

    def png(self, name: str) -> Any:
        """Where a picture for display is."""
        return self.folder.path / "renders" / f"{name}.png"

    def _jobs(self, scene: Scene, turned: Scene) -> list[tuple[Scene, Any, list[str]]]:
        """Scenes, what to draw in them, and the pictures' names."""
        jobs: list[tuple[Scene, Any, list[str]]] = []
        for group in self.groups:
            jobs.append((scene, group, [picture(name) for name in group.names]))
            jobs.append((turned, group, [picture(name, "turned") for name in group.names]))
        for strategy in self.strategies:
            for model in self.models:
                chosen = [record for record in self.drawn(strategy) if record["model"] == model]
                jobs.append((scene, model_of(chosen), [self.picture(record) for record in chosen]))
        return jobs

    @property
    def strategies(self) -> list[str]:
        """The strategy, and the one beside it."""
        return [self.strategy, *([self.beside] if self.beside else [])]

    def picture(self, record: dict[str, Any]) -> str:
        """The name of the picture of a fit, without suffix."""
        other = [record["strategy"]] if record["strategy"] != self.strategy else []
        return picture(record["material"], record["model"], record["loss"], *other)

    def _compare(self, scene: Scene, turned: Scene) -> None:
        chosen = [record for strategy in self.strategies for record in self.drawn(strategy)]
        references = self._read([picture(name) for name in self.materials])
        fitted = self._read([self.picture(record) for record in chosen])
        mask = scene.mask.expand(len(references) + len(fitted), *scene.mask.shape)
        tone = ToneMap.from_images(torch.cat([references, fitted]), mask)
        self.tone = tone
        write_text(self.folder.path / "tonemap.json", json.dumps(tone.to_dict(), indent=1) + "\n")
        shown = tone(references)
        for name, display in zip(self.materials, shown, strict=True):
            write_png(self.png(picture(name)), composite(display, scene.coverage))
        for name in self.materials:
            display = tone(self._read([picture(name, "turned")]))[0]
            write_png(self.png(picture(name, "turned")), composite(display, turned.coverage))
        measures = {name: DIFFERENCES[name]() for name in SHOWN_DIFFERENCES}
        for record, linear in zip(chosen, fitted, strict=True):
            display = tone(linear)
            write_png(self.png(self.picture(record)), composite(display, scene.coverage))
            reference = shown[self.materials.index(record["material"])]
            record["differences"] = {
                key: measure(display[None], reference[None], scene.mask).item() for key, measure in measures.items()
            }
        self.save()

    def _read(self, names: list[str]) -> Tensor:
        return torch.stack([read_image(self.exr(name)) for name in names])


def gather(materials: str, folder: RunFolder, quick: bool) -> tuple[list[Measured], list[str]]:
    """The measured BRDFs of a file or a folder (or the stand-ins), two of each kind if it is to be quick, and what was
    left out.
    """
    bad: list[DataError] = []
    groups = load_all(standins() if materials == STANDINS else materials, bad=bad)
    if not groups:
        raise bad[0] if bad else DataError(f"{materials}: no measured BRDFs")
    for error in bad:
        folder.warn(f"left out: {error}")
    if quick:
        groups = [group.batch(range(min(2, len(group)))) for group in groups]
    return groups, [str(error) for error in bad]


def picture(material: str, *parts: str) -> str:
    """The name of a picture, without suffix: of a fit by model and loss, of the material itself without."""
    return "-".join([material, *(parts or (REFERENCE,))])
