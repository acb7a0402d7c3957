"""The tables of docs/lobes.md are those of the registries, and no row is missing."""

import math
import re
from pathlib import Path

import pytest
import torch
from helpers.lobe_rows import cells, convention_cells

from torchbrdf.errors import UsageError
from torchbrdf.lobes import (
    LOBES,
    ROUGHNESS,
    Beckmann,
    BlinnPhong,
    Lafortune,
    alpha_to_exponent,
    alpha_to_roughness,
    exponent_to_alpha,
    roughness_to_alpha,
)
from torchbrdf.pairs import Pairs

PAGE = Path(__file__).resolve().parents[1] / "docs" / "lobes.md"


def rows(header: str) -> dict[str, list[str]]:
    """The rows of the table that begins so, by the name in their first cell."""
    lines = iter(PAGE.read_text(encoding="utf-8").splitlines())
    for line in lines:
        if line.startswith(header):
            break
    next(lines)
    found = {}
    for line in lines:
        if not line.startswith("|"):
            break
        own = [cell.strip() for cell in line.strip("|").split("|")]
        found[own[0].strip("`")] = own
    return found


def own_lobes() -> list[str]:
    return [name for name in LOBES if LOBES[name].__module__.startswith("torchbrdf.")]


def test_every_lobe_has_a_row_and_every_row_a_lobe() -> None:
    table = rows("| name | kind |")
    assert list(table) == own_lobes()


@pytest.mark.parametrize("name", own_lobes())
def test_the_row_of_a_lobe(name: str) -> None:
    """What the registry knows, and a source and renderers that somebody wrote down."""
    row = rows("| name | kind |").get(name)
    expected = cells(name)
    assert row is not None, f"docs/lobes.md lacks: | {' | '.join(expected)} | source | renderers |"
    assert row[:4] == expected
    source, renderers = row[4:]
    assert len(renderers) >= 4
    # The source is one of those in the docstring.
    said = " ".join((LOBES[name].function.__doc__ or "").split())
    for doi in re.findall(r"\[doi:(\S+?)\]", source):
        assert doi in said, doi
    assert re.search(r"\d{4}|glTF 2\.0|OpenPBR", source)


def test_the_rows_of_conventions() -> None:
    table = rows("| convention | whose |")
    assert table == {name: convention_cells(name) for name in ROUGHNESS}


def test_the_numbers_of_the_page() -> None:
    """The same highlight by each formula, to the digits that are shown."""
    names = ("gltf", "pbrt", "slope_deviation", "exponent", "mirror_exponent")
    table = rows("| alpha | squared")
    assert len(table) == 5
    for alpha, *shown in table.values():
        for name, text in zip(names, shown, strict=True):
            value = float(text.replace(",", ""))
            assert alpha_to_roughness(float(alpha), name) == pytest.approx(value, rel=3e-3, abs=1e-9)


@pytest.mark.parametrize("name", ROUGHNESS)
def test_there_and_back(name: str) -> None:
    """Numbers and tensors of any shape and dtype, and the formula that the page shows."""
    alpha = torch.tensor([[0.003, 0.05], [0.09, 0.7]], dtype=torch.float64)
    value = alpha_to_roughness(alpha, name)
    if name == "disney_gloss":  # of coats, from 0.001 to 0.1
        alpha, value = alpha[:, :1], value[:, :1]
    torch.testing.assert_close(roughness_to_alpha(value.clamp_min(0), name), alpha, rtol=1e-12, atol=0)
    assert roughness_to_alpha(value.clamp_min(0).float(), name).dtype == torch.float32
    number = value.flatten()[0].item()
    formula = ROUGHNESS[name].formula.replace("^", "**").replace("4 n", "4 * n").replace("sqrt(2) r", "sqrt(2) * r")
    formula = formula.replace("0.099 r", "0.099 * r")
    shown = eval(formula, {"sqrt": math.sqrt, "r": number, "n": number})
    assert roughness_to_alpha(number, name) == pytest.approx(shown, rel=1e-12)
    assert isinstance(roughness_to_alpha(number, name), float)


def test_lobes_of_the_same_alpha_are_as_sharp() -> None:
    """Curvatures at the tip of the highlight: Beckmann's, of half vectors and of the mirror direction."""
    tiny = torch.tensor([0.0, 1e-3], dtype=torch.float64)
    straight = torch.zeros_like(tiny)
    pairs = Pairs.from_half_diff(tiny, straight, straight)

    def sharpness(lobe: torch.nn.Module) -> float:
        tip, beside = lobe(pairs)[:, 0].tolist()
        return -math.log(beside / tip) / 1e-6

    alpha = 0.05
    exponent = alpha_to_exponent(alpha)
    mirror = alpha_to_roughness(alpha, "mirror_exponent")
    expected = sharpness(Beckmann(roughness=alpha, f0=1.0, dtype=torch.float64))
    assert sharpness(BlinnPhong(exponent=exponent, dtype=torch.float64)) == pytest.approx(expected, rel=0.01)
    assert sharpness(Lafortune(exponent=mirror, cz=1.0, dtype=torch.float64)) == pytest.approx(expected, rel=0.01)
    assert exponent_to_alpha(exponent) == pytest.approx(alpha, rel=1e-12)


@pytest.mark.parametrize("value", [-0.1, math.nan, torch.tensor([0.1, -1.0])])
def test_what_is_no_roughness(value: float | torch.Tensor) -> None:
    with pytest.raises(UsageError, match=r"^roughness: expected numbers of at least 0, found (-0.1|nan|-1.0)"):
        roughness_to_alpha(value, "gltf")
    with pytest.raises(UsageError, match=r"^unknown convention of roughness 'glft'; .* did you mean 'gltf'\?$"):
        roughness_to_alpha(0.1, "glft")
