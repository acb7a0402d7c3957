"""Parameters of models as dictionaries, over every registered lobe."""

import pytest
import torch

from torchbrdf.lobes import LOBES, Lambert, Sum, Ward
from torchbrdf.lobes.parameter_dict import get_parameters, named_specs, take_materials, with_parameters
from torchbrdf.pairs import Pairs

every_lobe = pytest.mark.parametrize("name", LOBES)


@every_lobe
def test_parameters_of_some_materials_give_their_values(name: str) -> None:
    model = Sum(Lambert(dtype=torch.float64), LOBES[name](dtype=torch.float64)).batched(3)
    with torch.no_grad():
        for value in model.parameters():
            value.mul_(torch.tensor([0.5, 0.7, 0.9]).double().reshape(3, *[1] * (value.dim() - 1)))
    values = get_parameters(model)
    angle = torch.linspace(0.1, 0.7, 5, dtype=torch.float64)[None]
    pairs = Pairs.from_half_diff(angle, angle, 2 * angle, 3 * angle)
    assert list(values) == list(named_specs(model)) == [name for name, _ in model.named_parameters()]
    assert not any(value.requires_grad for value in values.values())
    before = model(pairs).detach().clone()
    other = with_parameters(model, take_materials(values, [2, 0]))
    torch.testing.assert_close(other(pairs), before[[2, 0]], rtol=0, atol=0)
    with torch.no_grad():
        for value in other.parameters():
            value.mul_(0.5)
    torch.testing.assert_close(model(pairs), before, rtol=0, atol=0)


@every_lobe
def test_specs_are_those_of_the_components(name: str) -> None:
    specs = named_specs(Sum(LOBES[name](), Ward()))
    assert specs["lobes.1.roughness"] is Ward.parameter_specs["roughness"]
    for key, spec in LOBES[name].parameter_specs.items():
        assert specs[f"lobes.0.{key}"] is spec


def test_one_number_serves_all_channels() -> None:
    gray = with_parameters(Ward().batched(2), {"specular": torch.tensor([[0.2], [0.3]]), "roughness": torch.ones(2, 1)})
    assert gray.specular.tolist() == torch.tensor([[0.2] * 3, [0.3] * 3]).tolist()
