"""The global strategy: seeds, the best of many starts, bad input, whole databases, work in processes."""

import json
import math

import pytest
import torch
from helpers.known_models import (
    COLORED,
    ISOTROPIC,
    SHAPES,
    Made,
    assert_within_bounds,
    measured_from,
    some_pairs,
    two_lobes,
)

from torchbrdf.errors import DataError, ShapeError
from torchbrdf.fitting import Batches, GlobalSearch, Status, fit, score, stratified
from torchbrdf.fitting.batching import material_batches
from torchbrdf.fitting.initialization import from_unit, most_shape_parameters, starts_from_dictionary
from torchbrdf.fitting.objective import make_objective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.fitting.quasi_random import quasi_random_starts
from torchbrdf.fitting.task import levenberg_marquardt_fit
from torchbrdf.lobes import (
    LOBES,
    DistributionBased,
    FitRecord,
    Lambert,
    Sum,
    Ward,
    make_model,
    parameters,
    read_fits,
    write_fits,
)
from torchbrdf.lobes.parameter_dict import get_parameters, take_materials
from torchbrdf.losses import LOSSES, CosineRMSLoss, CubeRootLoss, Problem, RMSLoss
from torchbrdf.measured import Measured, load, standins
from torchbrdf.pairs import Pairs
from torchbrdf.render import RenderedLoss, Scene, sphere

LOSS_NAMES = list(LOSSES)
# Every lobe with some loss, every loss with some lobe.
COMBINED = [(lobe, LOSS_NAMES[k % len(LOSS_NAMES)]) for k, lobe in enumerate(COLORED)]
COMBINED += [("ward", name) for name in LOSS_NAMES if name not in dict(COMBINED).values()]


@pytest.mark.parametrize(("name", "loss_name"), COMBINED)
def test_it_finds_what_a_model_was_made_from(name, loss_name):
    model, loss = two_lobes(name, 2), LOSSES[loss_name]()
    measured = Measured(Made(model, some_pairs(1000)), dtype=torch.float64)
    result = fit(make_model(name, 2), measured, loss, diffuse="fit", samples=None)
    zero_prediction_error = loss.error(torch.zeros_like(measured.values), measured.values, measured.pairs)
    assert (result.error < 0.01 * zero_prediction_error).all()
    assert result.status == [Status.CONVERGED] * 2
    starts, best = (stage.name for stage in result.history)
    count = 7 if most_shape_parameters(make_model(name, 2)) < 2 else 19  # a coarse grid has random ones beside it
    count += sum(spec.affine for spec in LOBES[name].scalars()) == 1  # one has two lobes of one shape that differ in F0
    assert starts.startswith(f"{count} starts, ") and best.startswith("best 3, ")


@pytest.mark.parametrize(
    ("name", "loss"),
    [
        ("ward", RMSLoss()),
        ("ward", CosineRMSLoss()),
        ("cook_torrance", CosineRMSLoss()),
        ("abc", RMSLoss()),
        pytest.param("ashikhmin_shirley", CubeRootLoss(), marks=pytest.mark.slow),
        pytest.param("ward", CubeRootLoss(), marks=pytest.mark.slow),
    ],
)
def test_it_is_never_worse_than_the_staged_procedure(name, loss):
    """On materials that the model cannot be: those of another one, with noise."""
    other = two_lobes("cook_torrance" if name == "ward" else "ward", 3)
    measured = Measured(Made(other, some_pairs()), dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    measured.source.values *= (1 + 0.1 * torch.randn(measured.values.shape, generator=generator)).clamp_min(0.1)
    staged, best = (fit(make_model(name, 2), measured, loss, strategy=s, samples=1000) for s in ("staged", "global"))
    assert (best.error <= staged.error * 1.0005).all()
    assert "all " in best.history[-1].name
    assert_within_bounds(best.model)


@pytest.mark.parametrize("lobes", [1, 2, 3])
@pytest.mark.parametrize("name", SHAPES)
def test_starts_are_near_the_truth(name, lobes):
    """The best start, without any descent, explains most of a material; each start has its own shapes."""
    pairs = some_pairs(1500)
    truth = two_lobes(name, 2)
    values = truth(pairs).detach()
    model = make_model(name, lobes, torch.float64).batched(2)
    objective = make_objective(model, Problem(pairs, values), CosineRMSLoss())
    start = get_parameters(model) | {"lobes.0.albedo": truth.components()[0].albedo.detach()}
    found = starts_from_dictionary(model, objective, start, False, 4)
    shapes = torch.cat([found[f"lobes.{k}.{SHAPES[name][0]}"] for k in range(1, lobes + 1)], 1).reshape(-1, 2, lobes)
    for material in range(2):
        assert len(torch.unique(shapes[:, material], dim=0)) == len(shapes) >= 4
    best = Parametrization(model, []).predict(take_materials(found, slice(2)), pairs)  # the best start of each
    error = CosineRMSLoss("none")(best, values, pairs)
    zero_prediction_error = CosineRMSLoss("none")(torch.zeros_like(values), values, pairs)
    assert (error < (0.7 if lobes == 1 else 0.35) * zero_prediction_error).all()
    for one in free_parameters(model, range(lobes + 1)):
        value = found[one.name]
        assert value.shape[0] == 2 * len(shapes) and (value >= one.spec.lower).all() and (value <= one.spec.upper).all()


@pytest.mark.parametrize(
    ("model", "lobes", "material", "least"),
    [
        ("lafortune", 2, "blue-acrylic", 0.2096),
        ("gltf", 1, "gold-metallic-paint2", 0.1516),
        ("principled", 1, "gold-metallic-paint2", 0.2059),
    ],
)
def test_minima_are_found_whose_starts_are_slow_at_first(model, lobes, material, least):
    """The least errors of 32 random starts: few steps, or a coarse grid alone, end 2 to 3 % above them."""
    measured = load(standins(), dtype=torch.float64).within(80.0)
    measured = measured.batch([measured.names.index(material)], samples=stratified(len(measured.pairs), 600, 0))
    found = fit(make_model(model, lobes), measured, LOSSES["compressed"](), diffuse="fit", samples=None)
    assert found.error.item() <= 1.005 * least


def test_channels_start_alike():
    """One at random seldom suits all three where channels have shapes of their own."""
    model = make_model("shifted_gamma", 1).batched(2)
    free = Parametrization(model, free_parameters(model, [0, 1]))
    found = quasi_random_starts(free, get_parameters(model), 8)
    for one in free.free:
        value = found[one.name]
        assert value.shape == (16, 3) and (value == value[:, :1]).all()
        assert len(value[:, 0].unique()) == 8


@pytest.mark.parametrize("name", ISOTROPIC)
def test_random_starts_find_nothing_better(name):
    """One lobe of every registered kind, on materials that none can be."""
    measured, loss = load(standins(), dtype=torch.float64).batch([4, 6]).within(80.0), CosineRMSLoss()
    measured = measured.batch(samples=stratified(len(measured.pairs), 1000, 0))
    best = fit(make_model(name, 1), measured, loss, diffuse="fit", samples=None).error
    model = make_model(name, 1, torch.float64).batched(2)
    objective, free = (
        make_objective(model, loss.problem(measured), loss),
        Parametrization(model, free_parameters(model, [0, 1])),
    )
    low, high = free.limits()
    generator = torch.Generator().manual_seed(0)
    x = low + (high - low) * torch.rand(24, len(low), generator=generator, dtype=torch.float64)
    materials = torch.arange(24) % 2
    start = take_materials(get_parameters(model), materials) | free.decode(x, torch.float64)
    _, found = levenberg_marquardt_fit(objective, start, free, max_iterations=200, materials=materials)
    assert (best[materials] <= found.value * 1.002).all()


@pytest.mark.parametrize("name", ISOTROPIC)  # on the middle of the grid the others are isotropic, however they lie
def test_starts_are_exact_where_a_shape_is_on_the_grid(name):
    """Of every registered lobe, with a colour anywhere within its bounds."""
    pairs, kind, model = some_pairs(1000), LOBES[name], make_model(name, 1, torch.float64).batched(1)
    lobe = model.components()[1]
    for spec in kind.scalars():
        size = max(2, round(16 ** (1 / sum(not one.affine for one in kind.scalars()))))
        place = torch.tensor([[0.3 if spec.affine else (size // 2 + 0.5) / size]], dtype=torch.float64)
        getattr(lobe, spec.name).data = from_unit(spec, place)
    color = kind.albedo_spec()
    getattr(lobe, color.name).data = color.upper * torch.tensor([[0.3, 0.5, 0.7]], dtype=torch.float64)
    values, loss = model(pairs).detach(), RMSLoss()
    start, objective = (
        get_parameters(make_model(name, 1).batched(1)),
        make_objective(model, Problem(pairs, values), loss),
    )
    found = starts_from_dictionary(model, objective, start, True, 1)
    for key in kind.parameter_specs:
        expected = getattr(lobe, key).detach().float()
        torch.testing.assert_close(found[f"lobes.1.{key}"], expected, rtol=1e-3, atol=0)


def test_options_of_the_search():
    """Fewer starts on fewer samples: said in the stages, and in the record, as another strategy than the registered."""
    quick = GlobalSearch(starts=2, kept=1, coarse_samples=500)
    result = fit(make_model("ward", 1), measured_from(two_lobes("ward")), RMSLoss(), strategy=quick, samples=None)
    assert [stage.name for stage in result.history] == ["3 starts, 500 samples", "best 1, 2395 samples"]
    assert result.starts == 3 and result.strategy.startswith("GlobalSearch(starts=2, shapes=16")
    measured = measured_from(two_lobes("ward"), some_pairs(300))
    same = fit(make_model("ward", 1), measured, RMSLoss(), strategy=GlobalSearch(), samples=None)
    assert same.strategy == "global"


def test_a_model_without_a_diffuse_lobe():
    truth = Sum(Ward(specular=0.3, roughness=0.04), Ward(specular=0.2, roughness=0.3)).double()
    for diffuse in ("fit", "45:0"):
        result = fit(Sum(Ward(), Ward()), measured_from(truth), CosineRMSLoss(), diffuse=diffuse, samples=None)
        assert result.status == [Status.CONVERGED] and result.error.item() < 1e-4


def test_lobes_of_different_kinds():
    truth = Sum(Lambert(albedo=0.2), Ward(specular=0.3, roughness=0.04), LOBES["ashikhmin_shirley"](exponent=10.0))
    measured = measured_from(truth.double())
    start = Sum(Lambert(), Ward(), LOBES["ashikhmin_shirley"]())
    result = fit(start, measured, CosineRMSLoss(), diffuse="fit", samples=None)
    assert result.status == [Status.CONVERGED]
    assert result.error.item() < 1e-3 * measured.values.square().mean().sqrt()


def test_materials_with_pairs_of_their_own():
    """As RGL's, and with weights."""
    model = two_lobes("ward", 2)
    several = [some_pairs(1200, seed).select(samples=slice(0, 900)) for seed in (0, 1)]
    pairs = Pairs.from_directions(*(torch.cat([getattr(own, key) for own in several]) for key in ("wi", "wo")))
    weight = torch.ones(2, 900, 1, dtype=torch.float64)
    weight[1, ::7] = 0
    measured = Measured.from_samples(pairs, model(pairs).detach(), weight)
    result = fit(make_model("ward", 2), measured, RMSLoss(), diffuse="fit", samples=None)
    assert result.status == [Status.CONVERGED] * 2
    assert (result.error < 1e-3 * measured.values.square().mean((1, 2)).sqrt()).all()


@pytest.mark.slow
def test_a_model_that_needs_a_graph_gets_a_joint_polish():
    truth = Sum(Lambert(albedo=0.2), Ward(specular=0.3, roughness=0.2)).double()
    start = Sum(Lambert(), DistributionBased(), Ward())
    results = [fit(start, measured_from(truth), CosineRMSLoss(), strategy=s, samples=400, max_iterations=30)
               for s in ("staged", "global")]  # fmt: skip
    assert results[1].history[-1].name == "all parameters, all samples"
    assert results[1].error.item() <= results[0].error.item() * 1.01


def test_parameters_at_bounds_and_near_ties_are_reported():
    truth = Sum(Lambert(albedo=0.2), Ward(specular=3.0, roughness=0.1)).double()
    (record,) = fit(make_model("ward", 1), measured_from(truth), RMSLoss(), samples=None).records()
    assert record.at_bounds == ["specular[0] = 1"]
    assert record.starts == 7 and record.ties >= 0 and record.reason == ""


def bad_materials():
    """Seven materials: fine, partly NaN and negative, all zero, constant, all invalid, almost nothing, fine again."""
    pairs = some_pairs(1000)
    values = two_lobes("ward", 1)(pairs).detach().repeat(7, 1, 1)
    values[1, ::5], values[1, 1::5] = math.nan, -1.0
    values[2], values[3], values[4] = 0, 0.1, math.nan
    values[5, 2:] = math.nan
    return Measured.from_samples(pairs, values)


@pytest.mark.parametrize("strategy", ["staged", "global"])
@pytest.mark.parametrize("loss", [RMSLoss(), CubeRootLoss()])
def test_bad_materials_say_so_and_leave_the_others_be(strategy, loss):
    measured = bad_materials()
    options = {"strategy": strategy, "diffuse": "fit", "samples": None, "max_theta": 90.0}
    result = fit(make_model("ward", 2), measured, loss, **options)
    assert result.status[4] == Status.NO_DATA and "no valid sample" in result.reason[4]
    assert result.status[5] == Status.TOO_FEW_SAMPLES and "6 valid values for 11 parameters" in result.reason[5]
    assert result.error[[0, 1, 2, 3, 6]].isfinite().all() and result.error[2].item() < 1e-6
    alone = fit(make_model("ward", 2), measured.batch([0]), loss, **options)
    # The staged procedure stops at kinks of a cube root, at others with each size of a batch, as rounding has it.
    rtol = 1e-6 if strategy == "global" else 2e-3
    for k in (0, 6) if strategy == "global" or isinstance(loss, RMSLoss) else ():
        torch.testing.assert_close(result.error[k], alone.error[0], rtol=rtol, atol=1e-12)
    for status, reason in zip(result.status, result.reason, strict=True):
        assert (status == Status.CONVERGED) == (reason == "")


def test_a_start_outside_its_bounds():
    measured = measured_from(two_lobes("ward"), materials=3)
    model = make_model("ward", 2, torch.float64).batched(3)
    model.components()[1].roughness.data[1] = 7.0
    result = fit(model, measured, RMSLoss(), samples=300)
    assert result.status[1] == Status.BAD_START and "Ward.roughness: expected 0.001 to 0.5, found 7" in result.reason[1]
    assert result.status[0] == result.status[2] == Status.CONVERGED
    model.components()[1].roughness.data[:] = 7.0
    with pytest.raises(ShapeError, match="found 7"):
        fit(model, measured, RMSLoss(), samples=300)


def test_the_subset_is_a_fair_sample_of_the_whole():
    """Both errors are those of the final parameters, and agree as a sample of that size can."""
    measured = measured_from(two_lobes("cook_torrance"), some_pairs(60_000))
    result = fit(make_model("ward", 2), measured, CubeRootLoss(), samples=3000)
    assert result.error.item() == pytest.approx(score(result.model, measured.within(80.0), [CubeRootLoss()]).item())
    assert result.subset_error.item() == pytest.approx(result.error.item(), rel=0.05)
    assert result.subset_error.item() != result.error.item()
    assert len(result.history) == 4  # with a share of all between


# --- a whole database ---------------------------------------------------------------------------------------------


def test_batches_are_taken_up_where_they_stopped(tmp_path):
    measured = measured_from(two_lobes("ward", 5), some_pairs(600), materials=5)
    options = {"strategy": "global", "samples": 300, "max_theta": 80.0, "diffuse": "45:0", "seed": 0}

    def stop(done, total):
        if done > torch.get_num_threads():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Batches(make_model("ward", 1), RMSLoss(), out=tmp_path, **options).run([measured], stop)
    first = read_fits(tmp_path)
    assert 0 < len(first) < 5
    counted = []
    again = Batches(make_model("ward", 1), RMSLoss(), out=tmp_path, **options).run(
        [measured], lambda done, total: counted.append(done)
    )
    assert counted[0] == len(first) and counted[-1] == 5
    assert [record.material for record in again] == measured.names
    assert again[: len(first)] == first
    assert len(json.loads((tmp_path / "fits.json").read_text())) == 5
    for change in ({"seed": 1}, {"samples": 200}, {"strategy": "staged"}):
        with pytest.raises(DataError, match=f"{next(iter(change))}.*give another folder"):
            Batches(make_model("ward", 1), RMSLoss(), out=tmp_path, **{**options, **change})
    with pytest.raises(DataError, match="loss"):
        Batches(make_model("ward", 1), CubeRootLoss(), out=tmp_path, **options)


def test_fits_of_before_are_known_by_the_names_that_losses_had(tmp_path):
    measured = measured_from(two_lobes("ward"), some_pairs(300))
    made = Batches(make_model("ward", 1), CosineRMSLoss(), out=tmp_path, samples=None).run([measured])
    path = tmp_path / "fits.json"
    path.write_text(path.read_text().replace('"cosine_rms"', '"cosine"'))
    assert read_fits(path)[0].loss == "cosine" and made[0].loss == "cosine_rms"
    assert Batches(make_model("ward", 1), CosineRMSLoss(), out=tmp_path, samples=None).done.keys() == {
        measured.names[0]
    }


def test_fits_of_before_are_known_by_the_names_that_image_differences_had(tmp_path):
    loss = RenderedLoss(Scene(sphere(2), size=8, nodes=8, light_samples=4), "delta_e")
    settings = {"strategy": "staged", "diffuse": "fit", "samples": None}
    values = parameters(make_model("ward", 1))
    record = FitRecord("paint", "ward", 1, values, loss="rendered_delta_e", scene=loss.scene_summary, **settings)
    write_fits(tmp_path / "fits.json", [record])
    assert Batches(make_model("ward", 1), loss, out=tmp_path, **settings).done.keys() == {"paint"}


# --- processes ----------------------------------------------------------------------------------------------------


def test_processes_find_what_threads_find(two_threads, monkeypatch):
    measured = measured_from(two_lobes("ward", 4), some_pairs(600), materials=4)
    results = []
    for heavy in (10**9, 0):
        monkeypatch.setattr("torchbrdf.fitting.batching.PROCESS_THRESHOLD", heavy)
        results.append(fit(make_model("ward", 2), measured, RMSLoss(), samples=300))
    for one, other in zip(results[0].model.parameters(), results[1].model.parameters(), strict=True):
        assert torch.equal(one, other)
    assert torch.equal(results[0].error, results[1].error)


# --- devices ------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@pytest.mark.parametrize("strategy", ["staged", "global"])
def test_a_gpu_finds_what_the_cpu_finds(strategy):
    measured = measured_from(two_lobes("cook_torrance", 3), some_pairs(2000), materials=3)
    options = {"strategy": strategy, "samples": 500}
    here, there = (fit(make_model("ward", 2), m, CubeRootLoss(), **options) for m in (measured, measured.to("cuda")))
    torch.testing.assert_close(there.error, here.error, rtol=1e-3, atol=0)


def test_a_large_batch_is_cut_for_the_cache_and_for_memory():
    measured = measured_from(two_lobes("ward"), some_pairs(1000), materials=9)
    found = list(material_batches(measured, len(measured.pairs)))
    assert [k for group in found for k in group] == list(range(9))
    assert max(map(len, found)) <= -(-9 // torch.get_num_threads())
