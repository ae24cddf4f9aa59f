"""What the `vantage table` commands may be told: their options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from schemas import Robot

Paper = Literal["a4", "letter"]


@dataclass(frozen=True)
class Camera:
    """Where pictures come from."""

    source: str
    """A camera (0, 1, /dev/video0), a picture, a folder of pictures or a video. A turn that EXIF asks for is not made."""
    width: int = 1280
    """Pixels asked of a camera: the resolution that the tracker will use."""
    height: int = 720
    """Pixels asked of a camera."""
    rate: float = 30.0
    """Frames a second asked of a camera: as the tracker will."""
    fourcc: str = "MJPG"
    """Pixel format asked of a camera, four letters: as the tracker will."""

    @property
    def mode(self) -> tuple[int, int, float, str]:
        """Width, height, rate and format asked of a camera."""
        return self.width, self.height, self.rate, self.fourcc


@dataclass(frozen=True)
class Print:
    """Write what a lab prints: tags of robots, boxes and corners, the ChArUco board, a ruler that checks the printer.

    Everything is at true scale: print at 100 % ("actual size"), and measure the ruler's page before you cut anything.

    Examples:
        vantage table print --to prints/
        vantage table print --to prints/ --paper letter --table table.json
    """

    to: Path = Path("prints")
    """Folder for the PDFs."""
    table: Path | None = None
    """Your table's file; without it the default table, whose file is written beside the PDFs for you to change."""
    paper: Paper = "a4"
    """Paper in the printer."""


@dataclass(frozen=True)
class CalibrateLens(Camera):
    """Measure the overhead camera's lens from pictures of the ChArUco board of `vantage table print`.

    With a camera: hold the board before it, here and there, tilted this way and that, still for a moment each time; the line
    on the screen says what is missing, and the command ends by itself. At the resolution and focus that games will use.

    Examples:
        vantage table calibrate lens --source 0
        vantage table calibrate lens --source board-pictures/ --to lens.json
    """

    to: Path = Path("lens.json")
    """File for the lens (a former one is kept under a dated name); a picture of where the board was seen is written beside it."""
    seconds: float = 180.0
    """A camera is looked at no longer than this."""


@dataclass(frozen=True)
class CalibrateArena(Camera):
    """Find where the overhead camera hangs, from one picture of the corner tags.

    Do it again whenever the camera or a corner tag may have moved; it takes some seconds.

    Examples:
        vantage table calibrate arena --source 0 --table table.json --lens lens.json
        vantage table calibrate arena --source table.png --to overhead.json
    """

    table: Path = Path("table.json")
    """Your table's file: where the corner tags lie, measured with a steel rule."""
    lens: Path = Path("lens.json")
    """What `vantage table calibrate lens` wrote."""
    to: Path = Path("overhead.json")
    """File for the calibration, which the tracker reads (a former one is kept, dated); an annotated picture is written
    beside it."""


@dataclass(frozen=True)
class CalibrateRobot:
    """Write down a robot's RGB-D camera: lenses as its maker measured them, height and tilt from the floor that it sees.

    Put the robot on the table with half a metre of free floor before it. Afterwards: `vantage table colors`.

    Examples:
        vantage table calibrate robot --robot hider --source realsense:0123
        vantage table calibrate robot --robot seeker --source floor.npz --lenses hider.json --forward 0.02
    """

    robot: Robot
    """Whose camera it is."""
    source: str = "realsense"
    """`realsense`, `realsense:SERIAL`, or a recorded depth picture (*.npz with an array `depth`, or a 16-bit PNG)."""
    lenses: Path | None = None
    """Of a recorded picture: a robot's file with the lenses of its camera; default those of the rehearsal."""
    forward: float = 0.0
    """Depth lens ahead of the robot's centre (middle of its axle), m."""
    left: float = 0.0
    """Depth lens to the left of the robot's centre, m."""
    width: int = 640
    """Pixels asked of a camera: what the tracker will use."""
    height: int = 480
    """Pixels asked of a camera."""
    to: Path | None = None
    """The robot's file; default hider.json or seeker.json. Its colour correction stays as it was."""


@dataclass(frozen=True)
class Colors(Camera):
    """Measure the robots' colours as one robot's camera sees them, so that it knows the other robot under your lamps.

    Put both robots and something grey (a sheet of grey paper) before the camera, where games are played. Places are pixels of the
    picture: `x,y` for a point on the surface, `x,y,width,height` for a part of it. Without them, the picture is only saved, for
    you to read the pixels from.

    Examples:
        vantage table colors --robot hider --source 2
        vantage table colors --robot hider --source hider.png --hider 210,260 --seeker 410,255,30,40 --grey 320,300
    """

    robot: Robot = "hider"
    """Whose camera it is."""
    hider: str = ""
    """Where the hider's colour is."""
    seeker: str = ""
    """Where the seeker's colour is."""
    grey: str = ""
    """Where something grey is."""
    to: Path | None = None
    """The file of that robot's camera, which is changed; default hider.json or seeker.json."""
    width: int = 640
    """Pixels asked of a camera."""
    height: int = 480
    """Pixels asked of a camera."""
    fourcc: str = "YUYV"
    """Pixel format asked of a camera, four letters."""


@dataclass(frozen=True)
class Check:
    """Look at a table before a game: cameras, tags, light, sharpness, rates, latency, robots.

    On a running deployment, on pictures (`--source`; a camera that the tracker holds cannot be opened twice), or on both.
    One line for each check, with what to do where something is wrong; exit code 1 then.

    Examples:
        vantage table check hardware
        vantage table check rehearsal
        vantage table check --source 0 --table table.json --calibration overhead.json
    """

    deployment: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[DEPLOYMENT]")] = ""
    """A running deployment; `hardware` when no source is given either."""
    source: str = ""
    """A camera (0, 1, /dev/video0), a picture, a folder of pictures or a video from above."""
    table: Path | None = None
    """Your table's file; default: table.json here, else in the deployment's folder, else the default table."""
    calibration: Path | None = None
    """The overhead camera's calibration; default: overhead.json here, else in the deployment's folder."""
    to: Path = Path("table-check")
    """Folder for the annotated pictures."""
    seconds: float = 5.0
    """How long to listen to the deployment."""
    most: int = 20
    """Pictures of a folder or video that are looked at, at most."""
    width: int = 1280
    """Pixels asked of a camera."""
    height: int = 720
    """Pixels asked of a camera."""
    rate: float = 30.0
    """Frames a second asked of a camera: as the tracker will."""
    fourcc: str = "MJPG"
    """Pixel format asked of a camera, four letters: as the tracker will."""
    folder: Path | None = None
    """The deployment's private runtime folder, as given to `vantage up`."""
    arena: str = "table"
    """Name of its arena."""

    @property
    def mode(self) -> tuple[int, int, float, str]:
        """Width, height, rate and format asked of a camera."""
        return self.width, self.height, self.rate, self.fourcc
