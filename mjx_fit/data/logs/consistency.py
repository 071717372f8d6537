"""Does a wrench go with the motion it was felt in? Laws of contact that hold for any peg and any hole.

A map with a wrong sign, a wrong axis or a wrong unit gives numbers that look like any others. But

- an arm that presses pushes along the tool: F_z > 0;
- friction opposes motion, so the arm pushes to where the tool slides: F · v > 0 for each axis of the world;
- the force acts at the peg's lower face, the lever L below the sensor: T_y grows by L with F_x, and T_x by -L
  with F_y;
- a force at a point has no torque about its own line: T · F = 0;
- a tool in contact points down, and its TCP is at the plate or in a hole;
- friction that points everywhere leaves the force along the plate's normal on the mean, which is about that
  of the tool: a socket that leans by 5° changes it by 0.09.

Each is told from all attempts of a log together. On simulated attempts with the peg straight the share of the
lateral force along the motion is 0.5 to 1, and the lever 0.9 to 1.2 L; with a tool that rocks in a leaning
socket, where walls push as well, 0.1 to 0.95 and 0.4 to 1.3 L (72 attempts in three worlds, 2026-12-01). The
force without friction leans by up to 0.17 with the peg straight, and by 0.2 to 0.45 where the tool rocks
(three attempts each). So where beliefs are about upright sockets (``filter.coordinates``), and a log has
three attempts, less is refused than where tools may lean.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from mjx_fit.config.schema import Config
from mjx_fit.data.logs.cutting import TOUCH_N
from mjx_fit.data.logs.findings import Finding
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Felt
from mjx_fit.utils.rates import ACTION_S

LEAST_MPS = 0.002
"""Lowest speed of sliding."""
LEAST_SLIDING = 15
"""Fewest actions of sliding that tell the direction of friction."""
MOST_TILT_RAD = 0.6
WRONG_SHARE = -0.1
"""Share of the lateral force along the motion from which on down an axis has the wrong sign."""
TURNED_RAD, MOST_TURNED_RAD = math.radians(15), math.radians(40)
"""Angle between lateral force and motion that is refused in upright worlds, and in any."""
LEAST_TWIST = -0.3
"""Smallest slope of T_z over what the others say it is; 0.2 to 1 in good logs with the peg straight."""
LEVERS, STRICT_LEVERS = (0.2, 2.2), (0.6, 1.6)
"""Plausible levers, in units of that of the configuration; the latter in upright worlds."""
LEANS, LEANS_TOO_MUCH = 0.25, 0.6
"""Lateral force without friction, as a share of the press: likewise, 14° and 31°."""
ENOUGH_ATTEMPTS = 3
LEAST_PRESS = 0.5
"""Smallest share of the force along the tool, in the median: with a friction of 1.25 it is 0.62."""
ABOVE_M = (-0.03, 0.02)
"""Heights of the TCP above the plate in contact, in the median."""
LEAST_LATERAL_N = 0.5
"""Smallest standard deviation of a lateral force that tells the lever."""


@dataclass(frozen=True)
class Contact:
    """Contact of an attempt, a row for each action in which the peg touches.

    Attributes:
        wrench: Mean wrench on the peg, tared, in the axes of the tool (n, 6).
        samples: All its wrenches (k, 6).
        force_world: Mean force in the axes of the world (n, 3).
        slide_world: Displacement of the TCP in the action, x and y (n, 2), m.
        tilt_rad: Angle between the tool and straight down (n,).
        height_m: Height of the TCP (n,).
    """

    wrench: Float[np.ndarray, "n 6"]
    samples: Float[np.ndarray, "k 6"]
    force_world: Float[np.ndarray, "n 3"]
    slide_world: Float[np.ndarray, "n 2"]
    tilt_rad: Float[np.ndarray, "n"]
    height_m: Float[np.ndarray, "n"]


def inconsistencies(attempts: list[Felt], config: Config) -> list[Finding]:
    """Return what contradicts the laws of contact, over all attempts of a log.

    Args:
        attempts: The attempts, resampled.
        config: Defines the length of the peg, and whether sockets may lean.
    """
    lever_m = config.scene.peg_length_m
    enough = len(attempts) >= ENOUGH_ATTEMPTS
    strict = enough and "roll" not in config.filter.coordinates
    parts = [contact_of(felt) for felt in attempts]
    if not parts:
        return []
    contact = Contact(*(np.concatenate([getattr(one, name) for one in parts]) for name in vars(parts[0])))
    if not len(contact.wrench):
        return [Finding("refused", f"wrench: no contact: no force of {TOUCH_N:g} N in any attempt")]
    found = [
        *_off_the_plate(contact, config),
        *_upside_down(contact),
        *_pulls(contact),
        *_lever(contact, lever_m, STRICT_LEVERS if strict else LEVERS),
    ]
    return [
        *(Finding("refused", text) for text in found),
        *_against_motion(contact, strict),
        *(Finding("refused" if enough else "noted", text) for text in _twisted(contact)),
        *_leaning(contact, enough, strict),
    ]


def contact_of(felt: Felt) -> Contact:
    """Return the contact of an attempt; its first action has no displacement and does not count."""
    n = int(felt.length)
    samples = np.asarray(felt.trace.wrench_sensor, float)[1:n] - np.asarray(felt.tare_sensor, float)
    position = np.asarray(felt.trace.tip_pos_world, float)[:n]
    turns = Rotation.from_quat(np.asarray(felt.trace.tip_quat_world, float)[:n], scalar_first=True)[1:]
    mean = samples.mean(1)
    touches = np.linalg.norm(mean[:, :3], axis=1) > TOUCH_N
    return Contact(
        mean[touches],
        samples[touches].reshape(-1, 6),
        turns.apply(mean[:, :3])[touches],
        np.diff(position[:, :2], axis=0)[touches],
        np.arccos(np.clip(-turns.apply([0.0, 0.0, 1.0])[:, 2], -1, 1))[touches],
        position[1:, 2][touches],
    )


def _off_the_plate(contact: Contact, config: Config) -> list[str]:
    above = float(np.median(contact.height_m)) - plate_top_m(config.scene)
    if ABOVE_M[0] <= above <= ABOVE_M[1]:
        return []
    return [
        f"pose: the TCP is {1000 * above:.0f} mm above the plate in contact: expected "
        f"{1000 * ABOVE_M[0]:.0f} to {1000 * ABOVE_M[1]:.0f}: check pose.tool_in_pose and pose.base_in_world"
    ]


def _upside_down(contact: Contact) -> list[str]:
    tilt = float(np.median(contact.tilt_rad))
    if tilt <= MOST_TILT_RAD:
        return []
    return [
        f"pose: the tool leans by {math.degrees(tilt):.0f}° from straight down in contact: expected at most "
        f"{math.degrees(MOST_TILT_RAD):.0f}°: check pose.rotation, pose.tool_in_pose and pose.base_in_world"
    ]


def _pulls(contact: Contact) -> list[str]:
    press, size = contact.wrench[:, 2], np.linalg.norm(contact.wrench[:, :3], axis=1)
    if np.median(press) <= 0:
        return [
            f"wrench: the arm pulls by {-np.median(press):.1f} N in contact, where it presses: check "
            "wrench.acts_on, wrench.sensor_in_tool and the column of F_z"
        ]
    share = float(np.median(press / size))
    if share >= LEAST_PRESS:
        return []
    return [
        f"wrench: F_z is {share:.2f} of the force in contact: expected at least {LEAST_PRESS}, since the arm "
        "presses: check the columns of the force and wrench.sensor_in_tool"
    ]


def _leaning(contact: Contact, enough: bool, strict: bool) -> list[Finding]:
    """Fit F_xy = N (a + B v/|v|): what is not friction, a, should be small."""
    along, slides = _directions(contact)
    if slides.sum() < LEAST_SLIDING:
        return []
    press = -contact.force_world[slides, 2:]
    parts = np.hstack([press, press * along])
    fitted = np.linalg.lstsq(parts, contact.force_world[slides, :2], rcond=None)[0]
    share = float(np.linalg.norm(fitted[0]))
    if share <= LEANS:
        return []
    text = (
        f"wrench: the force leans by {math.degrees(math.atan(share)):.0f}° from straight up on the mean: "
        "right for a socket that leans or a tool that rocks; otherwise check wrench.sensor_in_tool"
    )
    return [Finding("refused" if strict or (enough and share > LEANS_TOO_MUCH) else "noted", text)]


def _directions(contact: Contact) -> tuple[Float[np.ndarray, "k 2"], Bool[np.ndarray, "n"]]:
    """Return the directions of motion of the actions in which the tool slides, and which these are."""
    speed = np.linalg.norm(contact.slide_world, axis=1) / ACTION_S
    slides = speed > LEAST_MPS
    return contact.slide_world[slides] / (ACTION_S * speed[slides, None]), slides


def _against_motion(contact: Contact, strict: bool) -> list[Finding]:
    """Compare the lateral force with the direction in which the tool slides."""
    along, slides = _directions(contact)
    if slides.sum() < LEAST_SLIDING:
        return []
    # Directions alone: a peg that is caught in a hole pushes hard, and not where it moves.
    force = contact.force_world[slides, :2]
    force = force / (np.linalg.norm(force, axis=1, keepdims=True) + 1e-9)
    shares = (force * along).sum(0) / (np.abs(force * along).sum(0) + 1e-9)
    wrong = [axis for axis, share in zip("xy", shares, strict=True) if share < WRONG_SHARE]
    angle = math.atan2((force[:, 1] * along[:, 0] - force[:, 0] * along[:, 1]).sum(), (force * along).sum())
    if len(wrong) == 1 and abs(angle) < math.pi / 2:
        text = (
            f"wrench: the force along the world's {wrong[0]} opposes the motion: check the sign of that axis"
        )
        return [Finding("refused", text)]
    if abs(angle) <= TURNED_RAD:
        return []
    text = (
        f"wrench: lateral forces point {math.degrees(angle):.0f}° away from the motion that they cause: "
        "check the axes of the sensor (wrench.sensor_in_tool), wrench.acts_on and pose.rotation"
    )
    return [Finding("refused" if strict or abs(angle) > MOST_TURNED_RAD else "noted", text)]


def _twisted(contact: Contact) -> list[str]:
    """Compare T_z with -(T_x F_x + T_y F_y) / F_z."""
    force, torque = contact.wrench[:, :3], contact.wrench[:, 3:]
    pressed = force[:, 2] > TOUCH_N
    said = -(force[:, :2] * torque[:, :2]).sum(1)[pressed] / force[pressed, 2]
    slope = (said * torque[pressed, 2]).sum() / ((said * said).sum() + 1e-12)
    if slope >= LEAST_TWIST:
        return []
    return ["wrench: T_z has the opposite sign of what the other components say: check that of torques"]


def _lever(contact: Contact, lever_m: float, plausible: tuple[float, float]) -> list[str]:
    """Compare torques with the lateral forces that cause them."""
    found = []
    away = contact.samples - contact.samples.mean(0)
    for force, torque, sign, names in ((0, 4, 1, ("F_x", "T_y")), (1, 3, -1, ("F_y", "T_x"))):
        spread = away[:, force].std()
        if spread < LEAST_LATERAL_N:
            continue
        lever = sign * (away[:, force] * away[:, torque]).mean() / spread**2
        if not plausible[0] <= lever / lever_m <= plausible[1]:
            found.append(
                f"wrench: {names[1]} changes with {names[0]} as with a lever of {1000 * lever:.3g} mm: "
                f"expected about {1000 * lever_m:.0f} mm: check wrench.torque, the signs and "
                "wrench.sensor_in_tool"
            )
    return found
