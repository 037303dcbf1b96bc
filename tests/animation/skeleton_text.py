"""A skeleton's motion as the text of a .bvh file."""

from scipy.spatial.transform import Rotation

from deblur_avatar.animation.driving_motion import SkeletonMotion

ORDER = "ZXY"
PLACES = "Xposition Yposition Zposition"


def bvh(motion: SkeletonMotion) -> str:
    """Positions are written of those joints that have some."""
    order = []

    def lines(joint):
        order.append(joint)
        children = [child for child, parent in enumerate(motion.parents) if parent == joint]
        channels = [PLACES] * (joint in motion.positions) + [f"{axis}rotation" for axis in ORDER]
        names = " ".join(channels).split()
        inner = [line for child in children for line in lines(child)]
        return [
            f"{'JOINT' if joint else 'ROOT'} {motion.names[joint]}", "{",
            "OFFSET " + " ".join(f"{x:.9f}" for x in motion.offsets[joint].tolist()),
            f"CHANNELS {len(names)} {' '.join(names)}",
            *(inner or ["End Site", "{", "OFFSET 0 0 0", "}"]), "}",
        ]  # fmt: skip

    rows = ["HIERARCHY", *lines(0), "MOTION", f"Frames: {len(motion.rotations)}"]
    rows.append(f"Frame Time: {1 / motion.fps:.9f}")
    for frame, rotations in enumerate(motion.rotations):
        values = []
        for joint in order:
            places = motion.positions.get(joint)
            values += [] if places is None else places[frame].tolist()
            values += (
                Rotation.from_matrix(rotations[joint].numpy())
                .as_euler(ORDER, degrees=True)
                .tolist()
            )
        rows.append(" ".join(f"{x:.9f}" for x in values))
    return "\n".join(rows) + "\n"
