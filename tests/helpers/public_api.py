"""What the public API gives, small and whole, as tensors by name: to be had again under any of torch's globals."""

import warnings
from pathlib import Path

import torch
from torch import Tensor

from helpers.directions import hemisphere
from helpers.picture_pairs import NAMES
from torchbrdf import Pairs, fit, load
from torchbrdf.bootstrap import percentile_interval, resample_counts
from torchbrdf.fitting import STRATEGIES, ImageDriven, SlowFitWarning, score
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.lobes import LOBES, make_model, parameters
from torchbrdf.losses import LOSSES, CombinedLoss, FunctionLoss
from torchbrdf.measured import standins
from torchbrdf.perception import JodScores, evaluate_brdfs, gloss_term, score_jod, uniform_pairs
from torchbrdf.perception import score as score_metrics
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.perception.learning.training import Split, splits, train
from torchbrdf.perception.learning.training_set import make_training_set
from torchbrdf.psychophysics import scale
from torchbrdf.psychophysics.comparisons import Comparisons
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, render, sphere

FLOAT = torch.float32


def results(files: list[Path]) -> dict[str, Tensor]:
    """Everything that is tried; files: measured BRDFs of any format."""
    return lobes_and_losses() | differences() | tables(files) | scenes() | fits() | people()


def lobes_and_losses() -> dict[str, Tensor]:
    """Values of every lobe, with the gradient by its parameters, and every loss."""
    pairs = Pairs.from_directions(hemisphere(40, seed=1, dtype=FLOAT), hemisphere(40, seed=2, dtype=FLOAT))
    found = {}
    for name, kind in LOBES.items():
        lobe = kind(dtype=FLOAT)
        found[f"lobe {name}"] = lobe(pairs)
    target = found["lobe ward"] + 0.1
    for name, loss in LOSSES.items():
        found[f"loss {name}"] = loss()(found["lobe cook_torrance"] + 0.2, target, pairs)
    return found


def differences() -> dict[str, Tensor]:
    """Figure and loss of every image difference."""
    found = {}
    picture = torch.linspace(0, 1, 176 * 176 * 3, dtype=FLOAT, device="cpu").reshape(1, 176, 176, 3)
    for name in NAMES:
        difference = DIFFERENCES[name]()
        found[f"difference {name}"] = difference(picture, picture.square())
        found[f"difference {name}, loss"] = difference.loss(picture, picture.square())
    return found | {"tone map": ToneMap.from_images(10 * picture)(picture)}


def tables(files: list[Path]) -> dict[str, Tensor]:
    """Values of measured files, at their own pairs and between them."""
    asked = Pairs.from_directions(hemisphere(50, seed=3, dtype=FLOAT), hemisphere(50, seed=4, dtype=FLOAT))
    found = {}
    for path in [*files, standins()]:
        measured = load(path, dtype=FLOAT)
        some = measured.batch([0], torch.arange(0, len(measured.pairs), len(measured.pairs) // 50, device="cpu"))
        found |= {f"{path.suffix}, values": some.values, f"{path.suffix}, weight": some.weight}
        found |= {f"{path.suffix}, theta_d": some.pairs.theta_d, f"{path.suffix}, between": measured.at(asked)}
        found[f"{path.suffix}, 45:0"] = measured.diffuse_45_0()
    return found


def scenes() -> dict[str, Tensor]:
    """Light, a picture, and a loss and a fit of pictures."""
    light = Environment.from_image(torch.linspace(0, 1, 8 * 16 * 3, dtype=FLOAT, device="cpu").reshape(8, 16, 3), 30)
    scene = Scene(sphere(2), Camera(20.0), light, size=16, nodes=16, light_samples=16)
    found = {"light": light.texels, "lights": light.light_samples(16).flux}
    found["light of a direction"] = light.lookup(
        hemisphere(5, dtype=FLOAT), torch.full((5,), 0.1, dtype=FLOAT, device="cpu")
    )
    model = make_model("ward", 1, dtype=FLOAT)
    found["picture"] = render([model], scene)
    found["transport"] = scene.transport @ torch.ones(1, len(scene.pairs), 3, dtype=FLOAT, device="cpu")
    measured = load(standins(), dtype=FLOAT).batch([6])
    for name in ("delta_e76", "log_hdr", "ssim"):
        loss = RenderedLoss(scene, name)
        problem = loss.problem(measured)
        found[f"rendered {name}"] = loss(1.1 * problem.target, problem.target, problem.pairs)
    found["rendered fit"] = fit(model, measured, RenderedLoss(scene, "log_hdr"), max_iterations=5).error
    both = CombinedLoss(LOSSES["learned"](), RenderedLoss(scene))
    found["combined fit"] = fit(model, measured, both, samples=500, max_iterations=5).error
    chosen = ImageDriven(("compressed", "cube_root"), polish=1)
    found["image-driven fit"] = fit(model, measured, both, strategy=chosen, samples=500, max_iterations=5).error
    return found


def fits() -> dict[str, Tensor]:
    """Fits by each strategy, and under each kind of objective."""
    measured = load(standins(), dtype=FLOAT)
    measured = measured.batch([2, 6], torch.arange(0, len(measured.pairs), 900, device="cpu"))
    found = {}
    models = {name: "distribution_based" if name.startswith("tabulated") else "ward" for name in STRATEGIES}
    tried = [(model, LOSSES["cube_root"](), strategy) for strategy, model in models.items()]
    tried += [("abc", LOSSES["learned"](), "global"), ("shifted_gamma", LOSSES["cosine_rms"](), "staged")]
    tried += [("cook_torrance", FunctionLoss(torch.nn.MSELoss()), "global")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SlowFitWarning)
        for name, loss, strategy in tried:
            model = make_model(name, 1, dtype=FLOAT)
            result = fit(model, measured, loss, strategy=strategy, samples=500, max_iterations=15, diffuse="fit")
            where = f"fit {name} {loss.registered_name} {strategy}"
            found |= {where: result.error, f"{where}, error": score(result.model, measured, [loss])}
            values = torch.cat([value.flatten(1) for value in result.model.parameters()], 1)
            found[f"{where}, parameters"] = values
            assert parameters(result.model, 1)
    return found


def _own(prediction: Tensor, target: Tensor, pairs: Pairs) -> Tensor:
    return ((prediction - target) * pairs.cos_i[:, None]).abs().mean((-2, -1))


def _alone(prediction: Tensor, target: Tensor, pairs: Pairs) -> Tensor:
    return (prediction - target).square().mean()


def people() -> dict[str, Tensor]:
    """A metric learned from answers, a scale from comparisons, and an interval."""
    data = synthetic_benchmark(questions=30)
    training_set = make_training_set(data, evaluate_brdfs(data, uniform_pairs(60)))
    everything = Split("all", torch.ones(len(training_set.names), dtype=torch.bool, device="cpu"))
    training = train(training_set, everything, (0.15, 0.2))
    first = next(splits(training_set, 1, 0))
    wins = torch.tensor([[[[0, 5, 9], [4, 0, 7], [1, 3, 0]]]], dtype=torch.float64, device="cpu")
    scales = scale(Comparisons(["material"], [["a", "b", "c"]], ["observer"], wins))
    drawn = resample_counts(7, 20).double()
    scored = score_metrics(
        {"own": _own, "alone": _alone, "named": "mean_log_difference"}, data, pairs=uniform_pairs(60), replicates=4
    )
    jod = torch.tensor([9, 7, 5], dtype=torch.float64, device="cpu")
    names = [f"nickel_{k}" for k in (1, 2, 3)]
    by_jod = score_jod(JodScores(names, ["nickel"] * 3, names, jod, jod.flip(0)), replicates=4).table
    return {
        "scores": scored.value,
        "intervals": scored.high,
        "ceilings": scored.ceiling,
        "scores by JOD": by_jod.value,
        "gloss": gloss_term(data.measured, uniform_pairs(60)),
        "training": training.mismatch,
        "constants": training.constants,
        "split": first.materials,
        "scale": scales.value,
        "interval": percentile_interval(drawn),
    }
