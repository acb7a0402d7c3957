"""Fitted models as files: a list of records, each a material, a model and its parameters (`fits.json`)."""

import json
from pathlib import Path
from typing import Any

import torch

from torchbrdf.errors import DataError
from torchbrdf.files import write_text
from torchbrdf.lobes.model import from_parameters
from torchbrdf.lobes.sum import Sum

NEEDED = ("material", "model", "lobes", "parameters")


def model_of(records: list[dict[str, Any]]) -> Sum:
    """The batched model of several records with the same kind and number of lobes."""
    models = [from_parameters(record["model"], record["parameters"]) for record in records]
    return models[0].unpack(torch.stack([model.pack() for model in models]))


def write_fits(path: Path | str, records: list[dict[str, Any]]) -> None:
    """Write records as JSON; an error that is not a number is written as null."""
    plain = [{key: None if value != value else value for key, value in record.items()} for record in records]
    write_text(path, json.dumps(plain, indent=1, allow_nan=False) + "\n")


def read_fits(path: Path | str) -> list[dict[str, Any]]:
    """Read and check a `fits.json`."""
    try:
        records = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: expected the JSON of fits, found {error}") from None
    if not isinstance(records, list) or not records or not all(isinstance(record, dict) for record in records):
        raise DataError(f"{path}: expected a list of fits, found {type(records).__name__} of {len(records)}")
    for k, record in enumerate(records):
        missing = [key for key in NEEDED if key not in record]
        if missing:
            raise DataError(f"{path}: fit {k} lacks {', '.join(missing)}")
    return records


def number(value: float | None) -> float:
    """A number that `write_fits` wrote: null is nan."""
    return float("nan") if value is None else value
