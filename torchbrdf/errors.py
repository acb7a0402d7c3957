"""What torchbrdf raises: every message says what, where, expected and found, in one line."""


class TorchbrdfError(Exception):
    """Base of everything that torchbrdf raises on purpose; the command line prints it without a traceback."""


class ShapeError(TorchbrdfError, ValueError):
    """Tensors whose shapes, dtypes or contents do not fit together."""


class DataError(TorchbrdfError, ValueError):
    """A file or a folder that does not hold what it should."""


class UsageError(TorchbrdfError, ValueError):
    """A name, an option or a setting that does not exist or has a wrong type."""
