"""The kinds of things that are found by name, and the words that stand for choices: known before torch is imported.

A command refuses a wrong name by these at once. Whoever works with what has the names imports them where they belong:
`torchbrdf.lobes.LOBES` and so on are these registries.
"""

import importlib
from collections.abc import Callable, Iterable
from typing import Any

from torchbrdf.registry import Registry, unknown

JOIN, SHARE = "+", ":"
"""Of a model's name, between its components, and before the parameters that they share."""


def _base(module: str, name: str) -> Callable[[], type]:
    """What gives the class that things of a kind extend, from where they are at home."""
    return lambda: getattr(importlib.import_module(module), name)


LOBES: Registry[Any] = Registry("lobe", "torchbrdf.lobes", "torchbrdf.lobes", _base("torchbrdf.lobes.base", "Lobe"))
LOSSES: Registry[Any] = Registry("loss", "torchbrdf.losses", "torchbrdf.losses", _base("torchbrdf.losses.base", "Loss"))
DIFFERENCES: Registry[Any] = Registry(
    "difference",
    "torchbrdf.images.differences",
    "torchbrdf.differences",
    _base("torchbrdf.images.differences.base", "Difference"),
)
FORMATS: Registry[Any] = Registry(
    "format", "torchbrdf.measured", "torchbrdf.formats", _base("torchbrdf.measured.format", "BrdfFormat")
)
EXPORTERS: Registry[Any] = Registry(
    "exporter", "torchbrdf.export", "torchbrdf.exporters", _base("torchbrdf.export.base", "Exporter")
)
STRATEGIES: Registry[Any] = Registry("strategy", "torchbrdf.fitting", "torchbrdf.strategies", lambda: None)

DIFFUSE_MODES = ("45:0", "fit")
EXECUTORS = ("processes", "threads", "dask")
INTERVALS = ("none", "gauss_newton", "bootstrap")
BANDS = ("rgb", "keep")
BACKENDS = ("auto", "pyrender", "software")
SCALINGS = ("likelihood", "least_squares")
FORMULAS = ("mean_log_difference",)
"""Metrics that are no losses, of `torchbrdf.perception.FORMULAS`."""


def check_model(name: str) -> None:
    """Refuse a model's name with an unknown lobe in it, without importing lobes.

    Args:
        name: As for `torchbrdf.lobes.make_model`.

    Raises:
        UsageError: There is no such lobe.

    Example:
        >>> from torchbrdf.kinds import check_model
        >>> check_model("oren_nayar+ggx+ggx:f0")
    """
    for part in name.partition(SHARE)[0].split(JOIN):
        LOBES.check(part)


def check_metric(text: str) -> None:
    """Refuse an unknown metric, other than the `module:name` of somebody's own.

    Args:
        text: As for `torchbrdf.perception.find_metric`.

    Raises:
        UsageError: There is no such metric.

    Example:
        >>> from torchbrdf.kinds import check_metric
        >>> check_metric("cube_root")
    """
    if ":" not in text:
        LOSSES.check(text, *FORMULAS)


def check_word(kind: str, word: str, words: Iterable[str]) -> None:
    """Refuse a word that is none of some.

    Args:
        kind: What it was to choose, for the message.
        word: What was given.
        words: What it may be.

    Raises:
        UsageError: It is another.

    Example:
        >>> from torchbrdf.kinds import BACKENDS, check_word
        >>> check_word("backend", "auto", BACKENDS)
    """
    if word not in words:
        raise unknown(kind, word, words)
