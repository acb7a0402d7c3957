"""What is done to a valid file: `change(source, data)` gives other bytes, drawn from a `random.Random`."""

from collections.abc import Callable
from random import Random

Change = Callable[[Random, bytes], bytes]
"""Other bytes from those of a valid file; a ValueError where it does not apply to them."""
