"""The tables of a folder of fits: `fits.json` and `fits.csv`, of so many that people read them, and Parquet of any."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from torchbrdf.errors import UsageError
from torchbrdf.files import destination, finite, json_text, replacing, write_text
from torchbrdf.fitting.result import flat_csv, flat_record
from torchbrdf.lobes.parts import FITS, TABLE, FitFolder

if TYPE_CHECKING:
    import pyarrow

PARQUET = "fits.parquet"
MOST = 10_000
"""Records of `fits.json` and `fits.csv`; folders with more are read by their parts."""


def write_tables(folder: FitFolder, parquet: bool = False) -> None:
    """Write the tables of all fits that a folder has, as they are then.

    Args:
        folder: The folder.
        parquet: Whether to write `fits.parquet`, too.

    Raises:
        UsageError: pyarrow is not installed.
        DataError: A part is bad, or a file cannot be written.
    """
    with folder.locked():
        count = len(folder.manifest().inputs)
        if count > MOST:
            for name in (FITS, TABLE):  # what they have is in the parts, and they would be old
                destination(folder.path / name).unlink(missing_ok=True)
        else:
            records = [record for _, record in folder.every()]
            if records:
                _write(folder.path / FITS, json_text(records))
                _write(folder.path / TABLE, flat_csv(records))
        if parquet:
            _write_parquet(folder)


def _write(path: Any, text: str) -> None:
    """Write a file, unless it is so already."""
    there = destination(path)
    if not (there.exists() and there.read_bytes() == text.encode()):
        write_text(path, text)


def check_parquet() -> None:
    """A UsageError if Parquet cannot be written."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise UsageError("--parquet: expected the extra: pip install 'torchbrdf[parquet]'") from None


def _write_parquet(folder: FitFolder) -> None:
    """A column a number, as `fits.csv` has them; a part becomes a group of rows."""
    check_parquet()
    import pyarrow
    from pyarrow import parquet

    kinds: dict[str, pyarrow.DataType] = {}
    for rows in _parts(folder):
        for row in rows:
            for name, value in row.items():
                if value is not None and kinds.get(name) != pyarrow.string():
                    kinds[name] = _wider(kinds.get(name), value)
                kinds.setdefault(name, pyarrow.null())
    schema = pyarrow.schema(list(kinds.items()))
    with replacing(folder.path / PARQUET) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
        for rows in _parts(folder):
            columns = {name: [_as(kind, row.get(name)) for row in rows] for name, kind in kinds.items()}
            writer.write_table(pyarrow.table(columns, schema=schema))


def _parts(folder: FitFolder) -> Iterator[list[dict[str, Any]]]:
    manifest = folder.manifest()
    for part in range(len(manifest.parts)):
        rows = [flat_record(finite(line)) for line in folder.lines(part, manifest)]
        if rows:
            yield rows


def _wider(kind: "pyarrow.DataType | None", value: object) -> "pyarrow.DataType":
    """The type of a column that has a value besides."""
    import pyarrow

    own = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64()}.get(type(value), pyarrow.string())
    if kind is None or kind in (own, pyarrow.null()):
        return own
    numbers = (pyarrow.int64(), pyarrow.float64())
    return pyarrow.float64() if kind in numbers and own in numbers else pyarrow.string()


def _as(kind: "pyarrow.DataType", value: object) -> object:
    import pyarrow

    if value is None:
        return None
    if kind == pyarrow.float64():
        return float(value)  # type: ignore[arg-type]
    return str(value) if kind == pyarrow.string() else value
