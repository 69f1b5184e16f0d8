"""Satellites and tether beads as the entities of simulation_interfaces: which, what and where.

Entities are points in the orbit frame. They have no attitude, and their accelerations follow from
the forces.
"""

import re
from collections.abc import Iterable

import numpy as np
import re2
from geometry_msgs.msg import Quaternion, Vector3
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    EntityInfo,
    EntityState,
    TagsFilter,
)
from simulation_interfaces.srv import SetEntityState
from std_msgs.msg import Header

from tss_ros.core import System, TssError
from tss_ros.ros.messages import stamp
from tss_ros.simulator.control import Code, Refused
from tss_ros.simulator.simulation import Simulation

#: Largest component of a position [m] and of a velocity [m/s] that an entity may be given.
MAX_POSITION_M, MAX_VELOCITY_M_S = 1e6, 1e4
#: Longest regular expression, and most memory [B] for it.
MAX_FILTER, MAX_FILTER_BYTES = 1000, 2**20
#: How far a component of an orientation may be from the identity's.
ROUNDING = 1e-6
#: The tags of an entity.
SATELLITE, TETHER_BEAD = "satellite", "tether_bead"
CATEGORY = EntityCategory.CATEGORY_DYNAMIC_OBJECT
INVALID_POSE = SetEntityState.Response.INVALID_POSE


def find(system: System, name: str) -> int:
    """Index of the entity of this name.

    Raises
    ------
    Refused
        If there is none.
    """
    if name not in system.bead_name:
        raise Refused(
            Code.NOT_FOUND,
            f"{name!r:.80} does not exist; there are {', '.join(system.bead_name):.200}",
        )
    return system.bead_name.index(name)


def matching(system: System, position_m: np.ndarray, filters: EntityFilters) -> list[int]:
    """Indices of the entities that fit all filters.

    Raises
    ------
    Refused
        If a filter is not possible here.
    TssError
        If a filter is wrong.
    """
    wanted = _inside(position_m, filters.bounds)
    categories = {category.category for category in filters.categories}
    if unknown := categories - _values(EntityCategory, "CATEGORY_"):
        raise TssError(f"category is {min(unknown)}; allowed: the values of EntityCategory")
    if categories and CATEGORY not in categories:
        wanted = np.zeros_like(wanted)
    tagged = _tagged(filters.tags)
    named = _named(filters.filter, system.bead_name)
    return [
        i
        for i, is_satellite in enumerate(system.is_satellite)
        if wanted[i] and named[i] and tagged(_tag(is_satellite))
    ]


def info(system: System, index: int) -> EntityInfo:
    """What an entity is, as a message."""
    ends = system.tether_ends
    tethers = [system.tether_name[k] for k in np.flatnonzero((ends == index).any(axis=1))]
    tag = _tag(system.is_satellite[index])
    return EntityInfo(
        category=EntityCategory(category=CATEGORY),
        description=f"{tag.replace('_', ' ')} of {system.mass_kg[index]:g} kg on "
        f"{', '.join(tethers) or 'no tether'}",
        tags=[tag],
    )


def states(simulation: Simulation, indices: Iterable[int], frame_id: str) -> list[EntityState]:
    """States of entities, as messages."""
    sample = simulation.newest
    r, v, a = sample.position_m, sample.velocity_m_s, simulation.acceleration_m_s2
    messages = []
    for i in indices:
        state = EntityState(header=Header(stamp=stamp(sample.time_ns), frame_id=frame_id))
        for vector, values in (
            (state.pose.position, r[i]),
            (state.twist.linear, v[i]),
            (state.acceleration.linear, a[i]),
        ):
            vector.x, vector.y, vector.z = values.tolist()
        messages.append(state)
    return messages


def read_state(state: EntityState, frame_id: str) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and velocity [m/s] that an entity is to have.

    Raises
    ------
    Refused
        If the pose is not possible.
    TssError
        If the frame or the twist is not.
    """
    if state.header.frame_id not in ("", frame_id):
        raise TssError(
            f"frame_id is {state.header.frame_id!r:.80}; allowed: {frame_id!r}, or '' for the same"
        )
    turn = state.pose.orientation
    if not _is_identity(turn):
        raise Refused(
            INVALID_POSE,
            f"orientation is {[turn.x, turn.y, turn.z, turn.w]}; allowed: [0, 0, 0, 1], for beads "
            "have no attitude",
        )
    if any(_numbers(state.twist.angular)):
        raise TssError(
            f"angular velocity is {_numbers(state.twist.angular)}; allowed: 0, for beads have no "
            "attitude"
        )
    position_m, velocity_m_s = _numbers(state.pose.position), _numbers(state.twist.linear)
    _check_size("position", position_m, MAX_POSITION_M, INVALID_POSE)
    _check_size("velocity", velocity_m_s, MAX_VELOCITY_M_S, Code.OPERATION_FAILED)
    return np.array(position_m), np.array(velocity_m_s)


def _tag(is_satellite):
    return SATELLITE if is_satellite else TETHER_BEAD


def _values(kind, prefix):
    return {getattr(kind, name) for name in dir(kind) if name.startswith(prefix)}


def _numbers(vector: Vector3) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _is_identity(turn: Quaternion) -> bool:
    far = max(abs(turn.x), abs(turn.y), abs(turn.z), abs(abs(turn.w) - 1.0))
    return far <= ROUNDING and turn.w == turn.w


def _check_size(name, values, limit, code):
    if not all(abs(value) <= limit for value in values):
        raise Refused(code, f"{name} is {values}; allowed: -{limit:g} to {limit:g} in each")


def _inside(position_m, bounds):
    """Which points are in a volume."""
    points = np.array([_numbers(point) for point in bounds.points]).reshape(-1, 3)
    if bounds.type == Bounds.TYPE_CONVEX_HULL:
        raise Refused(
            Code.FEATURE_UNSUPPORTED, "bounds are a convex hull; allowed: none, a box, a sphere"
        )
    if bounds.type not in _values(Bounds, "TYPE_"):
        raise TssError(f"type of bounds is {bounds.type}; allowed: the values of Bounds")
    wanted = 0 if bounds.type == Bounds.TYPE_EMPTY else 2
    if len(points) != wanted:
        raise TssError(f"bounds have {len(points)} points; allowed for this type: {wanted}")
    if np.isnan(points).any():
        raise TssError(f"points of bounds are {points.tolist()}; allowed: numbers")
    if bounds.type == Bounds.TYPE_EMPTY:
        return np.ones(len(position_m), bool)
    if bounds.type == Bounds.TYPE_BOX:
        low, high = points.min(axis=0), points.max(axis=0)
        return ((low <= position_m) & (position_m <= high)).all(axis=1)
    centre, radius = points[0], points[1, 0]
    if not np.isfinite(centre).all() or radius < 0.0:
        raise TssError(f"sphere of bounds is {points.tolist()}; allowed: a centre, a radius from 0")
    return np.linalg.norm(position_m - centre, axis=1) <= radius


def _tagged(tags):
    """Whether a tag is wanted, as a function."""
    if tags.filter_mode not in (TagsFilter.FILTER_MODE_ANY, TagsFilter.FILTER_MODE_ALL):
        raise TssError(f"filter_mode is {tags.filter_mode}; allowed: 0 (any) and 1 (all)")
    if not tags.tags:
        return lambda _: True
    if tags.filter_mode == TagsFilter.FILTER_MODE_ALL:
        return lambda tag: set(tags.tags) == {tag}
    return lambda tag: tag in tags.tags


def _named(expression, names):
    """Which names a POSIX extended regular expression is found in, in time linear in both."""
    if not expression:
        return [True] * len(names)
    options = re2.Options()
    options.posix_syntax = options.longest_match = True
    options.log_errors = False
    options.max_mem = MAX_FILTER_BYTES
    try:
        if len(expression) > MAX_FILTER:
            raise re2.error(f"longer than {MAX_FILTER} characters")
        pattern = re2.compile(expression, options)
    except (re2.error, re.error) as error:
        reason = error.args[0].decode() if isinstance(error.args[0], bytes) else error.args[0]
        raise TssError(
            f"filter is {expression!r:.80}: {reason}; allowed: a POSIX extended regular expression"
        ) from None
    return [pattern.search(name) is not None for name in names]
