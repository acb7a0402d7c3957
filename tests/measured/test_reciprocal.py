"""Both orders of light and viewer, of measurements that are not quite reciprocal."""

import torch
from helpers.painted import Painted
from torch import Tensor

from torchbrdf import Pairs
from torchbrdf.lobes import Lambert
from torchbrdf.measured import Measured
from torchbrdf.measured.format import Lookup
from torchbrdf.render import RenderedLoss, Scene, sphere


class Slanted(Painted):
    """A material that reflects more the higher the light stands, as if it were measured badly."""

    stand_in = False

    def at(self, pairs: Pairs, materials: list[int], interpolation: str) -> Lookup:
        found = super().at(pairs, materials, interpolation)
        return found._replace(values=found.values * (1 + pairs.wi[..., 2:]))


def slanted() -> Measured:
    return Measured(Slanted([Lambert(albedo=0.5)]))


def some_pairs() -> Pairs:
    wi, wo = torch.tensor([[[0.0, 0.0, 1.0]]]), torch.tensor([[[0.6, 0.0, 0.8]]])
    return Pairs.from_directions(wi, wo)


def test_values_are_the_mean_of_both_orders() -> None:
    pairs = some_pairs()
    there, back = (slanted().at(one) for one in (pairs, Pairs.from_directions(pairs.wo, pairs.wi)))
    assert not torch.allclose(there, back)
    torch.testing.assert_close(slanted().reciprocal_at(pairs), (there + back) / 2)
    tame = Measured(Painted([Lambert(albedo=0.5)]))
    torch.testing.assert_close(tame.reciprocal_at(pairs), tame.at(pairs))


def test_pictures_as_a_loss_see_that_mean() -> None:
    loss = RenderedLoss(Scene(sphere(2), size=8, nodes=8, light_samples=16))
    problem = loss.problem(slanted())
    pairs: Pairs = problem.pairs
    upright: Tensor = (pairs.wi[..., 2:] + pairs.wo[..., 2:]) / 2
    expected = 0.5 / torch.pi * (1 + upright)
    shown = pairs.above_horizon[0]
    torch.testing.assert_close(problem.target[:, shown], expected.expand(-1, -1, 3)[:, shown])
