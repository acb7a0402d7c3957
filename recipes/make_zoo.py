"""How the zoo was made: matches of measured materials by models that renderers have."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchbrdf.errors import TorchbrdfError
from torchbrdf.experiment.matching.candidates import Budget, Candidate
from torchbrdf.experiment.rounding import rounded
from torchbrdf.experiment.settings import STANDINS, load_materials
from torchbrdf.files import write_text
from torchbrdf.recipe import RECIPES, Recipe, RunFolder

if TYPE_CHECKING:
    from torchbrdf.experiment.matching.search import Match
    from torchbrdf.lobes import FitRecord

MODELS = (Candidate("ggx", 2), Candidate("gltf"), Candidate("openpbr"))


@dataclass(frozen=True)
class Origin:
    """Where materials are from, what that is called, and what their names begin with."""

    setting: str
    said: str
    prefix: str = ""


# The few first: a run that is stopped has them.
ORIGINS = (
    Origin("rgl", "RGL's measurement, Dupuy and Jakob 2018"),
    Origin("standins", "a stand-in that comes with torchbrdf", "standin-"),
    Origin("tables", "a table in MERL's format"),
)


@RECIPES.register("make_zoo")
@dataclass(frozen=True)
class MakeZoo(Recipe):
    """Match measured materials by two GGX lobes, glTF's material and OpenPBR's, and write them as one fits.json."""

    name = "make_zoo"

    tables: str = field(default="", metadata={"help": "a folder of MERL-format tables; none: left out"})
    rgl: str = field(default="", metadata={"help": "a folder of RGL's measurements; none: left out"})
    standins: str = field(default=STANDINS, metadata={"help": "the bundled stand-ins; none: left out"})
    said: str = field(default="", metadata={"help": "what the tables are, if not known"})
    metric: str | None = field(default=None, metadata={"help": "a loss of BRDF values to fit under, beside pictures"})
    size: int = field(
        default=24, metadata={"help": "pixels of a side of pictures that fits see", "low": 16, "high": 256}
    )
    views: int = field(default=1, metadata={"help": "how many pictures fits see", "low": 1, "high": 3})
    digits: int = field(default=4, metadata={"help": "significant digits kept", "low": 2, "high": 17})

    def steps(self, folder: RunFolder) -> Path:
        """Match every material by every model, and keep of each model the nearest fit."""
        from torchbrdf.experiment.matching.search import find_matches

        models = MODELS[:2] if self.quick else MODELS
        size, views, metric = (16, 1, None) if self.quick else (self.size, self.views, self.metric)
        budget = Budget("zoo", models, metric, size=size, views=views, all_of_them=True)
        records: list[FitRecord] = []
        for origin in ORIGINS:
            place = getattr(self, origin.setting)
            if not place or place == "none":
                continue
            groups, _ = load_materials(place, folder, self.quick)
            bad: list[TorchbrdfError] = []
            found = find_matches(
                groups, "mitsuba", budget, out=folder.path / origin.setting, cache=folder.path / "cache",
                progress=folder.progress(origin.setting), bad=bad,
            )  # fmt: skip
            for error in bad:
                folder.warn(str(error))
            for match in found:
                records += self._kept(match, origin)
        path = folder.path / "zoo.json"
        # A record a line: a third of what `write_fits` takes, and still to be read.
        lines = [json.dumps(record.to_json(), separators=(",", ":"), allow_nan=False) for record in records]
        write_text(path, "[\n{}\n]\n".format(",\n".join(lines)))
        return path

    def _kept(self, match: "Match", origin: Origin) -> "list[FitRecord]":
        """Of each model the nearest fit, with its figures, and without what only a fit has."""
        from torchbrdf.lobes import FitRecord

        nearest: dict[Candidate, Any] = {}
        for one in match.tried:
            if one.candidate not in nearest or one.means.mean < nearest[one.candidate].means.mean:
                nearest[one.candidate] = one
        source = self.said if self.said and origin.setting == "tables" else origin.said
        return [
            FitRecord(
                origin.prefix + match.material,
                one.record.model,
                one.record.lobes,
                rounded(one.record.parameters, self.digits),
                loss=one.record.loss,
                pictures={scene: rounded(dict(own.differences), self.digits) for scene, own in one.figures.items()},
                extra={"source": source},
            )
            for one in nearest.values()
        ]
