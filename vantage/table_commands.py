"""The `vantage table` commands: each takes its settings and returns an exit code. What they need is loaded when they run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from vantage.printable import counted
from vantage.setting_up.former import keep_former
from vantage.setting_up.progress import cameras_there, console, progress
from vantage.setting_up.settings import CalibrateArena, CalibrateLens, CalibrateRobot, Check, Colors, Print
from vantage.setting_up.trouble import TableTrouble

if TYPE_CHECKING:
    from vantage.setting_up.board_views import BoardViews


def print_sheets(settings: Print) -> int:
    """Write the PDFs."""
    with cameras_there():
        from vantage.setting_up.sheets import write_sheets
        from vantage.tracking.table import default_table, load_table, save_table
    table = default_table() if settings.table is None else load_table(settings.table)
    for path, pages, kept in write_sheets(settings.to, table, settings.paper):
        console.print(f"{path}: {counted(pages, 'page')}{kept}", soft_wrap=True, markup=False)
    if settings.table is None:
        file = settings.to / "table.json"
        if file.exists():
            left = f"{file} is there already and was left alone; to print it: --table {file}"
            console.print(left, soft_wrap=True, markup=False)
        else:
            save_table(table, file)
            made = f"{file}: the table they belong to; enter there what you measure on yours"
            console.print(made, soft_wrap=True, markup=False)
    console.print('Print at 100 % ("actual size") and measure the ruler first: docs/table.md, "Printing"')
    return 0


def calibrate_lens(settings: CalibrateLens) -> int:
    """Measure the lens; refuses what must not be used."""
    with cameras_there():
        from vantage.setting_up.board_views import coverage_picture
        from vantage.setting_up.calibrating import gather_views, measure_lens, save_lens
        from vantage.setting_up.pictures import open_source, write_picture
    with open_source(settings.source, *settings.mode) as source, progress("looking for the board") as say:

        def tell(views: BoardViews, looked: int) -> None:
            missing = views.missing()
            of = f" of {source.count}" if source.count is not None else ""
            wish = f"; show {missing[0]}" if missing and source.live else ""
            say(f"picture {looked}{of}: {counted(len(views.views), 'view')} of the board{wish}")

        views, refused = gather_views(source, settings.seconds, tell)
        say(f"fitting the lens to {counted(len(views.views), 'view')}")
        for name, reason in refused:
            console.print(f"set aside: {name}: {reason}", soft_wrap=True, markup=False)
        coverage = settings.to.with_name(f"{settings.to.stem}-views.png")
        if views.views:
            write_picture(coverage, coverage_picture(views))
        result, used = measure_lens(views, source.name)
    for index, reason in result.refused:
        console.print(f"set aside: {used[index].name}: {reason}", soft_wrap=True, markup=False)
    lens = result.lens
    kept = keep_former(settings.to)
    save_lens(lens, settings.to)
    console.print(f"lens of {lens.width} x {lens.height} pixels from {lens.views} views: residual {lens.residual:.2f} px (RMS)")
    if missing := views.missing():
        console.print(f"good enough, but better with: {'; '.join(missing)}", soft_wrap=True)
    console.print(f"{settings.to} written{kept}; where the board was seen: {coverage}", soft_wrap=True, markup=False)
    next_command = f"vantage table calibrate arena --source PICTURE_OR_CAMERA --lens {settings.to}"
    console.print(f"next: {next_command}", soft_wrap=True, markup=False)
    return 0


def calibrate_arena(settings: CalibrateArena) -> int:
    """Find the camera's place; refuses what must not be used."""
    with cameras_there():
        from vantage.setting_up.annotation import Canvas, tag_names
        from vantage.setting_up.calibrating import load_lens, today
        from vantage.setting_up.picture_check import corner_errors, find_tags
        from vantage.setting_up.pictures import open_source, require_size, write_picture
        from vantage.tracking import calibration as calibrations
        from vantage.tracking.overhead_camera import OverheadCamera
        from vantage.tracking.table import load_table
    table, lens = load_table(settings.table), load_lens(settings.lens)
    with progress("taking a picture") as say, open_source(settings.source, *settings.mode) as source:
        view = source.first()
        require_size(view, lens.width, lens.height, f"the lens {settings.lens}")
        say("looking for the corner tags")
        found = find_tags(view.picture)
        annotated = settings.to.with_name(f"{settings.to.stem}-arena.png")
        canvas = Canvas(view.picture)
        canvas.tags(found, tag_names(table))
        write_picture(annotated, canvas.picture)  # also where what follows refuses it: people want to see why
        try:
            calibration = calibrations.calibrate_arena(view.picture, table, lens, today(), f"vantage table, {source.name}")
        except calibrations.CalibrationFailed as error:
            raise TableTrouble(f"{error} (what was seen: {annotated})") from error
    camera = OverheadCamera(calibration)
    canvas = Canvas(view.picture, camera)
    canvas.arena(table)
    canvas.tags(found, tag_names(table))
    write_picture(annotated, canvas.picture)
    kept = keep_former(settings.to)
    calibrations.save_calibration(calibration, settings.to)
    for tag, errors in sorted(corner_errors(camera, found, table).items()):
        console.print(
            f"corner tag {tag}: {1000 * float((errors**2).mean()) ** 0.5:.1f} mm from where the table's file says (RMS)"
        )
    x, y, z = (float(value) for value in camera.centre)
    console.print(f"residual {calibration.arena_residual:.2f} mm on the floor (RMS); lens {calibration.lens_residual:.2f} px")
    console.print(
        f"the camera hangs {z:.3f} m above the floor, over x {x:.3f} m, y {y:.3f} m; 1 px is {1000 / camera.scale_at(0.0):.2f} mm"
    )
    wish = "look whether border and goals lie where they should"
    console.print(f"{settings.to} written{kept}; {wish}: {annotated}", soft_wrap=True, markup=False)
    return 0


def calibrate_robot(settings: CalibrateRobot) -> int:
    """Measure how a robot's camera sits and write its file."""
    with cameras_there():
        from vantage.setting_up import robot_camera
        from vantage.setting_up.calibrating import today
        from vantage.tracking.rgbd import save_rgbd
    target = settings.to or Path(f"{settings.robot}.json")
    former = robot_camera.load_or_refuse(target, settings.robot) if target.is_file() else None
    kind, _, serial = settings.source.partition(":")
    with progress("taking depth pictures"):
        if kind == "realsense":
            calibration, depth = robot_camera.read_realsense(serial, settings.width, settings.height)
        else:
            calibration, depth = robot_camera.lenses_of(settings.lenses), robot_camera.read_depth(Path(settings.source))
        mount = robot_camera.measure_mount(depth, calibration)
    calibration = robot_camera.mounted(calibration, mount, settings.forward, settings.left, today())
    kept = keep_former(target)
    if former is None:
        save_rgbd(calibration, target)
    else:
        robot_camera.save_correction(calibration, former.correction, target)
    console.print(
        f"the {settings.robot}'s depth lens is {1000 * mount.height:.1f} mm above the floor, looks "
        f"{math.degrees(mount.tilt):.1f}° down, leans {math.degrees(mount.roll):+.1f}° "
        f"(from {mount.points} points, {1000 * mount.spread:.1f} mm RMS)",
        soft_wrap=True,
    )
    following = f"vantage table colors --robot {settings.robot} --source PICTURE"
    console.print(f"{target} written{kept}; next: {following}", soft_wrap=True, markup=False)
    return 0


def colors(settings: Colors) -> int:
    """Measure colours and write the correction into the robot's file."""
    with cameras_there():
        from vantage.setting_up.coloring import SURFACES, measure_colors, parse_place, side_by_side
        from vantage.setting_up.pictures import open_source, write_picture
        from vantage.setting_up.robot_camera import load_or_refuse, save_correction
        from vantage.tracking.colors import LEAST_MARGIN, UnusableColors, correct_colors, lighting_limits
    target = settings.to or Path(f"{settings.robot}.json")
    texts = {"hider": settings.hider, "seeker": settings.seeker, "grey": settings.grey}
    places = {surface: parse_place(surface, text) for surface, text in texts.items() if text}
    with progress("taking a picture"), open_source(settings.source, *settings.mode) as source:
        picture = source.first().picture
    annotated = target.with_name(f"{target.stem}-colors.png")
    if len(places) < len(SURFACES):
        write_picture(annotated, picture)
        missing = ", ".join(f"--{surface}" for surface in SURFACES if surface not in places)
        raise TableTrouble(f"the picture is saved as {annotated}: find the surfaces in it and give their pixels: {missing} X,Y")
    calibration = load_or_refuse(target, settings.robot)
    measured, outlined = measure_colors(picture, places)
    write_picture(annotated, outlined)  # also where what follows refuses it: people want to see why
    for surface, patch in measured.items():
        mean = ", ".join(f"{value:.0f}" for value in patch.mean)
        console.print(f"{surface:<7} red, green, blue {mean} over {patch.pixels} pixels")
    try:
        correction, quality = correct_colors(measured["hider"], measured["seeker"], measured["grey"])
    except UnusableColors as error:
        raise TableTrouble(f"{error} (what was measured: {annotated})") from error
    write_picture(annotated, side_by_side(outlined, picture, correction))
    for name, margin in (("hider", quality.hider), ("seeker", quality.seeker), ("grey", quality.grey), ("apart", quality.apart)):
        console.print(f"margin {name:<7} {margin:.3f} (at least {LEAST_MARGIN:g} is needed)")
    limits = lighting_limits(correction, measured["hider"], measured["seeker"], measured["grey"])
    dark, bright = limits.brightness
    console.print(f"holds while the light is {dark:.2f} to {bright:.2f} times as bright, and for a change of one colour alone:")
    ranges = {"red": limits.red, "green": limits.green, "blue": limits.blue}
    console.print("  " + ", ".join(f"{name} {low:.2f} to {high:.2f}" for name, (low, high) in ranges.items()))
    kept = keep_former(target)
    save_correction(calibration, correction, target)
    line = f"{target} written{kept}; the picture as measured and as corrected: {annotated}"
    console.print(line, soft_wrap=True, markup=False)
    return 0


def check(settings: Check) -> int:
    """Print one line for each check; 0 if all is well."""
    with cameras_there():
        from vantage.setting_up.checking import check_table
        from vantage.setting_up.verdict import lines
    verdicts = check_table(settings)
    for line in lines(verdicts):
        console.print(line, soft_wrap=True)
    troubles = sum(not verdict.ok for verdict in verdicts)
    summary = f"{troubles} with trouble" if troubles else "all well"
    checks = counted(len(verdicts), "check")
    console.print(f"{checks}, {summary}; pictures: {settings.to}", soft_wrap=True, markup=False)
    return 1 if troubles else 0
