"""Files of fits: records written, read and checked."""

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from torchbrdf.errors import DataError
from torchbrdf.files import write_json
from torchbrdf.lobes.parameter_dict import outside_bounds
from torchbrdf.lobes.records import FitRecord, model_of
from torchbrdf.lobes.zoo import is_zoo, zoo_record
from torchbrdf.pairs import Pairs
from torchbrdf.reading import read_json

# Of a model, in 1/sr: beyond what any surface reflects.
LARGEST_VALUE = 1e20
# Models whose values are looked at together.
_CHECKED = 1000


class OutsideBoundsWarning(UserWarning):
    """A file of fits has parameters that no fit would end at; they are kept as they are.

    Example:
        >>> import warnings
        >>> warnings.simplefilter("ignore", OutsideBoundsWarning)
    """


def write_fits(path: Path | str, records: Iterable[FitRecord]) -> None:
    """Write records as JSON, whole or not at all; a number that is not finite is null.

    Args:
        path: The file.
        records: Of fits or stand-ins, of any models.

    Example:
        >>> import tempfile
        >>> from torchbrdf.measured import standins
        >>> records = read_fits(standins())
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_fits(f"{folder}/fits.json", records)
        ...     [record.material for record in read_fits(f"{folder}/fits.json")] == [one.material for one in records]
        True
    """
    write_json(path, [record.to_json() for record in records])


def read_fits(path: Path | str, bad: list[DataError] | None = None) -> list[FitRecord]:
    """Read and check fits. Parameters outside their bounds are kept, with an `OutsideBoundsWarning`.

    Args:
        path: A `fits.json`, or the folder of `torchbrdf fit`; or a name in the zoo, such as `zoo:nickel`, for its one
            record.
        bad: A list that takes the errors of bad records, so that the others are read; None raises the first.

    Returns:
        Its records; `model_of` makes models of those with one kind and number of lobes.

    Raises:
        DataError: It cannot be read, holds no list of fits, or, where `bad` is None, one that is none or whose values
            are not finite; says where and what was expected.

    Example:
        >>> from torchbrdf.measured import standins
        >>> [record.material for record in read_fits(standins())][:3]
        ['alum-bronze', 'aluminium', 'blue-acrylic']
    """
    found: dict[int, FitRecord] = {}
    errors: dict[int, DataError] = {}
    places: list[str] = []
    for k, (where, record) in enumerate(_listed(path, bad)):
        places.append(where)
        try:
            found[k] = FitRecord.from_json(record, where)
        except DataError as error:
            if bad is None:
                raise
            errors[k] = error
    for k in _not_finite(found):
        errors[k] = DataError(f"{places[k]}: parameters of {found[k].model}: {_why_not_finite(found.pop(k))}")
        if bad is None:
            raise errors[k]
    kept = list(found.values())
    if bad is None:
        _warn_outside(path, kept)
    else:  # whoever takes what is bad one by one sees to parameters, too
        bad += [errors[k] for k in sorted(errors)]
    return kept


def _listed(path: Path | str, bad: list[DataError] | None) -> Iterator[tuple[str, dict[str, Any]]]:
    """The records that a path names as they are written, each with where it is."""
    from torchbrdf.lobes.parts import FITS, FitFolder, fit_folder  # late: it makes records

    folder = None if is_zoo(path) else fit_folder(Path(path))
    records: Iterable[tuple[str, dict[str, Any]]]
    if folder is not None:
        records = FitFolder(folder).every(bad)
    elif is_zoo(path):
        records = [(f"{path}: fit 0", zoo_record(path))]
    else:
        path = Path(path) / FITS if Path(path).is_dir() else path
        found: list[dict[str, Any]] = read_json(path, list[dict[str, Any]], "a list of fits")
        records = ((f"{path}: fit {k}", record) for k, record in enumerate(found))
    is_empty = True
    for one in records:
        is_empty = False
        yield one
    if is_empty and not bad:
        raise DataError(f"{path}: expected a list of fits, found an empty one")


def _warn_outside(path: Path | str, records: Sequence[FitRecord]) -> None:
    """One line for a file with parameters outside their bounds."""
    models = [record.to_model(torch.float64) for record in records]
    outside = [
        (record.material, said) for record, model in zip(records, models, strict=True) for said in outside_bounds(model)
    ]
    if outside:
        material, said = outside[0]
        rest = f" (the first of {len(outside)})" if len(outside) > 1 else ""
        warnings.warn(
            f"{path}: parameters outside their bounds are kept as they are: {said}, of {material}{rest}",
            OutsideBoundsWarning,
            stacklevel=3,
        )


def _not_finite(records: Mapping[int, FitRecord]) -> list[int]:
    """The records whose models' values are not finite: nothing could be done with them.

    In either precision: a lobe that is far too narrow overflows in float32 only.
    """
    kinds: dict[tuple[str, int, int], list[int]] = {}
    for k, record in records.items():
        kinds.setdefault((record.model, record.lobes, record.channels), []).append(k)
    bad: set[int] = set()
    for rows in (own[k : k + _CHECKED] for own in kinds.values() for k in range(0, len(own), _CHECKED)):
        model = model_of([records[k] for k in rows], torch.float64)
        for dtype in (torch.float64, torch.float32):
            with torch.no_grad():
                values = model.to(dtype)(_probes().to(dtype=dtype))
            finite = (values.abs() <= LARGEST_VALUE).flatten(1).all(-1)
            bad |= {k for k, good in zip(rows, finite.tolist(), strict=True) if not good}
    return sorted(bad)


def _why_not_finite(record: FitRecord) -> str:
    """What was expected and found: a parameter outside its bounds, where there is one, is what can be mended."""
    outside = outside_bounds(record.to_model(torch.float64))
    if outside:
        every = "; ".join(outside[:4])
        return f"expected them within their bounds, found {every}, with which values are not finite"
    limit = f"{LARGEST_VALUE:g} / sr"
    return f"expected those of a model with values of at most {limit}, found others for {record.material}"


def _probes() -> Pairs:
    """Pairs all over the hemisphere, the normal, the mirror's direction and the horizon among them, `(1, N)`."""
    steps = torch.linspace(0, 1, 7, dtype=torch.float64, device="cpu")
    theta_h, theta_d, phi_d = (part.reshape(1, -1) for part in torch.meshgrid(steps**2, steps, steps, indexing="ij"))
    phi_h = torch.arange(theta_h.shape[1], dtype=torch.float64, device="cpu")  # all round, in no order
    return Pairs.from_half_diff(theta_h * (math.pi / 2), theta_d * (math.pi / 2) * 0.999, phi_d * math.pi, phi_h)
