"""A strategy."""

from typing import Any

from torchbrdf.fitting import STRATEGIES


def my_strategy(*problem: Any) -> Any:
    """What the paper did."""
    return STRATEGIES["staged"](*problem)
