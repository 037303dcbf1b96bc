"""Averaging space of a frame's light: sRGB values or linear light."""


def check_averaging_space(averaging_space: str) -> None:
    """Refuse a space in which no camera averages light.

    Raises:
        ValueError: unless it is srgb or linear.
    """
    if averaging_space not in ("srgb", "linear"):
        raise ValueError(f"averaging_space must be srgb or linear, got {averaging_space!r}")
