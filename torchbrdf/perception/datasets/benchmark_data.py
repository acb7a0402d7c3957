"""What people were asked about, from the files that have it."""

from pathlib import Path

import torch

from torchbrdf.errors import DataError
from torchbrdf.measured import load
from torchbrdf.measured.catalogue import MERL_NAMES
from torchbrdf.perception.agreement.scores import METHODS, Approximation, BenchmarkData
from torchbrdf.perception.datasets.factors import FACTORS, read_factors
from torchbrdf.perception.datasets.opinions import read_opinions
from torchbrdf.perception.datasets.published import read_published
from torchbrdf.perception.datasets.triplets import read_triplets
from torchbrdf.reading import exists


def read_benchmark_data(
    materials: str, human: str, fits: str, factors: str, triplets: str, opinions: str
) -> BenchmarkData:
    """Read the data of the benchmark: materials, people's answers, and published approximations.

    Args:
        materials: The folder of MERL's tables.
        human: The folder of answers.
        fits: The file of published fits, or its name in `human`.
        factors: The file of factors, or its name in `human`; without it their method has no model.
        triplets: The name of a file in `human`.
        opinions: The same.

    Raises:
        DataError: A file is missing, and where it comes from, or bad; or opinions are about unknown materials, or only
            about methods that nothing gives the values of.
    """
    folder = Path(human)
    parameters, tables = (Path(path) if exists(path) else folder / path for path in (fits, factors))
    sets = read_published(parameters, dtype=torch.float64)
    models: dict[str, Approximation] = {method: sets[name] for method, name in METHODS.items() if name in sets}
    if exists(tables):
        models[FACTORS] = read_factors(tables)
    triplet_answers, opined = read_triplets(folder / triplets), read_opinions(folder / opinions, MERL_NAMES)
    measured = load(materials)
    wanted = {*triplet_answers.materials, *opined.materials}
    measured = measured.batch([k for k, name in enumerate(measured.names) if name in wanted])
    data = BenchmarkData(measured, triplet_answers, opined, models)
    if not len(data.opinions):
        others = ", ".join(data.left_out)
        raise DataError(f"{folder / opinions}: expected opinions of {', '.join(models)}, found only others: {others}")
    return data
