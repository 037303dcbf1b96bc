"""Stage `animate`: the avatar in a motion that it was not filmed in."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.imaging.video_writing import write_video
from deblur_avatar.pipeline.animate import AnimationParams, animate, sheet_of


def main(
    name: str, observations: Path, avatar: Path, fitted: Path, out: Path, params_file: Path
) -> None:
    """Write `<out>/video.mp4` and `<out>/contact_sheet.png` of `animations.<name>`."""
    params = load_params(params_file, f"animations.{name}", AnimationParams)
    with run.stage("animate", name, load_params(params_file, "seed", int)) as context:
        frames = animate(
            Avatar.load(avatar),
            Observations.load(observations),
            Motion.load(fitted),
            params,
            where=f"{params_file}: animations.{name}",
            device=context.device,
            progress=run.progress,
        )
        write_video(out / "video.mp4", frames.numpy(), params.fps)
        write_picture(out / "contact_sheet.png", sheet_of(frames, params.fps))


if __name__ == "__main__":
    run.command(main)
