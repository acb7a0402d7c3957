"""The file of a learned metric, `metric.json`: its constants by name, and where they are from."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from torchbrdf.errors import DataError, shown
from torchbrdf.losses.bins import THETA_D, THETA_H
from torchbrdf.reading import read_json

EPSILON = 1e-3
"""Added to values times cosines before they are compressed: how dark a difference can be before it no longer counts."""
CONSTANTS = ("gloss", "chroma", "bins", "pointwise")
"""Names of w1 to w4, in the order of `LearnedLoss.terms`."""
BUNDLED = "learned_metric.json"
LARGEST_CONSTANT = 1e20
"""Trained constants are below 1e3; far larger ones overflow in float32."""


class MetricFile(TypedDict):
    """What a `metric.json` holds."""

    constants: NotRequired[dict[str, float]]
    weights: NotRequired[Any]
    provenance: NotRequired[dict[str, Any]]
    epsilon: NotRequired[float]
    theta_h: NotRequired[list[float]]
    theta_d: NotRequired[list[float]]


def read_metric(weights: str | Path | Mapping[str, Any] | None) -> MetricFile:
    """The content of a `metric.json`, checked; None: that which comes with torchbrdf."""
    where = "weights"
    if isinstance(weights, Mapping):
        data = _convert(weights, where)
    else:
        source = files("torchbrdf.assets") / BUNDLED if weights is None else weights
        where = str(source)
        data = read_json(where, MetricFile, "a learned metric, as the recipe train_metric writes it")
    names = ", ".join(CONSTANTS)
    if "constants" not in data:
        found = "the weights of an older form: train it again" if "weights" in data else "none"
        raise DataError(f"{where}: expected constants {names}; found {found}")
    for key, expected in schema().items():
        if data.get(key, expected) != expected:
            raise DataError(f"{where}: {key}: expected {expected}, found {shown(data.get(key))}")
    constants = data["constants"]
    if set(constants) != set(CONSTANTS):
        raise DataError(f"{where}: constants: expected {names}; found {shown(', '.join(constants))}")
    for name, value in constants.items():
        if not 0 <= value <= LARGEST_CONSTANT:
            found = shown(value)
            raise DataError(f"{where}: constants: {name}: expected 0 to {LARGEST_CONSTANT:g}, found {found}")
    if not any(constants.values()):
        raise DataError(f"{where}: expected a constant above 0, found none")
    return data


def _convert(weights: Mapping[str, Any], where: str) -> MetricFile:
    import msgspec  # late: not every loss has constants from outside

    try:
        return msgspec.convert(dict(weights), MetricFile)
    except (msgspec.ValidationError, RecursionError) as error:
        raise DataError(f"{where}: expected a learned metric, found {error}") from None


def schema() -> dict[str, Any]:
    """What the constants of a `metric.json` are the constants of."""
    return {"epsilon": EPSILON, "theta_h": list(THETA_H), "theta_d": list(THETA_D)}
