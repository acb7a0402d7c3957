"""What values that were read have to be like, told without the package."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf import Pairs
from torchbrdf.errors import TorchbrdfError

LONGEST_NAME = 255


class InsaneError(Exception):
    """What was read cannot be."""


class LaterError(Exception):
    """A refusal of what was read by something that no longer knows the file."""


def expect(good: object, what: str) -> None:
    """An InsaneError if something is not good."""
    if not good:
        raise InsaneError(what)


@contextmanager
def later() -> Iterator[None]:
    """What is refused in here need not name the file."""
    try:
        yield
    except TorchbrdfError as error:
        raise LaterError(error) from error


def check_name(name: object, what: str) -> None:
    """A name is a line of text that is no path."""
    check_line(name, what)
    expect(str(name).strip(), f"{what} is empty: {name!r}")
    expect(not {"/", "\\"} & set(str(name)) and name not in (".", ".."), f"{what} is a path: {name!r}")


def check_line(text: object, what: str) -> None:
    """A line of text, which may have no-break spaces."""
    expect(isinstance(text, str), f"{what} is {type(text).__name__}")
    expect(str(text).replace("\u00a0", " ").isprintable(), f"{what} is not printable: {str(text)[:60]!r}")
    expect(len(str(text)) <= LONGEST_NAME, f"{what} has {len(str(text))} characters")


def check_finite(values: Tensor, what: str) -> None:
    """Finite numbers."""
    expect(bool(values.isfinite().all()), f"{what} not finite")


def check_brdf(values: Tensor, what: str) -> None:
    """Values of a BRDF: finite and at least 0."""
    check_finite(values, what)
    expect(bool((values >= 0).all()), f"{what} negative: {float(values.min()):g}")


def check_pairs() -> Pairs:
    """Directions of all kinds above the horizon, `(1, N)`: mirror directions, the normal, near the horizon."""
    source = torch.Generator().manual_seed(0)
    wi, wo = (torch.randn(40, 3, generator=source, dtype=torch.float64) for _ in range(2))
    wi[:10] = torch.tensor([0.0, 0.0, 1.0])
    wo[5:15] = wi[5:15] * torch.tensor([-1.0, -1.0, 1.0])
    for one in (wi, wo):
        one[:, 2] = one[:, 2].abs() + 0.05
    return Pairs.from_directions(*(torch.nn.functional.normalize(one, dim=-1)[None] for one in (wi, wo)))


def first_line(path: Path) -> str:
    """Text that a command line would be given: bytes that are no UTF-8 as Python hands them on."""
    return path.read_bytes().decode("utf-8", "surrogateescape")
