"""Quantities: the numbers that limits of the stress suite are about.

Conventions. Scores are PSNR over the seen surface, dB. "Agnostic" is `agnostic` at the same
severity with the same avatar: what ignoring blur makes of it.
"""

from benchmarks.stress.checks import AGNOSTIC, Case, Quantity, Row, Where, minus, ratio
from deblur_avatar.evaluation.metrics import metric
from deblur_avatar.evaluation.recovery import recovery, share_won_back

SCORE = metric("psnr_seen")  # its floor is the cost of blur from which on recovery means anything


# --- where limits apply --------------------------------------------------------------------------


def deblurs(case: Case) -> bool:
    """Methods that claim to undo blur: all but `agnostic`."""
    return case.method != AGNOSTIC


def damaged_by(name: str) -> Where:
    """Severities that do this damage."""
    return lambda case: name in case.severity.damage


def measured(key: str) -> Where:
    """Methods that have such a number."""
    return lambda case: case.row.get(key) is not None


def compared(case: Case) -> bool:
    """Severities that something came before."""
    return bool(case.before)


def all_of(*conditions: Where) -> Where:
    """Where all of these apply."""
    return lambda case: all(condition(case) for condition in conditions)


def none_of(*conditions: Where) -> Where:
    """Where none of these applies."""
    return lambda case: not any(condition(case) for condition in conditions)


# --- recovery ------------------------------------------------------------------------------------


def has_oracle(case: Case) -> bool:
    """Whether the severity was measured on sharp frames, too.

    Raises:
        KeyError: if it should have been, but was not: no rule may pass for want of a measurement.
    """
    if "no_oracle" in case.severity.fit or case.agnostic.get("score") is None:
        return False
    return "score" in case.agnostic["oracle"]


def blur_costs(case: Case) -> bool:
    """A method that claims to deblur, where blur costs what the project's floor says, or more."""
    if not deblurs(case) or not has_oracle(case):
        return False
    floor, oracle = case.agnostic["score"], case.agnostic["oracle"]["score"]
    return case.score is not None and recovery(floor, floor, oracle, SCORE) is not None


def _bound(case: Case) -> float | None:
    """The better of agnostic's recipe and the method's own on sharp frames and the same poses."""
    bounds = [row["oracle"]["score"] for row in (case.agnostic, case.row) if "oracle" in row]
    return max(bounds, default=None)


def _recovered(case: Case) -> float | None:
    return share_won_back(case.score, case.agnostic.get("score"), _bound(case))


def _recovered_of_ceiling(case: Case) -> float | None:
    return share_won_back(case.score, case.agnostic.get("score"), case.ceiling["score"])


RECOVERY = Quantity("recovery", _recovered)
RECOVERY_OF_CEILING = Quantity("recovery against the ceiling", _recovered_of_ceiling)


# --- scores --------------------------------------------------------------------------------------


def _above_agnostic(what: str, key: str) -> Quantity:
    return Quantity(
        f"{what} minus agnostic's", lambda case: minus(case.row.get(key), case.agnostic.get(key))
    )


ABOVE_AGNOSTIC = _above_agnostic("score", "score")
ALL_ABOVE_AGNOSTIC = _above_agnostic("PSNR, the unseen side too,", "psnr")
LIMBS_ABOVE_AGNOSTIC = _above_agnostic("limbs", "psnr_limbs")
TORSO_ABOVE_AGNOSTIC = _above_agnostic("torso", "psnr_torso")
NOVEL_POSE_ABOVE_AGNOSTIC = _above_agnostic("novel poses", "score_novel_pose")


def _gap(row: Row, ceiling: Row, key: str = "score") -> float | None:
    return minus(ceiling.get(key), row.get(key))


LOST = Quantity(
    "dB further below the ceiling than on the clean scene",
    lambda case: minus(_gap(case.row, case.ceiling), _gap(case.clean, case.clean_ceiling)),
)
BELOW_CEILING = Quantity("dB below the ceiling", lambda case: _gap(case.row, case.ceiling))
TORSO_BELOW_CEILING = Quantity(
    "dB of the torso below the ceiling", lambda case: _gap(case.row, case.ceiling, "psnr_torso")
)
GAIN_FROM_MORE_BLUR = Quantity(
    "dB gained by more blur", lambda case: minus(case.score, case.before[-1].get("score"))
)
APART_FROM_CLEAN = Quantity(
    "dB apart from the clean scene", lambda case: minus(case.score, case.clean.get("score"))
)
LOST_AT_EQUAL_BUDGET = Quantity(
    "dB lost against the right shutter in as many iterations",
    lambda case: minus(case.before[0].get("score"), case.score),
)
GAIN_FROM_TRAINING = Quantity(
    "dB gained by twice the training", lambda case: minus(case.score, case.before[-1].get("score"))
)

LOST_BY_TRAINING = Quantity(
    "dB lost by twice the training", lambda case: minus(case.before[-1].get("score"), case.score)
)


# --- poses and motion ----------------------------------------------------------------------------

JOINT_ERROR = Quantity("joint error, mm,", lambda case: case.row.get("joint_error_mm"))
JOINT_ERROR_KEPT = Quantity(
    "joint error, as a share of what fitting started from,",
    lambda case: ratio(case.row.get("joint_error_mm"), case.row.get("initial_joint_error_mm")),
)
JOINT_ERROR_GROWN = Quantity(
    "joint error, as a share of the clean scene's,",
    lambda case: ratio(case.row.get("joint_error_mm"), case.clean.get("joint_error_mm")),
)
TRAVEL_ERROR = Quantity(
    "error of travel, as a share of standing still's,",
    lambda case: ratio(case.row.get("travel_error_mm"), case.agnostic.get("travel_error_mm")),
)
RIGHT_WAY = Quantity(
    "share of joints that go the right way", lambda case: case.row.get("direction_accuracy")
)
KNOTS_BEYOND_FRAMES = Quantity(
    "knots of the trajectory beyond one a frame",
    lambda case: minus(case.row.get("knots"), case.amount),
)
VIRTUAL_POSES = Quantity("virtual poses", lambda case: case.row.get("virtual_poses"))
MORE_VIRTUAL_POSES = Quantity(
    "virtual poses more than for little blur",
    lambda case: minus(case.row.get("virtual_poses"), case.before[0].get("virtual_poses")),
)


def _shutter_share(case: Case) -> float | None:
    true = ratio(case.row.get("given_exposure_s"), case.severity.damage["shutter_times"])
    return ratio(case.row.get("shutter_s"), true)


SHUTTER = Quantity("estimated shutter over the true one", _shutter_share)
SHUTTER_DEVIATION = Quantity(
    "its standard deviation, as it says itself, over it",
    lambda case: ratio(case.row.get("shutter_std_s"), case.row.get("shutter_s")),
)


# --- what the avatar is made of, and what it cost -------------------------------------------------


def _over_ceiling(what: str, key: str) -> Quantity:
    return Quantity(
        f"{what} over the ceiling's", lambda case: ratio(case.row.get(key), case.ceiling.get(key))
    )


WIDTH = _over_ceiling("mean width of Gaussians", "mean_scale_mm")
SHARPNESS = _over_ceiling("sharpness", "sharpness")
AREA = Quantity("silhouette's area, share too large,", lambda case: case.row.get("area_error"))
STRETCH = Quantity("growth of a Gaussian", lambda case: case.row.get("stretch"))
MORE_HIDDEN = Quantity(
    "share told to be hidden, beyond the clean scene's,",
    lambda case: minus(case.row.get("hidden"), case.clean.get("hidden")),
)
GAUSSIANS = Quantity(
    "times the Gaussians",
    lambda case: ratio(case.row.get("gaussians"), case.before[-1].get("gaussians")),
)
TIME = Quantity(
    "processor time of fitting over agnostic's",
    lambda case: ratio(case.row.get("processor_s"), case.agnostic.get("processor_s")),
)
BLEND = Quantity("mean share of the averaged render", lambda case: case.row.get("blend_mean"))
BLEND_WHERE_BLURRED = Quantity(
    "correlation of the averaged render's share with the true blur",
    lambda case: case.row.get("blend_correlation"),
)
SHARED_CONDITION = Quantity(
    "dB that re-blurred frames gain by one condition an exposure",
    lambda case: case.row.get("shared_condition_db"),
)
