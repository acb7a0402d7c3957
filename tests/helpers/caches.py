"""Caches of the package's functions, which a test that ran before may have filled."""

import sys
from functools import cache

CACHED = type(cache(lambda: None))


def forget() -> None:
    """Empty the caches of all functions in the package's modules, as if nothing had run in this process."""
    for name, module in list(sys.modules.items()):
        if name.startswith("torchbrdf."):
            for value in list(vars(module).values()):
                if isinstance(value, CACHED):
                    value.cache_clear()
