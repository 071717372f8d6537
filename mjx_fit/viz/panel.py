"""Panel next to the robot: current hole, belief about each hole, and measured force."""

from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from mjx_fit.evaluation.recording import Recording, Step
from mjx_fit.types import Rollout
from mjx_fit.utils.rates import SUBSTEPS
from mjx_fit.utils.type_colours import TYPE_RGB
from mjx_fit.viz.timeline import ACTIONS_PER_S, Moment

WIDTH_SHARE = 0.36
"""Share of the frame's width."""

_INK, _FAINT, _LINE, _PAPER, _CHOSEN = "#1b1b1b", "#6a6a6a", "#d4d4d4", "#ffffff", "#eef3f8"
_FORCES = (("x", "#56B4E9"), ("y", "#CC79A7"), ("z", "#1b1b1b"))
_EVERY = 10
"""Stride over force samples; drawn at 50 Hz."""


MOST_SHOWN, MOST_LETTERS = 3, 11
"""Most types shown per belief, and most letters per type name."""
ROW = 13
"""Height of a line of small text."""
LIGHT = 0.7
"""Brightness above which a colour is illegible as text on white."""


class Panel:
    """Draw the panel of one recording."""

    def __init__(self, recording: Recording, width: int, height: int):
        self._recording, self._size = recording, (width, height)
        self._unit, self._names = height / 720, recording.config.scene.names
        self._fonts: dict[int, Any] = {}
        self._force = [_force(step) for step in recording.steps]
        every = np.concatenate([np.array([[-1.0] * 3, [1.0] * 3]), *self._force])
        self._low, self._high = float(every.min()), float(every.max())

    def draw(self, moment: Moment) -> UInt8[np.ndarray, "h w 3"]:
        """Draw the panel at a moment."""
        image = Image.new("RGB", self._size, _PAPER)
        draw = ImageDraw.Draw(image)
        self._head(draw, moment)
        top = self._holes(draw, moment, 150)
        self._forces(draw, moment, top + 30)
        return np.asarray(image)

    def words(self, moment: Moment) -> list[tuple[str, str]]:
        """Return the panel without the force, as pairs of a label and its value."""
        step, belief = self._recording.steps[moment.step], moment.belief
        peg = f"peg {step.peg + 1} of {len(self._recording.peg_type)}"
        said = [(peg, self._names[self._recording.peg_type[step.peg]])]
        said.append((f"attempt {step.attempt}", self._doing(moment, step)))
        for hole, filled in enumerate(moment.filled):
            chances = np.exp(belief.type_logp[hole])
            kinds = _shown(chances)
            believed = ", ".join(f"{self._names[kind]} {chances[kind]:.0%}" for kind in kinds)
            if len(kinds) < len(chances):
                believed += f", others {1 - chances[kinds].sum():.0%}"
            if yaw := self._yaw(moment, hole):
                believed += f", {yaw}"
            said.append((f"hole {hole + 1}", "filled" if filled else believed))
        return said

    def label(self, image: UInt8[np.ndarray, "h w 3"], places: list[tuple[float, float]], chosen: int):
        """Draw the hole numbers on an image, with the chosen one dark."""
        shown = Image.fromarray(image)
        draw = ImageDraw.Draw(shown)
        for hole, (x, y) in enumerate(places):
            r = 13 * self._unit
            ink, paper = (_PAPER, _INK) if hole == chosen else (_INK, _PAPER)
            draw.ellipse((x - r, y - r, x + r, y + r), fill=paper, outline=_INK)
            draw.text((x, y), str(hole + 1), ink, self._font(17), anchor="mm")
        return np.asarray(shown)

    def _head(self, draw: ImageDraw.ImageDraw, moment: Moment) -> None:
        recording, step = self._recording, self._recording.steps[moment.step]
        peg = self._names[recording.peg_type[step.peg]]
        self._text(draw, 24, 24, f"{recording.method.replace('_', ' ')}, trial {recording.trial}", 26)
        colour = _ink(recording.peg_type[step.peg])
        done = f"peg {step.peg + 1} of {len(recording.peg_type)}: "
        self._text(draw, 24, 62, done, 20)
        self._text(draw, 24 + self._width(done, 20), 62, peg, 20, colour)
        self._text(draw, 24, 92, f"attempt {step.attempt}: {self._doing(moment, step)}", 17, _FAINT)
        self._text(draw, 24, 114, f"attempt {step.number} of the assembly", 17, _FAINT)

    def _doing(self, moment: Moment, step: Step) -> str:
        if moment.phase == "move":
            return f"moves to hole {step.hole + 1}"
        if moment.phase == "attempt":
            return f"tries hole {step.hole + 1}"
        if step.rollout.taken:
            return f"{_outcome(step.rollout)} into hole {step.hole + 1}"
        if step.helped is not None:
            return f"failed; human intervention at hole {step.helped + 1}"
        if not step.rollout.truth.valid:
            return "simulation diverged; no belief update"
        return "failed; updates the belief"

    def _holes(self, draw: ImageDraw.ImageDraw, moment: Moment, top: float) -> float:
        """Draw a line for each hole; return the y coordinate below the last one."""
        n = len(moment.filled)
        each = min(64.0, 340 / n)
        self._text(draw, 60, top, "type belief", 15, _FAINT)
        self._text(draw, 300, top, "position ± std", 15, _FAINT)
        top += 24
        for hole in range(n):
            y = top + hole * each
            if hole == self._recording.steps[moment.step].hole:
                self._box(draw, (12, y, self._size[0] / self._unit - 12, y + each - 4), _CHOSEN)
            middle = y + (each - 4) / 2
            self._text(draw, 36, middle, str(hole + 1), 20, anchor="mm")
            if moment.filled[hole]:
                kind = int(moment.content[hole])
                self._text(draw, 60, middle, f"filled: {self._names[kind]}", 17, _ink(kind), anchor="lm")
                continue
            self._bars(draw, np.exp(moment.belief.type_logp[hole]), y + 5, each - 14)
            spread, yaw = 1000 * np.sqrt(np.trace(moment.belief.pos_cov[hole]) / 2), self._yaw(moment, hole)
            self._text(draw, 300, middle - (8 if yaw else 0), f"± {spread:.1f} mm", 17, anchor="lm")
            self._text(draw, 300, middle + 10, yaw, 13, _FAINT, anchor="lm")
        return top + n * each

    def _yaw(self, moment: Moment, hole: int) -> str:
        """Return the believed yaw of a hole with its standard deviation; empty if none is believed."""
        names = self._recording.config.filter.coordinates
        if "yaw" not in names:
            return ""
        at = names.index("yaw")
        mean = np.rad2deg(moment.belief.mean_world[hole][at])
        return f"yaw {mean:.0f} ± {np.rad2deg(np.sqrt(moment.belief.cov[hole][at, at])):.0f}°"

    def _bars(self, draw: ImageDraw.ImageDraw, chance: Float[np.ndarray, "C"], y: float, room: float) -> None:
        kinds = _shown(chance, int(room // ROW))
        each = room / len(kinds)
        for place, kind in enumerate(kinds):
            line = y + place * each
            self._box(draw, (60, line + 1, 150 + 60, line + each - 1), "#f0f0f0")
            self._box(draw, (60, line + 1, 60 + 150 * float(chance[kind]), line + each - 1), _hex(kind))
            name = self._names[kind]
            name = name if len(name) <= MOST_LETTERS else f"{name[: MOST_LETTERS - 2]}.."
            self._text(draw, 218, line + each / 2, name, 13, _FAINT, anchor="lm")

    def _forces(self, draw: ImageDraw.ImageDraw, moment: Moment, top: float) -> None:
        """Draw the tared force so far, in the sensor frame; the axis spans the longest attempt."""
        step = self._recording.steps[moment.step]
        right, bottom = self._size[0] / self._unit - 34, 720.0 - 46
        left, ceiling = 64.0, top + 26

        def height(newtons):
            return bottom - (newtons - self._low) / (self._high - self._low) * (bottom - ceiling)

        self._text(draw, 24, top - 4, "F/T sensor: force, N", 15, _FAINT)
        for place, (axis, colour) in enumerate(_FORCES):
            self._text(draw, right - 90 + 34 * place, top - 4, axis, 17, colour)
        for level in self._levels():
            self._line(draw, [(left, height(level)), (right, height(level))], _LINE, 1)
            self._text(draw, left - 6, height(level), f"{level:g}", 13, _FAINT, anchor="rm")
        actions = self._recording.config.task.attempt_actions
        for second in range(0, actions // ACTIONS_PER_S + 1, 5):
            x = left + (right - left) * second * ACTIONS_PER_S / actions
            self._text(draw, x, bottom + 8, f"{second} s", 13, _FAINT, anchor="ma")
        if moment.phase == "move":
            return
        force = self._force[moment.step][: max(2, int(moment.actions * SUBSTEPS / _EVERY))]
        if not len(force):
            return
        x = left + (right - left) * np.arange(len(force)) * _EVERY / SUBSTEPS / actions
        for (_, colour), values in zip(_FORCES, force.T, strict=True):
            self._line(draw, list(zip(x.tolist(), height(values).tolist(), strict=True)), colour, 2)
        if step.rollout.taken and moment.phase == "learn":
            self._line(draw, [(x[-1], ceiling), (x[-1], bottom)], "#0072B2", 2)

    def _levels(self) -> list[float]:
        """Return about three round force values within the range."""
        nice = [step * 10.0**power for power in range(6) for step in (1, 2, 5)]
        each = next(step for step in nice if step >= (self._high - self._low) / 4)
        first = int(np.ceil(self._low / each))
        return [each * k for k in range(first, int(self._high / each) + 1)]

    def _text(
        self, draw, x: float, y: float, words: str, size: int, ink: str = _INK, anchor: str = "la"
    ) -> None:
        draw.text((x * self._unit, y * self._unit), words, ink, self._font(size), anchor=anchor)

    def _width(self, words: str, size: int) -> float:
        return self._font(size).getlength(words) / self._unit

    def _box(self, draw, corners: tuple[float, float, float, float], fill: str) -> None:
        draw.rectangle([x * self._unit for x in corners], fill)

    def _line(self, draw, points: list[tuple[float, float]], ink: str, width: int) -> None:
        scaled = [(x * self._unit, y * self._unit) for x, y in points]
        draw.line(scaled, ink, max(1, round(width * self._unit)), joint="curve")

    def _font(self, size: int):
        if size not in self._fonts:
            self._fonts[size] = ImageFont.load_default(size * self._unit)
        return self._fonts[size]


def _shown(chance: Float[np.ndarray, "C"], most: int = MOST_SHOWN) -> list[int]:
    """Return the types shown of a belief: all if few, otherwise the most likely, in descending order."""
    if len(chance) <= MOST_SHOWN:
        return list(range(len(chance)))
    return np.argsort(-chance, kind="stable")[: min(most, MOST_SHOWN)].tolist()


def _force(step: Step) -> Float[np.ndarray, "samples 3"]:
    """Return the tared force without noise, in the sensor frame."""
    rollout = step.rollout
    wrench = (
        np.asarray(rollout.felt.trace.wrench_sensor)[: int(rollout.felt.length)] - rollout.felt.tare_sensor
    )
    force = wrench.reshape(-1, 6)[::_EVERY, :3]
    # The last sample of a diverged simulation is not a force.
    return force if rollout.truth.valid else force[: -(SUBSTEPS // _EVERY)]


def _hex(kind: int, shade: float = 1.0) -> str:
    return "#" + "".join(f"{round(255 * shade * channel):02x}" for channel in TYPE_RGB[kind])


def _ink(kind: int) -> str:
    """Return the colour of a type for text on white; light colours are darkened."""
    red, green, blue = TYPE_RGB[kind]
    return _hex(kind, 0.6 if 0.3 * red + 0.6 * green + 0.1 * blue > LIGHT else 1.0)


def _outcome(rollout: Rollout) -> str:
    """Return what happened to a peg that the robot takes for inserted."""
    if not rollout.truth.inserted:
        return "taken for inserted"
    return "inserted wrongly" if rollout.inserted_wrongly else "inserted"
