"""How many pictures may be asked for at once."""

from torchbrdf.errors import UsageError

# Of all pictures that are held at once; they take some 50 bytes each.
MOST_PIXELS = 200_000_000


def check_pixels(what: str, pictures: int, size: int) -> None:
    """A UsageError if so many pictures of `size` x `size` pixels are more than memory should be asked for."""
    if pictures * size**2 > MOST_PIXELS:
        raise UsageError(
            f"{what}: expected at most {MOST_PIXELS} pixels in all, found {pictures} pictures of {size} x {size}; "
            "ask for smaller ones, or fewer at once"
        )
