"""What runs keep in their folders, and what a command line says."""

import dataclasses
import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from fuzzing.changes.byte import TEXT
from fuzzing.changes.of_arrays import NPZ
from fuzzing.changes.of_formats import settings
from fuzzing.changes.of_json import JSON
from fuzzing.readers import Reader
from fuzzing.sane import check_finite, expect, first_line
from torchbrdf import Recipe
from torchbrdf.experiment.benchmark import Benchmark
from torchbrdf.experiment.metric_training import TrainingData, published_data, study_data, train_metric
from torchbrdf.lobes import FitRecord, make_model, parameters, write_fits
from torchbrdf.losses import LearnedLoss, make_loss
from torchbrdf.measured import load, standins
from torchbrdf.perception import uniform_pairs
from torchbrdf.perception.agreement.scores import BenchmarkData
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.recipe import RECIPES, RunFolder, configure, run
from torchbrdf.render import Environment, Scene, parse_light, sphere
from torchbrdf.study import Answer, write_answers

PAIRS = 400


@cache
def _asked() -> BenchmarkData:
    return synthetic_benchmark(questions=60)


@cache
def _training_data() -> TrainingData:
    losses = {"rms": make_loss("rms", "none")}
    return published_data(_asked(), uniform_pairs(PAIRS).to(dtype=torch.float32), losses, (), synthetic=True)


def _train(folder: Path) -> torch.Tensor:
    """The constants that come of answers, in a folder that may have trainings; a metric can be made of them."""
    trained = train_metric(
        _training_data(),
        RunFolder(folder),
        repeats=1,
        replicates=2,
        given={"bins": 0.15, "pointwise": 0.2},
        samples=PAIRS,
        seed=0,
    )
    constants = trained.metric["constants"]
    pairs = uniform_pairs(40)
    values = torch.linspace(0.01, 1, 120, dtype=torch.float64).reshape(1, 40, 3)
    check_finite(LearnedLoss("none", weights={"constants": constants})(values, values.flip(1), pairs), "distance")
    shares = [own["learned"]["share"][0] for results in trained.held_out.values() for own in results.values()]
    return torch.tensor([*constants.values(), *shares]).nan_to_num(-1)  # nan: too few materials


@cache
def _trained() -> torch.Tensor:
    with TemporaryDirectory() as folder:
        return _train(Path(folder))


def make_trainings(folder: Path) -> None:
    _train(folder)


def use_trainings(path: Path) -> None:
    """As a training that is taken up uses it: what comes of it is what came before, whatever is kept."""
    expect(torch.equal(_train(path.parents[1]), _trained()), "another metric")


def _score(folder: Path) -> dict[str, torch.Tensor]:
    benchmark = Benchmark(RunFolder(folder), _asked())
    benchmark.score_values(["rms"], uniform_pairs(PAIRS))
    return {"triplets": benchmark.distances["rms"].triplets, "opinions": benchmark.distances["rms"].opinions}


@cache
def _scored() -> dict[str, torch.Tensor]:
    with TemporaryDirectory() as folder:
        return _score(Path(folder))


def make_distances(folder: Path) -> None:
    _score(folder)


def use_distances(path: Path) -> None:
    """As a benchmark that is taken up uses it: the same distances, whatever is kept."""
    for name, found in _score(path.parents[1]).items():
        same = torch.equal(found.nan_to_num(-1), _scored()[name].nan_to_num(-1))  # nan: nobody was asked
        expect(same, f"other distances for {name}")


def _draw(folder: Path) -> torch.Tensor:
    scene = Scene(sphere(2), environment=_light(), size=8, nodes=8, light_samples=4, cache=folder)
    return scene.transport @ torch.ones(1, len(scene.pairs), 3)


@cache
def _light() -> Environment:
    picture = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0))
    return Environment.from_image(picture)


def make_cache(folder: Path) -> None:
    _draw(folder)
    (found,) = folder.glob("transport-*.npz")
    torch.save(_draw(folder), folder / "picture.pt")
    found.rename(folder / "transport.npz")
    (folder / "name.txt").write_text(found.name)


def use_cache(path: Path) -> None:
    """As a picture uses it: the same picture, whatever is kept."""
    if path.exists() or path.is_symlink():
        path.rename(path.with_name((path.parent / "name.txt").read_text()))
    found, expected = _draw(path.parent), torch.load(path.parent / "picture.pt")
    check_finite(found, "picture")
    expect(torch.allclose(found, expected, rtol=1e-4, atol=1e-6), "another picture")


def make_asked(folder: Path) -> None:
    """A run that observers were asked about: its settings, its fits, and their answers."""
    names = load(standins()).names[:4]
    models = {name: make_model(name, 1) for name in ("ward", "cook_torrance")}
    fits = [
        FitRecord(material, name, 1, parameters(model), loss="rms", strategy="global")
        for material in names
        for name, model in models.items()
    ]
    write_fits(folder / "fuzzed" / "fits.json", fits)
    stored = {"recipe": "fores2012", "settings": {"materials": "stand-ins"}}
    (folder / "fuzzed" / "recipe.json").write_text(json.dumps(stored))
    write_answers(
        folder / "fuzzed" / "answers.csv",
        [Answer("ann", "1", material, "ward-rms", "cook_torrance-rms", "ward-rms") for material in names],
    )


def use_asked(path: Path) -> None:
    """As a training on a study's answers uses it."""
    losses = {"rms": make_loss("rms", "none")}
    run, pairs = path.parent, uniform_pairs(60).to(dtype=torch.float32)
    found = study_data(run, run / "answers.csv", pairs, losses)
    check_finite(found.training_set.terms, "terms")


@dataclasses.dataclass(frozen=True)
class Greeting(Recipe):
    """A recipe that does next to nothing."""

    name = "greeting"
    words: tuple[str, ...] = ("hello", "you")
    factor: float = 0.5

    def steps(self, folder: RunFolder) -> Path:
        (folder.path / "report.txt").write_text(" ".join(self.words))
        return folder.path / "report.txt"


def make_recipe(folder: Path) -> None:
    run(Greeting(), folder / "fuzzed")


def use_recipe(path: Path) -> None:
    """As a run that is taken up uses it."""
    report = run(Greeting(), path.parent)
    expect(report.read_text() == "hello you", "another report")


def make_settings(folder: Path) -> None:
    """Every setting of every recipe with its default; a change keeps one of them."""
    found = [[name, {one.name: _said(one.default) for one in dataclasses.fields(RECIPES[name])}] for name in RECIPES]
    (folder / "fuzzed.json").write_text(json.dumps(found))


def _said(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def use_settings(path: Path) -> None:
    """As a run uses it."""
    for name, given in json.loads(path.read_bytes()):
        made = configure(RECIPES[name], given | {"quick": "true"} if "quick" not in given or len(given) > 1 else given)
        for one in dataclasses.fields(made):
            found = getattr(made, one.name)
            for value in found if isinstance(found, tuple) else (found,):
                if isinstance(value, float):
                    check_finite(torch.tensor(value, dtype=torch.float64), one.name)
                elif isinstance(value, int):
                    expect(-(2**63) <= value < 2**63, f"{one.name} is {str(value)[:40]}")
        torch.Generator().manual_seed(made.seed)
        samples = getattr(made, "samples", 1)
        expect(samples is None or 1 <= samples <= 10**9, "samples out of range")


LIGHTS = ("point:1,2,3:5,5,4", "directional:0,1,0.5:3", "point:0,2,0")


def make_light(folder: Path) -> None:
    (folder / "fuzzed.txt").write_text(LIGHTS[0])


def use_light(path: Path) -> None:
    """As a picture uses it."""
    light = parse_light(first_line(path))
    for found in light.at(torch.tensor([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]))[:2]:
        check_finite(found, "light")
    direction = light.at(torch.tensor([[0.3, -0.2, 0.5]]))[0]
    expect(abs(float(direction.norm()) - 1) < 1e-3, f"a direction of length {float(direction.norm()):g}")


READERS = (
    Reader("trainings", "trainings/all.npz", make_trainings, use_trainings, NPZ, share=0.5),
    Reader("distances", "distances/rms.npz", make_distances, use_distances, NPZ, share=0.5),
    Reader("cache", "transport.npz", make_cache, use_cache, NPZ, named="transport", share=0.5),
    Reader("recipe", "fuzzed/recipe.json", make_recipe, use_recipe, (*JSON, *TEXT), named="fuzzed"),
    Reader("asked", "fuzzed/recipe.json", make_asked, use_asked, (*JSON, *TEXT), named="fuzzed", share=0.5),
    Reader("asked-fits", "fuzzed/fits.json", make_asked, use_asked, (*JSON, *TEXT), named="fuzzed", share=0.5),
    Reader("settings", "fuzzed.json", make_settings, use_settings, (settings,), named=" ", is_file=False, share=2),
    Reader("lights", "fuzzed.txt", make_light, use_light, TEXT, named="light", is_file=False, share=0.5),
)
