"""What a GPU would show, without one: nothing in a step moves to another device or waits for a number.

Tensors on torch's device "meta" have shapes and no values: whatever mixes them with the CPU's, or asks for a value, for
which a GPU would have to stop, raises.
"""

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from torchbrdf.fitting.objective import GaussNewtonObjective, make_objective
from torchbrdf.fitting.objective.base import BoundObjective, FitObjective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.lobes import LOBES, Lobe, make_model
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import LOSSES, Problem, make_loss
from torchbrdf.measured.merl import bin_centers
from torchbrdf.pairs import Pairs
from torchbrdf.render import Scene, sphere

META = torch.device("meta")
# Its series is as long as the roughest material needs, which is a number that is asked for.
ASKS = {"he"}
every_lobe = pytest.mark.parametrize("name", [name for name in LOBES if name not in ASKS])
every_loss = pytest.mark.parametrize("loss", list(LOSSES))
# What makes a GPU's program wait for a value.
WAITS = {"_local_scalar_dense", "equal", "nonzero", "unique_consecutive", "_unique2", "is_nonzero"}


def model_of(name: str) -> Lobe:
    kind = LOBES[name]
    if kind.is_material:
        return make_model(name)
    return make_model(f"{name}+ggx") if kind.is_diffuse else make_model(name, 2)


def some_pairs() -> Pairs:
    """Pairs of 40 half angles each, of MERL's."""
    pairs = bin_centers()
    inside = ((pairs.cos_i > 0.2) & (pairs.cos_o > 0.2))[0].nonzero()[:, 0]
    return pairs.select(samples=inside[torch.arange(0, len(inside), 301, dtype=torch.int64)]).to(dtype=torch.float32)


def bound_on(name: str, loss: str, device: torch.device) -> tuple[BoundObjective, Tensor, Tensor]:
    """An objective of two materials, where it is, and both."""
    model, pairs = model_of(name).batched(2).to(device), some_pairs().to(device)
    values = get_parameters(model)
    free = Parametrization(model, free_parameters(model, range(len(model.components()))))
    target = torch.full((2, len(pairs), 3), 0.3, dtype=torch.float32, device=device)
    objective = make_objective(model, Problem(pairs, target), make_loss(loss))
    assert isinstance(objective, GaussNewtonObjective)
    every = torch.arange(2, dtype=torch.int64, device=device)
    return objective.bind(free, values), free.encode(values), every


@every_lobe
def test_lobes_stay_where_they_are(name: str) -> None:
    pairs = some_pairs()
    turned = Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d, 3 * pairs.phi_d)
    found = model_of(name).to(META)(turned.to(META))
    assert found.device == META and found.dtype == torch.float32


@every_loss
def test_losses_stay_where_values_are(loss: str) -> None:
    pairs = some_pairs().to(META)
    values = torch.empty(2, len(pairs), 3, dtype=torch.float32, device=META)
    assert make_loss(loss).to(META)(values, values, pairs).device == META


@pytest.mark.parametrize("loss", [name for name, kind in LOSSES.items() if kind.objective in ("pointwise", "binned")])
@pytest.mark.parametrize("name", ["ggx", "gltf", "oren_nayar"])
def test_steps_stay_where_the_problem_is(name: str, loss: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Which materials are meant is asked once a step, beside what a solver asks to know whether to go on.
    monkeypatch.setattr(FitObjective, "is_every_material", lambda *_: True)
    bound, x, rows = bound_on(name, loss, META)
    assert {one.device for one in bound.quadratic_model(x, rows)} == {META}


@every_loss
def test_steps_by_half_angles_wait_for_hardly_anything(loss: str) -> None:
    class Waits(TorchDispatchMode):
        def __init__(self) -> None:
            super().__init__()
            self.found: list[str] = []

        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            name = func.overloadpacket.__name__
            if name in WAITS:
                self.found.append(name)
            return func(*args, **(kwargs or {}))

    bound, x, rows = bound_on("cook_torrance", loss, torch.device("cpu"))
    bound.quadratic_model(x, rows)  # once makes what all steps share
    with Waits() as waits:
        bound.quadratic_model(x, rows)
    assert waits.found in ([], ["equal"])


def test_pictures_stay_where_the_values_are() -> None:
    scene = Scene(sphere(2), size=8, nodes=16, light_samples=64)
    values = torch.rand(1, len(scene.pairs), 3, dtype=torch.float32)
    assert (scene.transport @ values).device == values.device
