"""What the thrusters that hold the formation are given: see `model.feedback_thrust`."""

from tss_ros.core.model.laws.contract import LawParameter

ROTATION_DAMPING = LawParameter(
    "rotation_damping_n_s_per_m",
    "Thrust of every satellite over its speed against the rigid turn", "N s/m",
    minimum=0.0, maximum=1e3, default=0.0, note="0 is none",
)  # fmt: skip
SHAPE_KEEPING = LawParameter(
    "shape_keeping_n_per_m",
    "Thrust of every satellite over its distance from its place in the steady shape", "N/m",
    minimum=0.0, maximum=1e3, default=0.0, note="0 is none",
)  # fmt: skip
THRUST_LIMIT = LawParameter(
    "thrust_limit_n", "Most that the feedback lets a satellite thrust", "N",
    minimum=0.0, maximum=1e6, default=0.0, note="0 is no limit",
)  # fmt: skip
PARAMETERS = (ROTATION_DAMPING, SHAPE_KEEPING, THRUST_LIMIT)
