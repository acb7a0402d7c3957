"""The learned metric in fits."""

import pytest
import torch
from helpers.known_models import Made

from torchbrdf import fit
from torchbrdf.lobes import Lambert, Sum, Ward, make_model
from torchbrdf.losses import LOSSES, LearnedLoss
from torchbrdf.measured import load, standins
from torchbrdf.measured.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.perception import uniform_pairs


def test_a_fit_finds_what_values_were_made_with() -> None:
    """Global, by Gauss-Newton, in one batch with a material that has holes."""
    model = make_model("ward", lobes=1)
    pairs = uniform_pairs(3000, seed=7)
    truth = Sum(
        Lambert(albedo=torch.tensor([[0.2, 0.3, 0.4], [0.5, 0.1, 0.1]]), dtype=torch.float64),
        Ward(
            specular=torch.tensor([[0.1, 0.2, 0.3], [0.3, 0.3, 0.3]]),
            roughness=torch.tensor([[0.08], [0.3]]),
            dtype=torch.float64,
        ),
    )
    with torch.no_grad():
        values = truth(Pairs.from_half_diff(pairs.theta_h[None], pairs.theta_d[None], pairs.phi_d[None])).clone()
    values[1, ::7] = torch.nan
    lead = Pairs.from_half_diff(pairs.theta_h[None], pairs.theta_d[None], pairs.phi_d[None])
    result = fit(model, Measured.from_samples(lead, values), LearnedLoss(), diffuse="fit", samples=None)
    assert [str(status) for status in result.status] == ["converged", "converged"]
    assert result.loss == "learned" and float(result.error.max()) < 1e-3
    for one, other in zip(result.model.parameters(), truth.parameters(), strict=True):
        torch.testing.assert_close(one, other.expand_as(one), rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_a_fit_is_better_under_it_than_another_losses_fit() -> None:
    measured = load(standins()).batch([0, 1]).within(80.0)
    loss = LearnedLoss()
    own, other = (fit(make_model("ward", lobes=2), measured, x, samples=4000) for x in (loss, LOSSES["cube_root"]()))
    score, whole = LearnedLoss(reduction="none"), loss.problem(measured)
    with torch.no_grad():
        mine, theirs = (
            score(result.model(whole.pairs), whole.target, whole.pairs, whole.weight) for result in (own, other)
        )
    torch.testing.assert_close(mine.double(), own.error, rtol=1e-3, atol=0)
    assert bool((mine < theirs).all())


class OnBins(Made):
    """A model in the place of a table."""

    on_merl_bins = True


def test_a_fit_finds_a_lobe_that_few_pairs_see() -> None:
    """Of a roughness of .003, on a table's bins: they are dense where theta_h is small."""
    table = load(standins()).batch([6]).pairs
    truth = Sum(Lambert(albedo=[0.02, 0.02, 0.02]), Ward(specular=[0.3, 0.25, 0.2], roughness=0.003)).double()
    measured = Measured(OnBins(truth, table.select(samples=torch.arange(0, len(table), 5)).to(dtype=torch.float64)))
    result = fit(make_model("ward", lobes=1), measured, LearnedLoss(), diffuse="fit", samples=4000)
    assert result.model.components()[1].roughness.item() == pytest.approx(0.003, rel=0.02)
    assert float(result.error) < 0.01
