"""What observers are asked: the pictures of a run, the experiments with them, and the words around. `study.json`."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.files import write_json
from torchbrdf.names import check_name, is_one_line
from torchbrdf.reading import exists, read_json, reading
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

SELF_REPORTS: Mapping[str, tuple[str, ...]] = {
    "colour_vision": ("normal", "deficient", "not sure"),
    "acuity": ("yes", "no"),
    "room": ("dark", "dim", "bright"),
}
"""What observers are asked of themselves, with the answers to choose from; a plan may screen by them."""

# Trials of one observer: at two seconds each, a week without sleep. All pairs of 447 stimuli are as many.
MOST_TRIALS = 100_000
# The seeds of observers, made of it, are kept as text.
LARGEST_SEED = 10**32
# Of differences and places in an order; beyond, it is no such thing.
LARGEST_NUMBER = 1e12


@dataclass(frozen=True)
class Stimulus:
    """Stimulus of a study: a picture that can be chosen.

    Args:
        picture: The file.
        model: The lobe that it shows.
        loss: The loss that it was fitted under.
        outlier: Whether the fit failed.
        difference: Its image difference from the reference, if known.

    Raises:
        UsageError: The picture is no path of one line, or the difference no number that can be.
    """

    picture: str
    model: str | None = None
    loss: str | None = None
    outlier: bool = False
    difference: float | None = None

    def __post_init__(self) -> None:
        _check_line("picture", self.picture)
        for name in ("model", "loss"):
            if getattr(self, name) is not None:
                _check_line(name, getattr(self, name))
        if self.difference is not None:
            _check_number("difference", self.difference)


@dataclass(frozen=True)
class Material:
    """Material of a study: the picture that is the reference, and its stimuli.

    Args:
        name: Of the material.
        reference: The file of the reference.
        stimuli: By name.
        order: Materials are drawn by rising `order`, such as the distinctness of image in degrees.

    Raises:
        DataError: The name or that of a stimulus is none.
        UsageError: The reference is no path of one line, or the order no number that can be.
    """

    name: str
    reference: str
    stimuli: Mapping[str, Stimulus]
    order: float = 0.0

    def __post_init__(self) -> None:
        check_name(self.name, "material")
        for name in self.stimuli:
            check_name(name, f"stimulus of {self.name}")
        _check_line("reference", self.reference)
        _check_number("order", self.order)


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
        check_name(self.name, "experiment")
        where, known = f"experiment {self.name!r}", set(self.stimuli)
        if self.title:
            _check_line(f"{where}: title", self.title)
        if len(known) != len(self.stimuli) or len(self.stimuli) < 2:
            found = shown(", ".join(self.stimuli))
            raise UsageError(f"{where}: stimuli: expected two or more, each once, found {found}")
        for pair in self.pairs or ():
            if len(set(pair)) != 2 or not set(pair) <= known:
                raise UsageError(f"{where}: pairs: expected two of its stimuli, found {' and '.join(pair)}")
        if self.compare is not None and not 2 <= self.compare < len(self.stimuli):
            most = len(self.stimuli) - 1
            found = shown(self.compare, 20)
            raise UsageError(f"{where}: compare: expected 2 to {most} of {most + 1} stimuli, found {found}")
        if self.compare is not None and self.pairs is not None:
            raise UsageError(f"{where}: expected pairs or compare, found both")
        for name in ("repeats", "catch"):
            if not 0 <= getattr(self, name) <= MOST_TRIALS:
                raise UsageError(
                    f"{where}: {name}: expected 0 to {MOST_TRIALS}, found {shown(getattr(self, name), 20)}"
                )

    @property
    def pair_count(self) -> int:
        """How many pairs of a material an observer compares."""
        if self.pairs is not None:
            return len(self.pairs)
        count = len(self.stimuli)
        return (count * (count - 1 if self.compare is None else self.compare) + 1) // 2


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
        if not abs(self.seed) <= LARGEST_SEED:
            raise UsageError(f"study: seed: expected at most {LARGEST_SEED:.0e}, found {shown(self.seed, 20)}")
        if self.mark:
            _check_line("mark", self.mark)
        materials = [material.name for material in self.materials]
        experiments = [experiment.name for experiment in self.experiments]
        for kind, names in (("material", materials), ("experiment", experiments)):
            if not names or len(set(names)) != len(names):
                raise UsageError(f"study: expected {kind}s, each once, found {shown(', '.join(names)) or 'none'}")
        for experiment in self.experiments:
            self._check(experiment)

    def _check(self, experiment: Experiment) -> None:
        trials = len(self.materials) * experiment.pair_count + experiment.repeats + experiment.catch
        if trials > MOST_TRIALS:
            raise UsageError(
                f"experiment {experiment.name!r}: expected at most {MOST_TRIALS} trials an observer, found {trials}: "
                f"{experiment.pair_count} pairs of {len(self.materials)} materials; `compare` takes fewer pairs"
            )
        for material in self.materials:
            for name in experiment.stimuli:
                if name not in material.stimuli:
                    raise unknown(f"stimulus of {material.name}", name, material.stimuli)
            if experiment.catch and catch_pair(material, experiment) is None:
                raise UsageError(
                    f"experiment {experiment.name!r}: catch trials: expected {MEASURED} among the stimuli of "
                    f"{material.name}, and a stimulus with a known difference"
                )

    def check_texts(self) -> None:
        """Refuse words that cannot be shown: a UsageError."""
        for key, text in self.texts.items():
            for line in text.replace("\r\n", "\n").split("\n"):
                if not is_one_line(line.replace("\t", " ")):
                    raise UsageError(f"text {key!r}: expected printable lines, found {shown(line)}")

    def check_screening(self) -> None:
        """Refuse a screening that would let nobody in: a UsageError."""
        for key, allowed in self.screening.items():
            if key not in SELF_REPORTS:
                raise unknown("self-report to screen by", key, SELF_REPORTS)
            for choice in allowed:
                if choice not in SELF_REPORTS[key]:
                    raise unknown(f"answer to {key}", choice, SELF_REPORTS[key])

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
        if not exists(path):
            raise DataError(f"{path}: cannot be read (no such file); run a recipe such as fores2012 first")
        record: dict[str, Any] = read_json(path, dict[str, Any], EXPECTED)
        try:
            with reading(path, EXPECTED):
                plan = _plan_of(record)
                plan.check_texts()
                plan.check_screening()
        except UsageError as error:
            raise DataError(f"{path}: {error}") from None
        for material in plan.materials:
            pictures = [stimulus.picture for stimulus in material.stimuli.values()]
            for picture in (material.reference, *pictures):
                inside(Path(folder), picture, path)
        return plan


EXPECTED = "the plan of a study"


def _plan_of(record: dict[str, Any]) -> Plan:
    """The plan that a record is; a misspelt key would be a setting that is silently not there."""
    import msgspec  # late, as in `reading`

    _check_keys(record, Plan, "a plan")
    for name, kind in (("materials", Material), ("experiments", Experiment)):
        for k, one in enumerate(_entries(record.get(name))):
            _check_keys(one, kind, f"{name}[{k}]")
            stimuli = one.get("stimuli")
            if kind is Material and isinstance(stimuli, dict):
                for key, what in stimuli.items():
                    if isinstance(what, dict):
                        _check_keys(what, Stimulus, f"{name}[{k}].stimuli[{shown(key, 30)}]")
    try:
        return msgspec.convert(record, Plan)
    except msgspec.ValidationError as error:
        reason = str(error)
        raise UsageError(f"{EXPECTED}: {reason[:1].lower()}{reason[1:]}") from None


def _entries(value: Any) -> list[dict[str, Any]]:
    return [one for one in value if isinstance(one, dict)] if isinstance(value, list) else []


def _check_keys(record: Mapping[str, Any], kind: type, where: str) -> None:
    known = [one.name for one in fields(kind)]
    for key in record:
        if key not in known:
            raise unknown(f"key of {where}", key, known)


def _check_line(what: str, text: str) -> None:
    if not is_one_line(text):
        raise UsageError(f"{what}: expected one printable line, found {shown(text)}")


def _check_number(what: str, value: float) -> None:
    if not (math.isfinite(value) and abs(value) <= LARGEST_NUMBER):
        raise UsageError(f"{what}: expected a number up to {LARGEST_NUMBER:g}, found {value}")


def inside(folder: Path, picture: str, where: Path) -> Path:
    """Path of a picture in a folder; a DataError if it is not there, or leads out of it."""
    with reading(where, f"a picture's path in {folder}"):
        path = (folder / picture).resolve()
        if not path.is_relative_to(folder.resolve()):
            raise DataError(f"{where}: expected pictures in {folder}, found {shown(picture)}")
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
