"""Fits of tabulated lobes."""

import math

import pytest
import torch

from torchbrdf import Pairs, fit
from torchbrdf.errors import UsageError
from torchbrdf.fitting import Status, TabulatedFit
from torchbrdf.fitting.tabulated_picture import PictureProblem
from torchbrdf.fitting.tabulated_problem import TabulatedProblem
from torchbrdf.fitting.tabulated_variables import Falling, decoded, encoded
from torchbrdf.lobes import DistributionBased, Lambert, Sum, Ward, from_parameters, make_model, model_of, read_fits
from torchbrdf.lobes.parameter_dict import get_parameters, with_parameters
from torchbrdf.losses import CombinedLoss, CompressedLoss, CubeRootLoss, LogLoss, Problem, RMSLoss
from torchbrdf.measured import Measured, load, standins
from torchbrdf.render import RenderedLoss, Scene, sphere

NODES = ((torch.arange(90, dtype=torch.float64) + 0.5) / 90).square() * (math.pi / 2)
COLOUR = torch.tensor([1.0, 0.8, 0.5], dtype=torch.float64)


def some_pairs(count, seed=0, materials=1):
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(3, materials, 3 * count, generator=generator, dtype=torch.float64)
    scale = torch.tensor([1.0, 1.0, 2.0], dtype=torch.float64)[:, None, None] * (math.pi / 2)
    theta_h, theta_d, phi_d = torch.stack([random[0].square(), random[1], random[2]]) * scale
    pairs = Pairs.from_half_diff(theta_h, theta_d, phi_d)
    low = torch.minimum(pairs.cos_i, pairs.cos_o) > 0.2
    keep = torch.stack([row.nonzero()[:count, 0] for row in low])
    names = ("theta_h", "theta_d", "phi_d", "cos_i", "cos_o", "cos_h", "cos_d", "tan2_h")
    return Pairs(**{name: getattr(pairs, name).gather(1, keep) for name in names})


def surface(width=0.2, rise=3.0, bump=0.0):
    """Lambert and a tabulated lobe with a Gaussian of this width, whose F rises; bump: at 40 degrees."""
    shape = torch.exp(-((NODES / width) ** 2)) + 0.01 + bump * torch.exp(-(((NODES - 0.7) / 0.1) ** 2))
    factor = 1 + rise * torch.linspace(0, 1, 16, dtype=torch.float64).square()
    lobe = DistributionBased(
        distribution=shape[:, None] * COLOUR, f0=0.3, fresnel_table=factor[:, None].expand(-1, 3), dtype=torch.float64
    )
    return Sum(Lambert(albedo=[0.3, 0.2, 0.1], dtype=torch.float64), lobe)


def measured_from(*surfaces, count=6000, weight=None, own=False):
    pairs = some_pairs(count, materials=len(surfaces) if own else 1)
    values = [one(pairs.select(materials=slice(k, k + 1)))[0] for k, one in enumerate(surfaces)]
    return Measured.from_samples(pairs, torch.stack(values).detach(), weight)


@pytest.mark.parametrize("loss", [CompressedLoss(), LogLoss(), CubeRootLoss()])
def test_tables_are_found_again(loss):
    truth, other = surface(), surface(0.4, 1.0)
    measured = measured_from(truth, other)
    result = fit(make_model("distribution_based", 1), measured, loss, samples=4000, max_theta=90)
    assert result.status == [Status.CONVERGED] * 2 and result.diffuse == "fit"
    nothing = loss.error(torch.zeros_like(measured.values), measured.values, measured.pairs)
    assert (result.error < 0.01 * nothing).all()
    found = result.model.components()[1]
    wanted = truth.components()[1].distribution[5:60]
    torch.testing.assert_close(found.distribution[0, 5:60], wanted, rtol=0.05, atol=0.005)
    assert (found.f0 == make_model("distribution_based", 1).components()[1].f0.double()).all()


def test_materials_with_pairs_and_weights_of_their_own():
    weight = torch.ones(2, 3000, 1, dtype=torch.float64)
    weight[1, ::7] = 0
    measured = measured_from(surface(), surface(0.3), count=3000, weight=weight, own=True)
    result = fit(make_model("distribution_based", 1), measured, CompressedLoss(), samples=None, max_theta=90)
    alone = fit(
        make_model("distribution_based", 1),
        Measured.from_samples(measured.pairs.select(materials=[1]), measured.values[1:], weight[1:]),
        CompressedLoss(),
        samples=None,
        max_theta=90,
    )
    assert result.status == [Status.CONVERGED] * 2
    assert (result.error < 0.01).all()
    torch.testing.assert_close(result.error[1:], alone.error, rtol=1e-6, atol=0)


def problem_of(loss, diffuse, own=False):
    model = Sum(*([Lambert()] * diffuse), DistributionBased(), DistributionBased(f0=0.1)).batched(2).double()
    measured = measured_from(surface(), surface(0.4), count=500, own=own)
    weight = torch.rand(measured.weight.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    given = Problem(measured.pairs, measured.values, weight)
    values = get_parameters(model)
    return model, values, TabulatedProblem(model, values, given, loss, fit_diffuse=True, smooth=1e-3)


@pytest.mark.parametrize("loss", [CompressedLoss(), RMSLoss(), LogLoss()])
@pytest.mark.parametrize("diffuse", [True, False])
@pytest.mark.parametrize("own", [True, False])
def test_values_are_the_losses_and_slopes_are_theirs(loss, diffuse, own):
    model, values, problem = problem_of(loss, diffuse, own)
    x = encoded(problem, values)
    noise = torch.randn(x.shape, dtype=x.dtype, generator=torch.Generator().manual_seed(0))
    x = x + 0.1 * noise.abs()
    rows = torch.arange(len(x))
    value, gradient, matrix = problem.quadratic_model(x, rows)
    fitted = with_parameters(model, decoded(problem, x, values))
    given = problem.problem
    expected = loss.error(fitted(given.pairs), given.target, given.pairs, given.weight)
    torch.testing.assert_close(problem.error(x), expected)
    step = 1e-6 * noise
    ahead, behind = (problem.quadratic_model(x + sign * step, rows)[0] for sign in (1, -1))
    torch.testing.assert_close((ahead - behind) / 2, (gradient * step).sum(1), rtol=1e-5, atol=1e-13)
    some = torch.tensor([4, 1])
    for part, whole in zip(problem.quadratic_model(x[some], some), (value, gradient, matrix), strict=True):
        torch.testing.assert_close(part, whole[some])
    assert (torch.linalg.eigvalsh(matrix) > -1e-9 * matrix.abs().amax()).all()


def test_the_matrix_is_that_of_gauss_and_newton():
    """Of squares the sum of products of derivatives, here by a graph through the lobes."""
    model, values, problem = problem_of(RMSLoss(), True)
    x = encoded(problem, values)[3:]
    given = problem.problem

    def red(point):
        own = {name: value[1:] for name, value in values.items()}
        full = torch.cat([x[:0], point[None], x[1:]])
        made = decoded(problem, full, own)
        return torch.func.functional_call(model, made, (given.pairs,))[0, :, 0]

    jacobian = torch.autograd.functional.jacobian(red, x[0])
    weight = given.weight[1]
    expected = 2 * jacobian.mT @ (weight * jacobian) / problem.norm[3]
    _, _, matrix = problem.quadratic_model(x[:1], torch.tensor([3]))
    torch.testing.assert_close(matrix[0], expected + 2 * problem.penalties, rtol=1e-8, atol=1e-12)


def test_monotone_and_smooth_on_request():
    measured = measured_from(surface(bump=0.3))
    model = make_model("distribution_based", 1)
    free, falling, smooth = (
        fit(model, measured, CompressedLoss(), strategy=strategy, samples=None, max_theta=90)
        for strategy in ("tabulated", TabulatedFit(monotone=True), TabulatedFit(smooth=1e-2))
    )
    tables = [one.model.components()[1].distribution[0].log() for one in (free, falling, smooth)]
    assert tables[0].diff(dim=0).max() > 0.01
    assert tables[1].diff(dim=0).max() <= 1e-9
    rough = [table.diff(n=2, dim=0).square().sum() for table in tables]
    assert rough[2] < 0.5 * rough[0]
    assert free.error < falling.error and free.error < smooth.error
    assert falling.strategy == "tabulated_monotone" and smooth.strategy == "TabulatedFit(smooth=0.01)"


def test_falling_variables_come_back():
    _, values, problem = problem_of(CompressedLoss(), True)
    falling = Falling(problem)
    x = encoded(problem, values)
    x[:, 1:91] = x[:, 1:91].sort(1, descending=True).values
    x[:, 107:197] = x[:, 107:197].sort(1, descending=True).values
    torch.testing.assert_close(falling.decode(falling.encode(x)), x)


def test_files_keep_tables_and_old_ones_lack_those_of_f(tmp_path):
    result = fit(make_model("distribution_based"), measured_from(surface()), CompressedLoss(), max_theta=90)
    result.save(tmp_path / "fits.json")
    (record,) = read_fits(tmp_path / "fits.json")
    assert (record.model, record.lobes, record.strategy) == ("distribution_based", 2, "global")
    pairs = some_pairs(50, 3)
    torch.testing.assert_close(model_of([record], torch.float64)(pairs), result.model(pairs))
    old = {"diffuse": [0.1] * 3, "distribution": [[[2.0] * 3] * 90], "f0": [0.2]}
    lobe = from_parameters("distribution_based", old).components()[1]
    assert (lobe.fresnel_table == 1).all() and lobe.fresnel_table.shape == (16, 3)


def test_a_black_channel_and_a_held_albedo():
    black = surface()
    black.components()[0].albedo = [0.3, 0.2, 0.0]
    black.components()[1].distribution = black.components()[1].distribution.detach() * torch.tensor([1.0, 1.0, 0.0])
    result = fit(make_model("distribution_based", 1), measured_from(black), CompressedLoss(), max_theta=90)
    assert result.status == [Status.CONVERGED]
    pairs = some_pairs(50, 3)
    assert result.model(pairs)[..., 2].max() < 1e-4
    start = Sum(Lambert(albedo=0.25), DistributionBased())
    held = fit(start, measured_from(surface()), CompressedLoss(), strategy="staged", diffuse="fit", max_iterations=2)
    assert held.error.isfinite().all()


def test_what_it_refuses():
    with pytest.raises(UsageError, match=r"smooth: expected a finite number from 0 on, found -1"):
        TabulatedFit(smooth=-1)
    with pytest.raises(UsageError, match="expected distribution_based lobes beside Lambert's term, found Lambert"):
        fit(Sum(Lambert(), Ward()), measured_from(surface()), RMSLoss(), strategy="tabulated", diffuse="fit")


def test_bad_materials_leave_the_others_be():
    """All invalid, all zero, constant, almost nothing valid."""
    pairs = some_pairs(1000)
    good = surface()(pairs).detach()
    few = good.clone()
    few[:, 5:] = torch.nan
    values = torch.cat([good, good * torch.nan, 0 * good, 0 * good + 0.1, few])
    measured = Measured.from_samples(pairs, values)
    model = make_model("distribution_based", 1)
    result = fit(model, measured, CompressedLoss(), samples=None, max_theta=90)
    expected = [Status.CONVERGED, Status.NO_DATA, Status.CONVERGED, Status.CONVERGED, Status.TOO_FEW_SAMPLES]
    assert result.status == expected
    alone = fit(model, measured.batch([0]), CompressedLoss(), samples=None, max_theta=90)
    torch.testing.assert_close(result.error[:1], alone.error, rtol=1e-6, atol=0)
    assert fit(model, measured, CompressedLoss(), max_theta=1e-3).status == [Status.NO_DATA] * 5


def seen_by_a_picture(loss, count=400):
    """A small measured surface that has values everywhere, and the problem of a metric and a picture of it."""
    measured = load(standins()).batch([6]).to(dtype=torch.float64)
    measured = measured.batch(samples=torch.arange(0, 900_000, 900_000 // count))
    picture = RenderedLoss(Scene(sphere(2), size=8, nodes=8, light_samples=8))
    return measured, CombinedLoss(loss, picture, 1 / 50)


@pytest.mark.parametrize("loss", [CompressedLoss(), LogLoss()])
def test_a_picture_beside_a_metric_has_the_slope_that_it_says(loss):
    measured, both = seen_by_a_picture(loss)
    model = make_model("distribution_based", 2).batched(1).double()
    values, parts = get_parameters(model), both.parts(both.problem(measured))
    metric = TabulatedProblem(model, values, parts.measured, loss, fit_diffuse=True, smooth=1e-6)
    problem = PictureProblem(metric, parts.seen, both)
    x = encoded(metric, values).unflatten(0, (-1, 3)).flatten(1)
    value, gradient, matrix = problem.quadratic_model(x, torch.arange(1))
    assert matrix.shape == (1, 3 * metric.size, 3 * metric.size) and torch.allclose(matrix, matrix.mT)
    assert torch.linalg.eigvalsh((matrix + matrix.mT) / 2).min() > -1e-6 * matrix.abs().max()
    # What is added for smooth tables is little; the rest is the loss.
    found = with_parameters(model, decoded(metric, x.unflatten(1, (3, -1)).flatten(0, 1), values))
    error = both.error(found(both.problem(measured).pairs), both.problem(measured).target, both.problem(measured).pairs)
    assert value * problem.scale == pytest.approx(error.item(), rel=1e-3)
    step = torch.randn(1, x.shape[1], dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 1e-4
    ahead, behind = (problem.quadratic_model(x + sign * step, torch.arange(1))[0] for sign in (1, -1))
    assert (gradient * step).sum().item() == pytest.approx((ahead - behind).item() / 2, rel=1e-2)


def test_a_picture_beside_a_metric_is_come_nearer():
    measured, both = seen_by_a_picture(CompressedLoss(), count=3000)
    one, other = (fit(make_model("distribution_based", 1), measured, loss, samples=None) for loss in (both.loss, both))
    assert other.loss == "compressed+rendered_delta_e76" and other.status[0] in (
        Status.CONVERGED,
        Status.MAX_ITERATIONS,
    )
    problem = both.problem(measured.within(80))
    before, after = (both.error(own.model(problem.pairs), problem.target, problem.pairs) for own in (one, other))
    assert after < 0.9 * before
    assert other.error.item() == pytest.approx(after.item(), rel=1e-4)
