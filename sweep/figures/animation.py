"""Pressure maps in time as a picture that moves: GIF, or MP4 where ffmpeg is."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter

from demflow.model.scene import Scene
from demflow.sweep.analysis.cases import with_unit
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.maps import Fields, broken_until, coloured, draw_fields, readable
from demflow.sweep.figures.style import DPI, make_printable, pick

KINDS = ("gif", "mp4")
MOST_FRAMES = 40
MOST_PIXELS = 800  # of the longer side
FRAMES_A_SECOND = 6


def check_kind(kind: str) -> None:
    """Raise ResultsError for a kind of file that is none of these, or cannot be written here."""
    if kind not in KINDS:
        raise ResultsError(f"an animation is {' or '.join(KINDS)}, not {kind or 'without suffix'}")
    if kind == "mp4" and shutil.which("ffmpeg") is None:
        raise ResultsError("MP4 needs the program ffmpeg, which is not found; take GIF, or add it")


def draw_animation(
    maps: xr.Dataset,
    path: Path,
    scene: Scene | None = None,
    heading: str = "",
    breaks: xr.Dataset | None = None,
) -> Path:
    """Write pressure over the pores in time, a frame for each recorded time, one colour bar.

    Of more than `MOST_FRAMES` times as many are drawn, evenly among those recorded, the first and
    the last among them. The same maps give the same GIF, byte by byte.

    Parameters
    ----------
    maps : maps of one case, with `pressure` at two times or more and the domains' mesh.
    path : GIF or MP4 to write, by its suffix.
    scene : its scene, for the region's rim, grains and barriers, which are left out without it.
    heading : what tells this case from others.
    breaks : what broke in this case, with `event_time`, `event_x` and `event_y`: those until each
        time are drawn, the path of the crack.

    Raises ResultsError where there are no such maps, for another suffix, and for MP4 without
    ffmpeg.
    """
    kind = path.suffix.removeprefix(".").lower()
    check_kind(kind)
    if not is_moving(maps):
        raise ResultsError(
            "there is nothing to animate: the maps hold no pressure at two times or more; observe "
            "pressure_map, and record times"
        )
    times = maps["elapsed_time"].values
    chosen = pick(len(times), MOST_FRAMES)
    pressure, factor, name = readable(
        maps["pressure"].transpose("elapsed_time", "domain").values[chosen], scene
    )
    titles = [f"t = {with_unit(t, 's')}" for t in times[chosen]]
    fields = Fields(pressure * factor, name, titles, times[chosen])
    drawn = draw_fields(maps, scene, heading, fields, breaks, count=1)
    make_printable(drawn.figure)
    dpi = min(DPI, MOST_PIXELS / float(np.max(drawn.figure.get_size_inches())))
    writer: AbstractMovieWriter = (PillowWriter if kind == "gif" else FFMpegWriter)(FRAMES_A_SECOND)
    with writer.saving(drawn.figure, str(path), dpi):
        for field, title, time in zip(fields.values, titles, fields.until, strict=True):
            drawn.images[0].set_data(coloured(drawn.pores, field, drawn.norm))
            drawn.panels[0].set_title(title)
            for dots in drawn.breaks:
                dots.set_offsets(broken_until(breaks, time) if breaks is not None else ())
            writer.grab_frame()
    return path


def is_moving(maps: xr.Dataset) -> bool:
    """Whether maps hold pressure at two times or more."""
    return "pressure" in maps and maps["pressure"].sizes.get("elapsed_time", 0) > 1
