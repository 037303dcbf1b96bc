"""Averaging space of a frame's light: sRGB values or linear light."""


def check_light(light: str) -> None:
    """Refuse a space in which no camera averages light.

    Raises:
        ValueError: unless it is srgb or linear.
    """
    if light not in ("srgb", "linear"):
        raise ValueError(f"light must be srgb or linear, got {light!r}")
