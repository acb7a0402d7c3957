"""What observers are asked: the pictures of a run, the experiments with them, and the words around. `study.json`."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError, UsageError
from torchbrdf.files import write_json
from torchbrdf.registry import unknown

PLAN = "study.json"
MEASURED = "measured"
"""The stimulus that is the measured material itself."""

# Shown to observers; a plan may say any of them otherwise. Paragraphs are parted by an empty line.
TEXTS = {
    "title": "Which one looks closer?",
    "consent": (
        "You will compare pictures of the same object, made of different materials.\n\n"
        "Recorded are your choices and how long each took, what your screen is like (size, pixels, shades that you can "
        "tell apart) and what you say of your eyes and your room. Your name is not asked for. You may stop at any time."
    ),
    "instructions": (
        "At the top you see a reference. Below are two approximations. Choose the one whose material looks closer to "
        "that of the reference. The reference is seen from a slightly different side, so compare the material, not "
        "the outline.\n\n"
        "Click the picture, or press the left or right arrow key. There is no time limit, but do not ponder long. "
        "Space pauses. You can close the window and come back with your own link."
    ),
    "pause": "Paused. Take your time.",
    "thanks": "That was all. Thank you!",
    "screened": "Thank you for your interest. This study needs other conditions, so there is nothing more to do.",
}


@dataclass(frozen=True)
class Stimulus:
    """Stimulus of a study: a picture that can be chosen.

    Args:
        picture: The file.
        model: The lobe that it shows.
        loss: The loss that it was fitted under.
        outlier: Whether the fit failed.
        difference: Its image difference from the reference, if known.
    """

    picture: str
    model: str | None = None
    loss: str | None = None
    outlier: bool = False
    difference: float | None = None


@dataclass(frozen=True)
class Material:
    """Material of a study: the picture that is the reference, and its stimuli.

    Args:
        name: Of the material.
        reference: The file of the reference.
        stimuli: By name.
        order: Materials are drawn by rising `order`, such as the distinctness of image in degrees.
    """

    name: str
    reference: str
    stimuli: Mapping[str, Stimulus]
    order: float = 0.0


@dataclass(frozen=True)
class Experiment:
    """Experiment of a study: which stimuli of each material are compared.

    Args:
        name: Of the experiment.
        title: Shown in reports.
        stimuli: Names of stimuli, two or more.
        pairs: Those pairs of names only; None: all.
        compare: Every observer compares each stimulus with only so many others, other ones for every observer (for
            many stimuli).
        repeats: So many trials come a second time, sides changed.
        catch: So many trials show the measured material itself beside the picture that differs most.

    Raises:
        UsageError: The settings do not fit together.
    """

    name: str
    title: str
    stimuli: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...] | None = None
    compare: int | None = None
    repeats: int = 0
    catch: int = 0

    def __post_init__(self) -> None:
        where = f"experiment {self.name!r}"
        if len(set(self.stimuli)) != len(self.stimuli) or len(self.stimuli) < 2:
            raise UsageError(f"{where}: stimuli: expected two or more, each once, found {', '.join(self.stimuli)}")
        for pair in self.pairs or ():
            if len(set(pair)) != 2 or not set(pair) <= set(self.stimuli):
                raise UsageError(f"{where}: pairs: expected two of its stimuli, found {' and '.join(pair)}")
        if self.compare is not None and not 2 <= self.compare < len(self.stimuli):
            most = len(self.stimuli) - 1
            raise UsageError(f"{where}: compare: expected 2 to {most} of {most + 1} stimuli, found {self.compare}")
        if self.compare is not None and self.pairs is not None:
            raise UsageError(f"{where}: expected pairs or compare, found both")
        for name in ("repeats", "catch"):
            if getattr(self, name) < 0:
                raise UsageError(f"{where}: {name}: expected 0 or more, found {getattr(self, name)}")


@dataclass(frozen=True)
class Plan:
    """Plan of a study: materials, experiments, the words shown, and who may take part.

    Pictures are named relative to the folder that the plan is in.

    Args:
        materials: With their pictures.
        experiments: With names of stimuli that all materials have.
        seed: Of the order of trials.
        texts: Words shown to observers in place of those in `TEXTS`.
        screening: Self-reports and the answers that make eligible, such as {"colour_vision": ("normal",)}; others are
            thanked and not asked anything.
        mark: What has to be said wherever answers are shown, such as that the materials are no measurements.

    Raises:
        UsageError: Names are not unique or not known.
    """

    materials: tuple[Material, ...]
    experiments: tuple[Experiment, ...]
    seed: int = 0
    texts: Mapping[str, str] = field(default_factory=dict)
    screening: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mark: str = ""

    def __post_init__(self) -> None:
        for key in self.texts:
            if key not in TEXTS:
                raise unknown("text of a study", key, TEXTS)
        materials = [material.name for material in self.materials]
        experiments = [experiment.name for experiment in self.experiments]
        for kind, names in (("material", materials), ("experiment", experiments)):
            if not names or len(set(names)) != len(names):
                raise UsageError(f"study: expected {kind}s, each once, found {', '.join(names) or 'none'}")
        for name in (
            *materials,
            *experiments,
            *(stimulus for material in self.materials for stimulus in material.stimuli),
        ):
            if not name.isprintable():  # answers have a line each
                raise UsageError(f"study: expected names of one line, found {name!r}")
        for experiment in self.experiments:
            self._check(experiment)

    def _check(self, experiment: Experiment) -> None:
        for material in self.materials:
            for name in experiment.stimuli:
                if name not in material.stimuli:
                    raise unknown(f"stimulus of {material.name}", name, material.stimuli)
            if experiment.catch and catch_pair(material, experiment) is None:
                raise UsageError(
                    f"experiment {experiment.name!r}: catch trials: expected {MEASURED} among the stimuli of "
                    f"{material.name}, and a stimulus with a known difference"
                )

    def experiment(self, name: str) -> Experiment:
        """An experiment by its name."""
        for experiment in self.experiments:
            if experiment.name == name:
                return experiment
        raise unknown("experiment", name, [experiment.name for experiment in self.experiments])

    def material(self, name: str) -> Material:
        """A material by its name."""
        for material in self.materials:
            if material.name == name:
                return material
        raise unknown("material", name, [material.name for material in self.materials])

    def text(self, key: str) -> str:
        """A text to show to observers, the plan's or the default."""
        return self.texts.get(key, TEXTS[key])

    def save(self, folder: Path | str) -> Path:
        """Write the plan as `study.json` into a folder; gives its path."""
        path = Path(folder) / PLAN
        write_json(path, asdict(self))
        return path

    @classmethod
    def load(cls, folder: Path | str) -> "Plan":
        """Read the plan in a folder.

        Raises:
            DataError: Says what is not as expected, or which picture is missing.
        """
        path = Path(folder) / PLAN
        try:
            plan = cls._from(json.loads(path.read_text(encoding="utf-8")))
        except OSError as error:
            hint = "; run a recipe such as fores2012 first" if isinstance(error, FileNotFoundError) else ""
            raise DataError(f"{path}: cannot be read ({error.strerror}){hint}") from None
        except UsageError as error:
            raise DataError(f"{path}: {error}") from None
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise DataError(f"{path}: expected the plan of a study ({type(error).__name__}: {error})") from None
        for material in plan.materials:
            pictures = [stimulus.picture for stimulus in material.stimuli.values()]
            for picture in (material.reference, *pictures):
                inside(Path(folder), picture, path)
        return plan

    @classmethod
    def _from(cls, record: dict[str, Any]) -> "Plan":
        materials = tuple(
            Material(**{**one, "stimuli": {name: Stimulus(**what) for name, what in one["stimuli"].items()}})
            for one in record.pop("materials")
        )
        experiments = tuple(
            Experiment(
                **{
                    **one,
                    "stimuli": tuple(one["stimuli"]),
                    "pairs": None if one.get("pairs") is None else tuple((a, b) for a, b in one["pairs"]),
                }
            )
            for one in record.pop("experiments")
        )
        screening = {key: tuple(values) for key, values in record.pop("screening", {}).items()}
        return cls(materials, experiments, screening=screening, **record)


def inside(folder: Path, picture: str, where: Path) -> Path:
    """Path of a picture in a folder; a DataError if it is not there, or leads out of it."""
    path = (folder / picture).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise DataError(f"{where}: expected pictures in {folder}, found {picture}")
    if not path.is_file():
        raise DataError(f"{where}: {picture}: no such picture")
    return path


def catch_pair(material: Material, experiment: Experiment) -> tuple[str, str] | None:
    """Pair of a catch trial: the measured material, which is right, and what differs most; None if unknown."""
    known = {
        name: material.stimuli[name].difference or 0.0
        for name in experiment.stimuli
        if name != MEASURED and material.stimuli[name].difference is not None
    }
    if MEASURED not in material.stimuli or not known:
        return None
    return MEASURED, max(known, key=lambda name: known[name])
