"""A grid of fits: every model fitted to every material under every loss, and scored under all of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.experiment.unfinished import FOLDER, Unfinished
from torchbrdf.fitting import STRATEGIES, cross_score, fit, local_minima, write_fits_csv
from torchbrdf.fitting.gathered import Gathered
from torchbrdf.fitting.parameters import has_measurable_diffuse
from torchbrdf.fitting.strategy import Strategy, strategy_name
from torchbrdf.lobes import FitRecord, make_model, read_fits, write_fits
from torchbrdf.lobes.model import lobe_count
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured, contrast_gloss, distinctness_of_image
from torchbrdf.names import file_stem, same_file
from torchbrdf.progress import Progress, part_of
from torchbrdf.recipe import RunFolder

REFERENCE = "reference"


@dataclass
class FitGrid:
    """Fits of materials x models x losses, in the folder of a run. What `fits.json` holds is not fitted again.

    Args:
        folder: Where `fits.json` and `fits.csv` are.
        groups: The materials.
        models: Names of models, as `make_model` takes them.
        losses: By the names that records and pictures have.
        lobes: Numbers of specular lobes, where a model's name leaves it open; the fits with the first of them are those
            that are drawn.
        strategy: How they are fitted.
        compare_strategy: Another strategy, whose fits with the first number of lobes are compared with these.
        diffuse: How all fits alike treat the diffuse albedo, `45:0` or `fit`.
        max_theta: As in `torchbrdf.fit`, as the next two; in degrees.
        samples: Pairs that the solver sees.
        seed: Of the subset.
        own_strategies: By the names of losses whose fits are made by another strategy than the others'.
        records: One a fit.

    Raises:
        UsageError: An unknown name, the same strategy twice, or two materials of one name.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from torchbrdf.losses import LOSSES
        >>> from torchbrdf.measured import load, standins
        >>> losses = {name: LOSSES[name]() for name in ("rms", "log")}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     run, materials = RunFolder(Path(folder)), [load(standins()).batch([7])]
        ...     grid = FitGrid(run, materials, ["ward"], losses, lobes=(1,), max_theta=20.0, samples=200)
        ...     grid.fit()
        >>> [(record.loss, len(record.errors)) for record in grid.shown]
        [('rms', 2), ('log', 2)]
    """

    folder: RunFolder
    groups: list[Measured]
    models: Sequence[str]
    losses: Mapping[str, Loss]
    lobes: Sequence[int] = (2,)
    strategy: str = "global"
    compare_strategy: str | None = None
    diffuse: str = "45:0"
    max_theta: float = 80.0
    samples: int | None = 20_000
    seed: int = 0
    own_strategies: dict[str, str | Strategy] = field(default_factory=dict)
    records: list[FitRecord] = field(default_factory=list)

    def __post_init__(self) -> None:
        for name in self.models:
            lobe_count(name, self.lobes[0])
        for name in self.strategies:
            STRATEGIES[name]
        if self.compare_strategy == self.strategy:
            raise UsageError(f"compare_strategy: expected another strategy than {self.strategy}, or none")
        names = self.materials
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise UsageError(f"materials: {twice[0]!r} comes twice; give each file a name of its own")
        files: dict[str, str] = {}
        for name in names:
            other = files.setdefault(same_file(file_stem(name)), name)
            if other != name:
                raise UsageError(
                    f"materials: pictures of {shown(other)} and {shown(name)} are one file on some systems"
                )

    @property
    def materials(self) -> list[str]:
        """The names of all materials."""
        return [name for group in self.groups for name in group.names]

    @property
    def strategies(self) -> list[str]:
        """The strategy, and the one that it is compared with."""
        return [self.strategy, *([self.compare_strategy] if self.compare_strategy else [])]

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
    def shown(self) -> list[FitRecord]:
        """The records of the first number of lobes by the strategy."""
        return self.by_strategy(self.strategy)

    @property
    def drawn(self) -> list[FitRecord]:
        """The records that have pictures: those of the first number of lobes by both strategies."""
        return [record for strategy in self.strategies for record in self.by_strategy(strategy)]

    def by_strategy(self, strategy: str) -> list[FitRecord]:
        """The records of the first number of lobes by a strategy, in the order of materials, models, losses."""
        return [
            self.record(material, model, loss, strategy=strategy)
            for material in self.materials
            for model in self.models
            for loss in self.losses
        ]

    def record(
        self, material: str, model: str, loss: str, lobes: int | None = None, strategy: str | None = None
    ) -> FitRecord:
        """The record of one fit.

        Raises:
            DataError: There is none: `fit` was not called, or the grid is about something else.
        """
        strategy = self._strategy_of(loss, strategy or self.strategy)
        wanted = (material, model, loss, lobe_count(model, lobes or self.lobes[0]), strategy)
        for record in self.records:
            if _key(record) == wanted:
                return record
        raise DataError(f"{self.folder.path}: expected a fit {', '.join(map(str, wanted))}, found none")

    def _strategy_of(self, loss: str, strategy: str) -> str:
        """The name of the strategy of a loss, in the place of one for all."""
        return strategy_name(self.own_strategies.get(loss, strategy))

    def picture(self, record: FitRecord) -> str:
        """The name of the picture of a fit, without suffix."""
        other = [record.strategy] if record.strategy != self._strategy_of(record.loss, self.strategy) else []
        return picture_name(record.material, record.model, record.loss, *other)

    def fit(self) -> None:
        """Fit everything that the folder does not hold yet, and score it under every loss.

        `fits.json` is written when all is done; until then each unit of the work is a few parts, see `Unfinished`.
        """
        path, unfinished = self.folder.path / "fits.json", Unfinished(self.folder.path)
        self.records = self._checked(path, read_fits(path)) if path.exists() else []
        there = {_key(record) for record in self.records}
        kept = [record for record in unfinished.records() if _key(record) not in there]
        self.records += self._checked(self.folder.path / FOLDER, kept)
        kinds = [(self.strategy, lobes) for lobes in self.lobes]
        kinds += [(self.compare_strategy, self.lobes[0])] if self.compare_strategy else []
        total = len(self.materials) * len(self.models) * len(self.losses) * len(kinds)
        progress = self.folder.progress("fits")
        progress(len(self.records), total)
        before, order = len(self.records) - len(kept), dict[tuple[str, str, str, int, str], int]()
        models = [make_model(name, lobe_count(name, self.lobes[0])) for name in self.models]
        losses = list(self.losses.values())
        gathered = [Gathered(group.within(self.max_theta), models, losses) for group in self.groups]
        for strategy, lobes in kinds:
            for model in self.models:
                count = lobe_count(model, lobes)
                for group, sums in zip(self.groups, gathered, strict=True):
                    if not self._has(strategy, model, count, group):
                        made = self._fit(strategy, model, count, group, sums, progress, total)
                        unfinished.add(made)
                        known = {_key(record) for record in self.records}
                        self.records += [record for record in made if _key(record) not in known]
                    for loss in self.losses:
                        for name in group.names:
                            order.setdefault((name, model, loss, count, self._strategy_of(loss, strategy)), len(order))
        if len(self.records) > before:
            self.records.sort(key=lambda record: order.get(_key(record), -1))  # as if they had been made in one go
            self.save()
        unfinished.remove()

    def _checked(self, path: Path, records: list[FitRecord]) -> list[FitRecord]:
        """The records of an earlier run in this folder.

        Raises:
            DataError: They are other fits, or lack what every fit of a grid has.
        """
        wanted = {"materials": self.materials, "models": self.models, "losses": list(self.losses)}
        for k, record in enumerate(records):
            for (plural, names), name in zip(wanted.items(), (record.material, record.model, record.loss), strict=True):
                if name not in names:
                    raise DataError(f"{path}: fit {k}: expected one of the {plural} of this run, found {shown(name)}")
            if set(record.errors) != set(self.losses) or record.outlier is None:
                raise DataError(f"{path}: fit {k}: expected its errors under {', '.join(self.losses)}, and outlier")
        return records

    def save(self) -> None:
        """Write `fits.json` and `fits.csv`."""
        write_fits(self.folder.path / "fits.json", self.records)
        write_fits_csv(self.folder.path / "fits.csv", self.records)

    def _has(self, strategy: str, model: str, lobes: int, group: Measured) -> bool:
        there = {_key(record) for record in self.records}
        wanted = [(loss, self._strategy_of(loss, strategy)) for loss in self.losses]
        return all((name, model, loss, lobes, by) in there for name in group.names for loss, by in wanted)

    def _fit(
        self,
        strategy: str,
        model: str,
        lobes: int,
        group: Measured,
        gathered: Gathered,
        progress: Progress,
        total: int,
    ) -> list[FitRecord]:
        """Fits of one model to some materials under every loss, with their errors under all of them."""
        names, losses = list(self.losses), list(self.losses.values())
        start = make_model(model, lobes)
        diffuse = self.diffuse if has_measurable_diffuse(start) else "fit"
        if diffuse != self.diffuse:
            self.folder.log(f"{model}: diffuse fitted with the rest, as it has no albedo to measure at {self.diffuse}")
        results = [
            fit(
                start,
                group,
                loss,
                strategy=self.own_strategies.get(names[k], strategy),
                diffuse=diffuse,
                max_theta=self.max_theta,
                samples=self.samples,
                seed=self.seed,
                progress=part_of(progress, len(self.records) + k * len(group), total),
                gathered=gathered,
            )
            for k, loss in enumerate(losses)
        ]
        cross = cross_score([result.model for result in results], gathered.measured, losses, gathered)
        outliers = local_minima(cross)
        records = []
        for b, result in enumerate(results):
            for m, record in enumerate(result.records()):
                record.model, record.loss = model, names[b]  # as they were asked for
                record.errors = {name: cross[a, b, m].item() for a, name in enumerate(names)}
                record.outlier = bool(outliers[b, m])
                records.append(record)
            self.folder.log(
                f"{result.strategy}: {model}, {lobes} lobes, {names[b]}: {len(result.names)} fits, "
                f"{result.seconds:.1f} s"
            )
        return records


def picture_name(material: str, *parts: str) -> str:
    """The name of a picture, without suffix: of a fit by model and loss, of the material itself without."""
    return "-".join([material, *(parts or (REFERENCE,))])


def _key(record: FitRecord) -> tuple[str, str, str, int, str]:
    return record.material, record.model, record.loss, record.lobes, record.strategy
