"""What every registered lobe keeps to. A new lobe gets all of these by being registered."""

import copy
import inspect
import math
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.lobes import LOBES, BoundedParameter, Lambert, Lobe, Sum, Ward, model_name
from torchbrdf.pairs import Pairs

CHECKOUT = Path(__file__).resolve().parents[2]
DTYPES = [torch.float32, torch.float64]
# How many combinations of parameters at their bounds a test goes through at most.
CORNERS = 2048
every_lobe = pytest.mark.parametrize("name", LOBES)


def middle(spec: BoundedParameter) -> float:
    """A value well inside the bounds, where nothing is negligible."""
    if spec.log:
        return math.sqrt(spec.lower * spec.upper)
    return (spec.lower + min(spec.upper, 1.0)) / 2


def values(name: str, *lead: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> dict[str, Tensor]:
    """Different parameters of the shape (*lead, k), within a factor of 2 of the middle."""
    generator = torch.Generator().manual_seed(seed)

    def around(spec: BoundedParameter) -> Tensor:
        factor = 2 ** (torch.rand(*lead, *spec.shape, generator=generator, dtype=torch.float64) - 0.5)
        return (middle(spec) * factor).to(dtype)

    return {key: around(spec) for key, spec in LOBES[name].parameter_specs.items()}


def made(name: str, *lead: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Lobe:
    return LOBES[name](**values(name, *lead, seed=seed, dtype=dtype))


def some_pairs(*shape: int, dtype: torch.dtype = torch.float64) -> Pairs:
    """Directions above the horizon, within reach of the mirror direction, so that sharp lobes are not 0."""
    wi = hemisphere(*shape, seed=1)
    mirror = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    near = mirror + 0.1 * hemisphere(*shape, seed=2)
    return Pairs.from_directions(wi.to(dtype), (near / near.norm(dim=-1, keepdim=True)).to(dtype))


def extreme_pairs(dtype: torch.dtype) -> Pairs:
    """Every combination of heights down to grazing, with the azimuths of mirror, retro and sideways reflection."""
    cos = torch.tensor([1.0, 0.5, 1e-3, 1e-6, 1e-12, 1e-30], dtype=dtype)
    turn = torch.tensor([0, 1e-3, math.pi / 2, math.pi - 1e-3, math.pi], dtype=dtype)
    cos_i, cos_o, phi = torch.cartesian_prod(cos, cos, turn).unbind(-1)
    sin_i, sin_o = (1 - cos_i**2).sqrt(), (1 - cos_o**2).sqrt()
    wi = torch.stack([sin_i, torch.zeros_like(sin_i), cos_i], -1)
    side = torch.where(phi == math.pi, 0.0, phi.sin())  # so that the mirror direction is exactly that
    return Pairs.from_directions(wi, torch.stack([sin_o * phi.cos(), sin_o * side, cos_o], -1))


@every_lobe
def test_function_and_module_agree(name: str) -> None:
    parameters, pairs = values(name), some_pairs(20)
    lobe = LOBES[name](**parameters)
    torch.testing.assert_close(lobe(pairs), LOBES[name].function(pairs, *parameters.values()), rtol=0, atol=0)
    torch.testing.assert_close(lobe(pairs), LOBES[name].function(pairs, **parameters), rtol=0, atol=0)


@every_lobe
@pytest.mark.parametrize(("lead", "shape"), [((), (2, 3, 7)), ((3,), (7,)), ((1,), (3, 7)), ((2, 3), (1, 7))])
def test_any_leading_dimensions(name: str, lead: tuple[int, ...], shape: tuple[int, ...]) -> None:
    """Parameters (..., k) and pairs (..., N) broadcast, as computed one by one."""
    parameters, pairs = values(name, *lead), some_pairs(*shape)
    result = LOBES[name].function(pairs, *parameters.values())
    full = torch.broadcast_shapes(lead, shape[:-1])
    assert result.shape == (*full, 7, 3)
    wi, wo = pairs.wi.expand(*full, 7, 3), pairs.wo.expand(*full, 7, 3)
    declared = LOBES[name].parameter_specs
    spread = {key: value.expand(*full, *declared[key].shape) for key, value in parameters.items()}
    for index in np.ndindex(*full):
        one = [value[index] for value in spread.values()]
        expected = LOBES[name].function(Pairs.from_directions(wi[index], wo[index]), *one)
        torch.testing.assert_close(result[index], expected, rtol=1e-12, atol=0)


@every_lobe
def test_dtype_follows_the_inputs(name: str) -> None:
    for dtype in DTYPES:
        assert made(name, dtype=dtype)(some_pairs(4, dtype=dtype)).dtype == dtype
        assert all(value.dtype == dtype for value in LOBES[name](dtype=dtype).parameters())


@every_lobe
def test_zero_below_the_horizon(name: str) -> None:
    """Exactly 0, with gradients that are numbers: also where the half vector is on the horizon or there is none."""
    dtype = torch.float32  # where overflow is nearer
    down = torch.tensor([1.0, 1.0, -1.0], dtype=dtype)
    wi, wo = hemisphere(50, seed=5, dtype=dtype), hemisphere(50, seed=6, dtype=dtype)
    on_horizon = torch.tensor([[1.0, 0.0, 0.0]], dtype=dtype).expand(50, 3)
    for pair in [
        (wi, wo * down),
        (wi * down, wo),
        (wi * down, wo * down),
        (wi, wi * down),
        (wi, -wi),
        (on_horizon, wo),
    ]:
        lobe = made(name, dtype=dtype)
        result = lobe(Pairs.from_directions(*pair))
        assert (result == 0).all()
        result.sum().backward()
        for value in lobe.parameters():
            assert (value.grad == 0).all()


@every_lobe
def test_finite_everywhere(name: str) -> None:
    """Values and gradients at grazing directions and at every corner of the bounds, or at many of them."""
    dtype = torch.float32  # where overflow is nearer
    pairs, declared = extreme_pairs(dtype), LOBES[name].parameter_specs
    choices = torch.tensor([[b.lower, b.start, middle(b), b.upper] for b in declared.values()], dtype=dtype)
    if 4 ** len(declared) <= CORNERS:
        corners = torch.cartesian_prod(*choices).reshape(-1, len(declared))
    else:  # too many for all of them
        generator = torch.Generator().manual_seed(0)
        drawn = torch.randint(4, (CORNERS, len(declared)), generator=generator)
        corners = torch.cat([choices.T, choices.T[drawn, torch.arange(len(declared))]])
    parameters = [
        corners[:, k].reshape(-1, *[1] * len(spec.shape)).expand(-1, *spec.shape).clone().requires_grad_()
        for k, spec in enumerate(declared.values())
    ]
    result = LOBES[name].function(pairs, *parameters)
    assert result.isfinite().all()
    assert (result >= 0).all()
    # Values reach 1e26 at grazing directions; compressed, the others have a say as well.
    for total in (result.sum(), torch.log1p(result).sum()):
        for key, gradient in zip(declared, torch.autograd.grad(total, parameters, retain_graph=True), strict=True):
            assert gradient.isfinite().all(), key


@every_lobe
def test_float32_keeps_the_digits(name: str) -> None:
    """Against float64 on the same float32 directions, with the sharpest lobes of the bounds."""
    pairs = some_pairs(2000, dtype=torch.float32)
    wi = pairs.wi
    near = wi * torch.tensor([-1.0, -1.0, 1.0]) + 1e-3 * hemisphere(2000, seed=8, dtype=torch.float32)
    sharp = Pairs.from_directions(wi, near / near.norm(dim=-1, keepdim=True))
    for bound in ("lower", "start", "upper"):
        lobe = LOBES[name](**{key: getattr(b, bound) or middle(b) for key, b in LOBES[name].parameter_specs.items()})
        exact = copy.deepcopy(lobe).double()
        for case in (pairs, sharp):
            expected = exact(Pairs.from_directions(case.wi.double(), case.wo.double()))
            error = (lobe(case).double() - expected).abs() / (expected + 1e-6 * expected.max())
            assert error.max() < 2e-4


@every_lobe
def test_gradcheck(name: str) -> None:
    pairs = some_pairs(4)
    parameters = [value.requires_grad_() for value in values(name, 2).values()]
    assert torch.autograd.gradcheck(lambda *p: LOBES[name].function(pairs, *p), parameters)


@every_lobe
def test_gradcheck_of_directions(name: str) -> None:
    parameters, pairs = values(name), some_pairs(6)
    wi, wo = pairs.wi.clone().requires_grad_(), pairs.wo.clone().requires_grad_()

    def function(wi: Tensor, wo: Tensor) -> Tensor:
        return LOBES[name].function(Pairs.from_directions(wi, wo), *parameters.values())

    assert torch.autograd.gradcheck(function, (wi, wo))


@every_lobe
def test_reciprocity(name: str) -> None:
    lobe, pairs = made(name), some_pairs(500)
    swapped = Pairs.from_directions(pairs.wo, pairs.wi)
    torch.testing.assert_close(lobe(swapped), lobe(pairs), rtol=1e-12, atol=0)


@every_lobe
def test_turning_both_directions_changes_nothing(name: str) -> None:
    lobe, pairs = made(name), some_pairs(100)
    c, s = math.cos(0.7), math.sin(0.7)
    turn = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)
    turned = Pairs.from_directions(pairs.wi @ turn.T, pairs.wo @ turn.T)
    torch.testing.assert_close(lobe(turned), lobe(pairs), rtol=1e-9, atol=0)


@every_lobe
def test_linear_parameters_are_linear(name: str) -> None:
    parameters, other, pairs = values(name), values(name, seed=9), some_pairs(50)
    function, linear = LOBES[name].function, [key for key, b in LOBES[name].parameter_specs.items() if b.linear]
    assert linear or LOBES[name].albedo_spec() is None
    for key in linear:
        mixed = function(pairs, **{**parameters, key: 2 * parameters[key] - 3 * other[key]})
        parts = 2 * function(pairs, **parameters) - 3 * function(pairs, **{**parameters, key: other[key]})
        torch.testing.assert_close(mixed, parts, rtol=1e-10, atol=1e-14)


@every_lobe
def test_declarations(name: str) -> None:
    lobe = LOBES[name]
    assert lobe.parameter_specs
    for key, spec in lobe.parameter_specs.items():
        assert getattr(lobe, key) is spec
        assert spec.name == key
        assert spec.lower <= spec.start <= spec.upper
        assert spec.lower < spec.upper
        assert spec.lower > 0 or not spec.log
        assert spec.doc
        assert (getattr(lobe(), key) == torch.tensor(spec.start)).all()
        assert getattr(lobe(), key).shape == spec.shape


@every_lobe
def test_batched(name: str) -> None:
    lobe, pairs = made(name), some_pairs(1, 5)
    batch = lobe.batched(4)
    assert batch(pairs).shape[-3] in (1, 4)
    torch.testing.assert_close(batch(pairs), lobe(pairs).expand(batch(pairs).shape), rtol=1e-12, atol=0)
    for key, spec in LOBES[name].parameter_specs.items():
        assert getattr(batch, key).shape == (4, *spec.shape)
        assert getattr(lobe, key).shape == spec.shape
    with torch.no_grad():
        next(batch.parameters())[0].mul_(0.5)
    assert not torch.equal(batch(pairs)[0], batch(pairs)[1])
    with pytest.raises(ShapeError, match="4 materials, not 3"):
        batch.batched(3)


@every_lobe
def test_state_dict(name: str) -> None:
    pairs = some_pairs(5)
    for lead in ((), (3,)):
        lobe, other = (
            Sum(Lambert(albedo=torch.rand(*lead, 3).double()), made(name, *lead)),
            Sum(Lambert(), LOBES[name]()),
        )
        other = other.double().batched(*lead) if lead else other.double()
        assert not torch.equal(other(pairs), lobe(pairs))
        other.load_state_dict(lobe.state_dict())
        torch.testing.assert_close(other(pairs), lobe(pairs), rtol=0, atol=0)


@every_lobe
def test_copies_stand_alone(name: str) -> None:
    lobe, pairs = Sum(made("lambert", 3), made(name, 3)), some_pairs(5)
    before = lobe(pairs).detach().clone()
    for other in (copy.deepcopy(lobe), pickle.loads(pickle.dumps(lobe))):
        assert repr(other) == repr(lobe) and other.state_dict().keys() == lobe.state_dict().keys()
        torch.testing.assert_close(other(pairs), before, rtol=0, atol=0)
        for value in other.parameters():
            value.data.mul_(0.5)
        assert not torch.equal(other(pairs), before)
        torch.testing.assert_close(lobe(pairs), before, rtol=0, atol=0)


@every_lobe
def test_the_signature_names_the_parameters(name: str) -> None:
    lobe = LOBES[name]
    shown = inspect.signature(lobe).parameters
    assert list(shown) == [*lobe.parameter_specs, "dtype"]
    assert {key: shown[key].default for key in lobe.parameter_specs} == {
        key: spec.start for key, spec in lobe.parameter_specs.items()
    }
    assert set(lobe.__annotations__) >= set(lobe.parameter_specs), "annotate parameters: type checkers need it"


@every_lobe
def test_parameters_can_be_set(name: str) -> None:
    lobe, batch = LOBES[name](dtype=torch.float64), LOBES[name](dtype=torch.float64).batched(2)
    for key, spec in lobe.parameter_specs.items():
        setattr(lobe, key, middle(spec))
        setattr(batch, key, torch.full(spec.shape, middle(spec)))
        for value, shape in ((getattr(lobe, key), spec.shape), (getattr(batch, key), (2, *spec.shape))):
            assert isinstance(value, torch.nn.Parameter) and value.dtype == torch.float64
            assert value.shape == shape and torch.allclose(value, torch.tensor(middle(spec), dtype=torch.float64))
        where = f"{type(lobe).__name__}.{key}"
        with pytest.raises(ShapeError, match=rf"^{where}: expected \(\.\.\., .*, found \(7,\)$"):
            setattr(lobe, key, torch.ones(7))
        with pytest.raises(UsageError, match=rf"^{where}: expected a number, a tensor or a list, found str$"):
            setattr(lobe, key, "wide")
        with pytest.raises(UsageError, match=rf"^{where}: .* without a graph"):
            setattr(lobe, key, torch.ones(spec.shape, requires_grad=True))


def test_repr_shows_values_or_shapes() -> None:
    assert repr(Ward(specular=[0.1, 0.25, 1], roughness=0.1)) == "Ward(specular=[0.1, 0.25, 1], roughness=0.1)"
    assert repr(Ward().batched(4)) == "Ward(specular=<4 x 3>, roughness=<4 x 1>)"
    shown = "DistributionBased(distribution=<90 x 3>, f0=0.3, fresnel_table=<16 x 3>)"
    assert repr(LOBES["distribution_based"]()) == shown


@pytest.mark.slow
def test_type_checkers_know_the_parameters(tmp_path: Path) -> None:
    """What an editor completes: the signature is there without running the code."""
    api = pytest.importorskip("mypy.api")
    code = tmp_path / "code.py"
    code.write_text(
        "import torch\n"
        "from torchbrdf.lobes import Lobe, Sum, Lambert, Ward\n"
        "lobe = Ward(specular=[0.1, 0.2, 0.3], roughness=0.1, dtype=torch.float64)\n"
        "lobe.roughness = 0.3\n"
        "value: torch.Tensor = lobe.roughness\n"
        "start: float = Ward.roughness.start\n"
        "model = Sum(Lambert(), Ward())\n"
        "def make(kind: type[Lobe]) -> Lobe: return kind(dtype=torch.float64)\n"
        "Ward(shininess=3.0)\n"
        "Ward(roughness='wide')\n"
    )
    found, _, _ = api.run([str(code), f"--config-file={CHECKOUT}/setup.cfg", f"--cache-dir={CHECKOUT}/.mypy_cache"])
    errors = [line.split(": error: ") for line in found.splitlines() if ": error: " in line]
    assert [where.rsplit(":")[-1] for where, _ in errors] == ["9", "10"], found
    assert 'Unexpected keyword argument "shininess" for "Ward"' in errors[0][1]
    assert 'Argument "roughness" to "Ward" has incompatible type "str"' in errors[1][1]


def test_a_model_of_lobes_without_a_name_is_refused() -> None:
    class Nameless(Ward):
        pass

    with pytest.raises(UsageError, match=r"^model: expected lobes of a registered kind, found Nameless$"):
        model_name(Sum(Lambert(), Nameless()))


def test_a_constructor_of_ones_own_is_shown() -> None:
    class Half(Ward):
        def __init__(self, share: float) -> None:
            super().__init__(specular=share)

    assert str(inspect.signature(Half)) == "(share: float)"
    assert Half(0.25).specular.tolist() == [0.25] * 3
    assert list(inspect.signature(Sum).parameters) == ["lobes", "shared"]


@every_lobe
def test_compiles(name: str) -> None:
    torch._dynamo.reset()
    parameters, pairs = values(name, 2), some_pairs(5)
    lobe = Sum(Lambert(dtype=torch.float64), LOBES[name](**parameters))

    def function(wi: Tensor, wo: Tensor, *parameters: Tensor) -> Tensor:
        return LOBES[name].function(Pairs.from_directions(wi, wo), *parameters)

    compiled = torch.compile(function, backend="eager", fullgraph=True)
    expected = LOBES[name].function(some_pairs(5), *parameters.values())
    torch.testing.assert_close(compiled(pairs.wi, pairs.wo, *parameters.values()), expected)
    torch.testing.assert_close(torch.compile(lobe, backend="eager", fullgraph=True)(pairs), lobe(some_pairs(5)))


@every_lobe
def test_unknown_and_misshapen_parameters_are_refused(name: str) -> None:
    lobe = LOBES[name]
    known = ", ".join(lobe.parameter_specs)
    with pytest.raises(UsageError, match=rf"^{lobe.__name__}: unknown parameter 'shininess'; expected {known}$"):
        lobe(shininess=1.0)
    key = next(iter(lobe.parameter_specs))
    with pytest.raises(ShapeError, match=rf"^{lobe.__name__}\.{key}: expected \(\.\.\., .*3\), found \(2,\)$"):
        lobe(**{key: torch.ones(2)})


@every_lobe
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda(name: str) -> None:
    lobe, pairs = made(name, 3), some_pairs(3, 100)
    result = copy.deepcopy(lobe).cuda()(pairs.to("cuda"))
    assert result.is_cuda
    torch.testing.assert_close(result.cpu(), lobe(pairs), rtol=1e-10, atol=0)


def test_numbers_and_lists_as_parameters() -> None:
    assert Lambert(albedo=0.25).albedo.tolist() == [0.25] * 3
    assert Lambert(albedo=[0.25, 0.5, 1]).albedo.tolist() == [0.25, 0.5, 1]
    assert Lambert(albedo=1).albedo.dtype == torch.get_default_dtype()
    assert Ward(roughness=torch.full((4, 1), 0.5)).roughness.shape == (4, 1)


def test_sum() -> None:
    pairs, lobes = some_pairs(20), [made("lambert"), made("ward"), made("cook_torrance")]
    total = Sum(Sum(lobes[0], lobes[1]), lobes[2])
    assert total.components() == lobes
    torch.testing.assert_close(total(pairs), lobes[0](pairs) + lobes[1](pairs) + lobes[2](pairs))
    assert [name for name, _ in total.named_parameters()] == [
        *["lobes.0.albedo", "lobes.1.specular", "lobes.1.roughness"],
        *["lobes.2.specular", "lobes.2.roughness", "lobes.2.f0"],
    ]
    with pytest.raises(UsageError, match="Sum: expected at least one lobe, found none"):
        Sum()


def test_gradients_reach_every_part() -> None:
    total = Sum(made("lambert"), made("ward"), made("ward", seed=3))
    total(some_pairs(20)).sum().backward()
    for value in total.parameters():
        assert (value.grad != 0).all()


@pytest.mark.parametrize("bad", [(0.5, 1.0, 0.0), (2.0, 0.0, 1.0), (-1.0, 0.0, 1.0)])
def test_bounds_the_wrong_way_round_are_refused(bad: tuple[float, float, float]) -> None:
    """A lobe cannot even be declared with them; before Python 3.12 the error is wrapped."""
    with pytest.raises((UsageError, RuntimeError)) as raised:

        class Odd(Lobe):
            width = BoundedParameter(*bad, doc="")

    error = raised.value if isinstance(raised.value, UsageError) else raised.value.__cause__
    assert isinstance(error, UsageError) and "Odd.width: expected lower <= start <= upper" in str(error)
