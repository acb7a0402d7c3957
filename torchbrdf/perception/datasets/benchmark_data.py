"""What people were asked about, from the files that have it."""

from pathlib import Path

import torch

from torchbrdf.measured import load
from torchbrdf.perception.agreement.scores import METHODS, Approximation, BenchmarkData
from torchbrdf.perception.datasets.factors import FACTORS, read_factors
from torchbrdf.perception.datasets.opinions import read_opinions
from torchbrdf.perception.datasets.published import read_published
from torchbrdf.perception.datasets.triplets import read_triplets


def read_benchmark_data(
    materials: str, human: str, fits: str, factors: str, triplets: str, opinions: str
) -> BenchmarkData:
    """The materials in a folder, the answers in the folder `human`, and the approximations that are published.

    fits, factors: files, or names of files in `human`; without a file of factors their method has no model. triplets,
    opinions: names of files in `human`. A missing file is a DataError that says where it comes from.
    """
    folder = Path(human)
    parameters, tables = (path if path.is_file() else folder / path for path in map(Path, (fits, factors)))
    sets = read_published(parameters, dtype=torch.float64)
    models: dict[str, Approximation] = {method: sets[name] for method, name in METHODS.items() if name in sets}
    if tables.is_file():
        models[FACTORS] = read_factors(tables)
    asked, opined = read_triplets(folder / triplets), read_opinions(folder / opinions)
    measured = load(materials)
    wanted = {*asked.materials, *opined.materials}
    measured = measured.batch([k for k, name in enumerate(measured.names) if name in wanted])
    return BenchmarkData(measured, asked, opined, models)
