"""Result of a rasterization, whichever backend made it."""

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor


class ScreenStatistics:
    """How strongly the loss pulls at the place of each Gaussian in the image.

    Empty until a backward pass has run through the rasterization; several backward passes add up,
    as they do in `Tensor.grad`. Densification divides Gaussians by these numbers.
    """

    def __init__(self) -> None:
        self._grad: Tensor | None = None
        self._absgrad: Tensor | None = None

    @property
    def filled(self) -> bool:
        """Whether a backward pass has run through the rasterization."""
        return self._grad is not None

    @property
    def means2d_grad(self) -> Float[Tensor, "B N 2"]:
        """Gradient of the loss with respect to the projected centres, per pixel of shift.

        Raises:
            RuntimeError: no backward pass has run.
        """
        return _filled(self._grad)

    @property
    def means2d_absgrad(self) -> Float[Tensor, "B N 2"]:
        """The same gradient with the absolute value of every pixel's share, so that none cancel.

        Raises:
            RuntimeError: no backward pass has run.

        Source: Ye et al., "AbsGS", ACM MM 2024.
        """
        return _filled(self._absgrad)

    def add(self, grad: Float[Tensor, "B N 2"], absgrad: Float[Tensor, "B N 2"]) -> None:
        """Add what one backward pass found; called by the backends."""
        self._grad = grad if self._grad is None else self._grad + grad
        self._absgrad = absgrad if self._absgrad is None else self._absgrad + absgrad


@dataclass(frozen=True, kw_only=True)
class Rasterization:
    """B pictures of one set of Gaussians in B poses, or the one that is their mean.

    Attributes:
        image: channel values as they came in, composited over the background.
        alpha: what the Gaussians cover, in [0, 1).
        depth: sum of each Gaussian's weight times its camera depth, metres; divide by `alpha` for
            the mean depth of what is seen. None unless asked for.
        radii: half extent of each Gaussian in the image, pixels; 0 where it was left out (behind
            the camera, outside the image, too faint).
        screen: gradients of the projected centres, after a backward pass.
    """

    image: Float[Tensor, "pictures H W C"]
    alpha: Float[Tensor, "pictures H W"]
    depth: Float[Tensor, "pictures H W"] | None
    radii: Int[Tensor, "B N"]
    screen: ScreenStatistics


def _filled(statistic: Tensor | None) -> Tensor:
    if statistic is None:
        raise RuntimeError(
            "screen statistics are filled by a backward pass, and none has run through this"
            " rasterization; call backward on a loss made from its image, alpha or depth first"
        )
    return statistic
