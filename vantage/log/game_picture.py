"""One moment of a game as a picture: the arena from above, what the robots see, and what the hider thinks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from schemas import (
    GOAL_COUNT,
    ROBOTS,
    STATE_IMAGE_SIZE,
    Box,
    ColorImage,
    Layout,
    Message,
    Plan,
    Pose,
    Robot,
    StateImage,
)
from vantage.log.appearance import Appearance, Picture, row_repeats, value_picture
from vantage.log.outline import GameOutline, called
from vantage.log.target import optional
from vantage.printable import printable

WIDTH, HEIGHT = 1280, 720
_ARENA = (20, 80, 610)
"""Left, top and side of the arena, px."""
_FINE = 2
"""The arena is drawn so many times as large, for smooth edges."""
_RIGHT = 655
_PICTURE = (295, 222)
_MAP = 193
_SIGHT = 0.40  # m that the field of view is drawn long
_BACKGROUND, _INK, _QUIET = (24, 26, 30), (240, 240, 240), (150, 155, 165)

Place = tuple[float, float]


class GamePicture:
    """Draws the moments of one game in their order; it remembers the robots' paths and the last plan."""

    def __init__(self, game: GameOutline, looks: Appearance) -> None:
        self._image: Any = optional("PIL.Image", "pillow")
        self._draw: Any = optional("PIL.ImageDraw", "pillow")
        fonts: Any = optional("PIL.ImageFont", "pillow")
        self._fonts = {size: fonts.load_default(size) for size in (14, 24)}
        self._game = game
        self._looks = looks
        layout = game.layout or Layout(stamp=0)
        self._scale = _FINE * _ARENA[2] / max(layout.width, layout.depth)
        self._depth = layout.depth
        self._floor = self._empty_arena(layout)
        self._last: dict[Robot, Place] = {}
        self._plan: Plan | None = None
        self._half_view = 0.0

    def draw(self, step: int, seconds: float, messages: Mapping[str, Message]) -> Picture:
        """Return the picture of a step, uint8 [720, 1280, 3].

        Args:
            seconds: since the game's first step.
            messages: key -> message of this step: poses, colours, views and a plan, as far as the log has them.
        """
        if "hider/plan" in messages:
            self._plan = cast(Plan, messages["hider/plan"])
        picture = self._image.new("RGB", (WIDTH, HEIGHT), _BACKGROUND)
        pen = self._draw.Draw(picture)
        self._caption(pen, step, seconds)
        for column, robot in enumerate(ROBOTS):
            left = _RIGHT + column * (_PICTURE[0] + 10)
            self._label(pen, left, 62, f"{robot}'s camera")
            self._place(picture, pen, (left, 80), _PICTURE, self._camera(messages.get(f"{robot}/color")))
            left = _RIGHT + column * (_MAP + 10)
            self._label(pen, left, 338, f"{robot}'s state image")
            self._place(picture, pen, (left, 356), (_MAP, _MAP), self._view(robot, messages.get(f"{robot}/view")))
        left = _RIGHT + 2 * (_MAP + 10)
        self._label(pen, left, 338, "danger of each goal, goal framed")
        values = self._plan.values if self._plan else ()
        shown = value_picture(values, self._plan.goal, self._looks) if self._plan and len(values) == GOAL_COUNT else None
        self._place(picture, pen, (left, 356), (_MAP, _MAP), shown, "no values")
        self._legend(pen)
        picture.paste(self._arena(step, messages), _ARENA[:2])
        return cast(Picture, np.asarray(picture))

    def _caption(self, pen: Any, step: int, seconds: float) -> None:
        said = self._game.episode
        outcome = ""
        if step >= self._game.steps:
            ending = {"caught": f"caught at step {said.caught_step}", "survived": "survived"}
            outcome = "   " + ending.get(said.outcome, said.phase)
        text = f"{called(self._game)}   step {step} of {said.rules.maximum_steps}   {seconds:.2f} s{outcome}"
        pen.text((20, 16), text, fill=_INK, font=self._fonts[24])
        who = f"seed {said.seed}, hider: {said.players.hider}, seeker: {said.players.seeker}, layout: {said.rules.layout}"
        self._label(pen, 20, 56, printable(who, 90))

    def _label(self, pen: Any, x: float, y: float, text: str, color: tuple[int, ...] = _QUIET) -> None:
        pen.text((x, y), text, fill=color, font=self._fonts[14])

    def _legend(self, pen: Any) -> None:
        y = 572
        for name, color in zip(self._looks.palette_names[:-2], self._looks.palette[:-2], strict=True):
            pen.rectangle((_RIGHT, y + 2, _RIGHT + 14, y + 16), fill=tuple(int(part) for part in color), outline=_QUIET)
            self._label(pen, _RIGHT + 24, y, f"state image: {name}")
            y += 22
        meanings = (
            (self._looks.robot_colors["hider"], "hider in every picture; its path, its plan (thin)"),
            (self._looks.robot_colors["seeker"], "seeker in every picture; its path"),
            (tuple(self._looks.danger[0].tolist()), "value map: lowest danger"),
            (tuple(self._looks.danger[-1].tolist()), "value map: highest danger"),
            (self._looks.blocked_color, "value map: blocked"),
        )
        y = 572
        for color, text in meanings:
            pen.rectangle((_RIGHT + 250, y + 2, _RIGHT + 264, y + 16), fill=color, outline=_QUIET)
            self._label(pen, _RIGHT + 274, y, text)
            y += 22

    def _place(
        self,
        picture: Any,
        pen: Any,
        at: tuple[int, int],
        size: tuple[int, int],
        shown: Picture | None,
        lack: str = "not in this log",
    ) -> None:
        """Put pixels into a field, as large as they fit."""
        pen.rectangle((*at, at[0] + size[0] - 1, at[1] + size[1] - 1), outline=(60, 64, 72))
        if shown is None:
            self._label(pen, at[0] + 10, at[1] + size[1] // 2 - 8, lack)
            return
        height, width = shown.shape[:2]
        scale = min(size[0] / width, size[1] / height)
        fit = (max(1, round(width * scale)), max(1, round(height * scale)))
        smaller = self._image.fromarray(shown).resize(fit, self._image.Resampling.NEAREST)
        picture.paste(smaller, (at[0] + (size[0] - fit[0]) // 2, at[1] + (size[1] - fit[1]) // 2))

    def _camera(self, message: Message | None) -> Picture | None:
        if not isinstance(message, ColorImage):
            return None
        self._half_view = math.atan(message.width / 2 / message.intrinsics.fx)
        pixels = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
        return np.repeat(pixels, row_repeats(message.height), axis=0)

    def _view(self, robot: Robot, message: Message | None) -> Picture | None:
        if not isinstance(message, StateImage):
            return None
        indices = np.frombuffer(message.data, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE)
        return self._looks.view_picture(indices, robot)

    def _arena(self, step: int, messages: Mapping[str, Message]) -> Any:
        poses = {robot: cast(Pose, messages[f"{robot}/pose"]) for robot in ROBOTS if f"{robot}/pose" in messages}
        trail = self._draw.Draw(self._floor)
        for robot, pose in poses.items():
            here = self._pixel(pose.x, pose.y)
            if robot in self._last:
                trail.line((self._last[robot], here), fill=self._looks.robot_colors[robot], width=3 * _FINE)
            self._last[robot] = here
        arena = self._floor.copy()
        pen = self._draw.Draw(arena, "RGBA")
        if self._plan is not None:
            self._draw_plan(pen, self._plan, step)
        for robot, pose in poses.items():
            self._draw_robot(pen, robot, pose)
        return arena.resize((_ARENA[2], _ARENA[2]), self._image.Resampling.BOX)

    def _draw_plan(self, pen: Any, plan: Plan, step: int) -> None:
        path: NDArray[np.float32] = np.frombuffer(plan.path, np.float32).reshape(-1, 3)[max(0, step - plan.step) :]
        points = [self._pixel(float(x), float(y)) for x, y, _ in path if math.isfinite(x) and math.isfinite(y)]
        if len(points) > 1:
            pen.line(points, fill=(*self._looks.robot_colors["hider"], 150), width=_FINE)
        if points:
            x, y = points[-1]
            pen.ellipse((x - 8, y - 8, x + 8, y + 8), outline=self._looks.robot_colors["hider"], width=_FINE)

    def _draw_robot(self, pen: Any, robot: Robot, pose: Pose) -> None:
        color, radius = self._looks.robot_colors[robot], self._looks.robot_radius * self._scale
        x, y = self._pixel(pose.x, pose.y)
        if self._half_view:
            reach, turn = _SIGHT * self._scale, -math.degrees(pose.heading)
            half = math.degrees(self._half_view)
            pen.pieslice((x - reach, y - reach, x + reach, y + reach), turn - half, turn + half, fill=(*color, 45))
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color, outline=(20, 20, 20), width=_FINE)
        tip = (x + radius * math.cos(pose.heading), y - radius * math.sin(pose.heading))
        pen.line(((x, y), tip), fill=(20, 20, 20), width=3 * _FINE)

    def _empty_arena(self, layout: Layout) -> Any:
        side = _FINE * _ARENA[2]
        arena = self._image.new("RGB", (side, side), _BACKGROUND)
        pen = self._draw.Draw(arena)
        pen.rectangle((*self._pixel(0.0, layout.depth), *self._pixel(layout.width, 0.0)), fill=self._looks.floor_color)
        for box in layout.obstacles:
            pen.polygon([self._pixel(*corner) for corner in _corners(box)], fill=self._looks.box_color)
        return arena

    def _pixel(self, x: float, y: float) -> Place:
        return x * self._scale, (self._depth - y) * self._scale


def _corners(box: Box) -> list[Place]:
    cosine, sine = math.cos(box.heading), math.sin(box.heading)
    sides = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    spans = [(a * box.half_width, b * box.half_depth) for a, b in sides]
    return [(box.x + a * cosine - b * sine, box.y + a * sine + b * cosine) for a, b in spans]
