"""How much memory pictures may take."""

import pytest
import torch

from torchbrdf import memory
from torchbrdf.cli.commands import build_parser
from torchbrdf.errors import UsageError
from torchbrdf.lobes import Lambert
from torchbrdf.render import Scene, render, sphere


def test_the_limit_holds_within_and_is_given_back() -> None:
    assert memory.limit() == 2 * 2**30
    with memory.limited(0.5), memory.limited(1):
        assert memory.limit() == 2**30
    with pytest.raises(ZeroDivisionError), memory.limited(0.5):
        1 / 0  # noqa: B018
    with memory.limited(None):
        assert memory.limit() == 2 * 2**30


@pytest.mark.parametrize("wrong", [0, -1, float("nan"), float("inf"), 1e9, "two", True])
def test_what_is_no_limit_is_refused(wrong: object) -> None:
    said = r"^memory: expected a number from 0.01 to 65536, found .* \(GiB\)$"
    with pytest.raises(UsageError, match=said), memory.limited(wrong):  # type: ignore[arg-type]
        pass
    assert memory.limit() == 2 * 2**30


@pytest.mark.parametrize("command", ["render", "run", "match", "view", "fit", "score", "export"])
@pytest.mark.parametrize(("text", "gib"), [("2", 2.0), ("1.5", 1.5), ("0.25", 0.25)])
def test_commands_that_draw_have_it(command: str, text: str, gib: float) -> None:
    words = {"score": [], "export": ["x", "--to", "rgl", "--out", "o"]}.get(command, ["x"])
    assert build_parser().parse_args([command, *words, "--memory", text]).memory == gib
    assert build_parser().parse_args([command, *words]).memory == memory.DEFAULT


def test_pictures_are_the_same_where_a_transport_is_not_kept() -> None:
    paints = [Lambert(albedo=albedo) for albedo in (0.1, 0.2, 0.3, 0.4, 0.5)]
    settings = {"size": 80, "nodes": 32, "light_samples": 256}
    kept, bounded = (Scene(sphere(3), **settings) for _ in range(2))
    expected = render(paints, kept)
    assert kept.transport.in_memory
    with memory.limited(memory.LEAST):
        torch.testing.assert_close(render(paints, bounded), expected, rtol=1e-4, atol=1e-5)
        assert not bounded.transport.in_memory
