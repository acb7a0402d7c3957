"""What is beside the values of every registered lobe: parameters, copies, errors, sums, tracing."""

import copy
import inspect
import pickle
import re
from pathlib import Path

import pytest
import torch
from helpers.caches import forget
from helpers.lobe_cases import every_lobe, made, middle, some_pairs, values
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.lobes import LOBES, BoundedParameter, Lambert, Lobe, Sum, Ward, model_name
from torchbrdf.pairs import Pairs

CHECKOUT = Path(__file__).resolve().parents[2]


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
    """In a model, with pairs that are made in the graph, and before anything of it ran: no cache is warm."""
    torch._dynamo.reset()
    forget()
    model = Sum(Lambert(dtype=torch.float64), LOBES[name](**values(name, 2)))
    wi, wo = some_pairs(5).wi, some_pairs(5).wo

    def function(wi: Tensor, wo: Tensor) -> Tensor:
        return model(Pairs.from_directions(wi, wo))

    found = torch.compile(function, backend="eager", fullgraph=True)(wi, wo)
    torch.testing.assert_close(found, model(some_pairs(5)))


@pytest.mark.parametrize("name", ["ward", "ggx"])
def test_compiles_with_pairs_and_parameters_from_outside(name: str) -> None:
    torch._dynamo.reset()
    forget()
    lobe, parameters = made(name, 2), values(name, 2).values()
    compiled = torch.compile(LOBES[name].function, backend="eager", fullgraph=True)
    found = compiled(some_pairs(5), *parameters), torch.compile(lobe, backend="eager", fullgraph=True)(some_pairs(5))
    for one in found:
        torch.testing.assert_close(one, lobe(some_pairs(5)))


@every_lobe
def test_unknown_and_misshapen_parameters_are_refused(name: str) -> None:
    lobe = LOBES[name]
    known = ", ".join(lobe.parameter_specs)
    said = str(
        UsageError(f"{lobe.__name__}: unknown parameter 'shininess'; expected {known}")
    )  # long ones are shortened
    with pytest.raises(UsageError, match=f"^{re.escape(said)}$"):
        lobe(shininess=1.0)
    key = next(iter(lobe.parameter_specs))
    with pytest.raises(ShapeError, match=rf"^{lobe.__name__}\.{key}: expected \(\.\.\., .*3\), found \(2,\)$"):
        lobe(**{key: torch.ones(2)})


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
