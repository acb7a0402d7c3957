"""How much memory pictures may take: one number for all of them."""

from torchbrdf.errors import UsageError

DEFAULT = 2 * 2**30
LEAST = 2**26
_limit = DEFAULT


def memory() -> int:
    """Bytes that the drawing of pictures may take beside the pictures themselves, about.

    Half of them are for the entries of a scene's transport, which are kept between pictures if they fit, the other half
    for values of BRDFs.

    Returns:
        Bytes; 2 GiB, if `set_memory` has said nothing else.
    """
    return _limit


def set_memory(limit: int) -> None:
    """Set how much memory pictures may take, in this process.

    Args:
        limit: Bytes, at least 64 MiB.

    Raises:
        UsageError: It is less.

    Example:
        >>> from torchbrdf.render.memory import DEFAULT, set_memory
        >>> set_memory(DEFAULT)
    """
    global _limit
    if limit < LEAST:
        raise UsageError(f"memory: expected at least {LEAST >> 20} MiB, found {limit >> 20}")
    _limit = int(limit)
