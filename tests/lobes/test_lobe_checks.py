"""What is wrong with a lobe's parameters or its function is said in one line."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from torchbrdf import fit, load
from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.lobes import LOBES, BoundedParameter, Lobe, Sum, Ward, albedo, apply_albedo
from torchbrdf.losses import RMSLoss
from torchbrdf.measured import standins
from torchbrdf.pairs import Pairs

UP = torch.tensor([[0.0, 0.0, 1.0]])
PAIRS = Pairs.from_directions(UP.expand(5, 3), UP)


def shape_of(pairs: Pairs, width: Tensor) -> Tensor:
    return (-pairs.tan2_h / width.square()).exp()


def good(pairs: Pairs, colour: Tensor, width: Tensor) -> Tensor:
    return apply_albedo(pairs, shape_of(pairs, width), colour)


def of_other_names(pairs: Pairs, colour: Tensor, roughness: Tensor) -> Tensor:
    return good(pairs, colour, roughness)


def of_one_more(pairs: Pairs, colour: Tensor, width: Tensor, power: Tensor) -> Tensor:
    return good(pairs, colour, width) ** power


def with_a_default(pairs: Pairs, colour: Tensor, width: Tensor, power: float = 1.0) -> Tensor:
    return good(pairs, colour, width) ** power


def of_pairs_alone(pairs: Pairs, colour: Tensor, width: Tensor) -> Tensor:
    return shape_of(pairs, width)


def turned(pairs: Pairs, colour: Tensor, width: Tensor) -> Tensor:
    return good(pairs, colour, width).mT


def no_tensor(pairs: Pairs, colour: Tensor, width: Tensor) -> Any:
    return good(pairs, colour, width).tolist()


def lobe_of(its_function: Callable[..., Any]) -> type[Lobe]:
    class Own(Lobe):
        colour: BoundedParameter = albedo(start=0.5, doc="colour")
        width: BoundedParameter = BoundedParameter(start=0.3, lower=0.01, upper=1.0, doc="width")
        function = staticmethod(its_function)

    return Own


@pytest.mark.parametrize("name", LOBES)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_parameters_that_are_not_finite(name: str, bad: float) -> None:
    kind = LOBES[name]
    for key, spec in kind.parameter_specs.items():
        several = torch.full((2, *spec.shape), spec.start)
        several[1].flatten()[-1] = bad
        for value in (bad, torch.full(spec.shape, bad), several):
            with pytest.raises(ShapeError, match=rf"^{kind.__name__}\.{key}: expected finite values .*, found {bad}$"):
                kind(**{key: value})
        lobe = kind()
        with pytest.raises(ShapeError, match=f"found {bad}$"):
            setattr(lobe, key, bad)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (1e400, "expected finite values"),
        (10**400, "expected a number, a tensor or a list, found int"),
        ([[0.1], [0.1, 0.2]], "expected a number, a tensor or a list, found list"),
        (1j, "expected .*, found"),
        (torch.tensor(1j), "expected real numbers, found torch.complex64"),
        ([], r"expected \(\.\.\., 1\), found \(0,\)"),
        (None, "expected a number, a tensor or a list, found NoneType"),
        (torch.zeros(2, 3), r"expected \(\.\.\., 1\), found \(2, 3\)"),
    ],
)
def test_values_that_are_none(value: Any, expected: str) -> None:
    with pytest.raises((UsageError, ShapeError), match=rf"^Ward\.roughness: {expected}"):
        Ward(roughness=value)


@pytest.mark.parametrize("dtype", [torch.int32, torch.bool, torch.complex64, "float32"])
def test_dtypes_that_are_none(dtype: Any) -> None:
    with pytest.raises(UsageError, match=r"^Ward\.specular: expected a dtype of floats, found "):
        Ward(dtype=dtype)


def test_leading_dimensions_that_do_not_go_together() -> None:
    with pytest.raises(ShapeError, match=r"^Ward: expected leading .*, found specular \(2,\), roughness \(3,\)$"):
        Ward(specular=torch.ones(2, 3), roughness=torch.ones(3, 1))
    many = Pairs.from_directions(UP.expand(4, 5, 3), UP)
    for model in (Ward().batched(3), Sum(Ward().batched(3))):
        with pytest.raises(ShapeError, match=r"^Ward: expected leading .*, found .*roughness \(3,\), pairs \(4,\)$"):
            model(many)
    assert Ward().batched(4)(many).shape == (4, 5, 3)


@pytest.mark.parametrize(("function", "found"), [(of_other_names, "roughness"), (of_one_more, "width, power")])
def test_a_function_of_other_parameters(function: Callable[..., Tensor], found: str) -> None:
    with pytest.raises(UsageError) as raised:
        lobe_of(function)()
    said = f"Own.function: expected (pairs, colour, width), as it is declared, found (pairs, colour, {found})"
    assert str(raised.value) == said


def test_functions_that_do() -> None:
    for function in (good, with_a_default):
        assert lobe_of(function)()(PAIRS).shape == (5, 3)


@pytest.mark.parametrize(
    ("function", "found"), [(of_pairs_alone, r"\(5,\)"), (turned, r"\(3, 5\)"), (no_tensor, "list")]
)
def test_a_function_of_another_shape(function: Callable[..., Tensor], found: str) -> None:
    lobe = lobe_of(function)()
    with pytest.raises(ShapeError, match=rf"^Own\.function: expected values \(\.\.\., 5, 3\), found {found}$"):
        lobe(PAIRS)
    measured = load(standins()).batch([6], torch.arange(0, 900_000, 3000))
    with pytest.raises(ShapeError, match=r"^Own\.function: expected values \(\.\.\., 4, 3\), found "):
        fit(lobe, measured, RMSLoss(), samples=None)


def test_no_function() -> None:
    class Bare(Lobe):
        width: BoundedParameter = BoundedParameter(start=0.3, lower=0.01, upper=1.0, doc="width")

    with pytest.raises(UsageError, match=r"^Bare: expected a function of \(pairs, width\), found none$"):
        Bare()
