"""Pressure maps in time as a picture that moves: GIF, or MP4 where ffmpeg is."""

from __future__ import annotations

import shutil
from importlib import import_module
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib import colormaps, rcParams
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.colors import to_rgb
from PIL import Image

from demflow.model.scene import Scene
from demflow.sweep.analysis.cases import with_unit
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.maps import Fields, broken_until, coloured, draw_fields, readable
from demflow.sweep.figures.style import (
    BLUE,
    DPI,
    SEQUENTIAL,
    VERMILION,
    make_printable,
    pick,
)

KINDS = ("gif", "mp4")
MOST_FRAMES = 40
MOST_PIXELS = 800  # of the longer side
FRAMES_A_SECOND = 6


def check_kind(kind: str) -> None:
    """Raise ResultsError for a kind of file that is none of these, or cannot be written here."""
    if kind not in KINDS:
        raise ResultsError(f"an animation is {' or '.join(KINDS)}, not {kind or 'without suffix'}")
    if kind == "mp4" and not _ffmpeg():
        raise ResultsError(
            "MP4 needs the program ffmpeg, which is not found; take GIF, or "
            "`pip install demflow[movies]`"
        )


def _ffmpeg() -> str:
    """Path of ffmpeg: the machine's, else that of the package imageio-ffmpeg; empty without."""
    own = shutil.which("ffmpeg")
    if own is None:
        try:
            own = str(import_module("imageio_ffmpeg").get_ffmpeg_exe())
        except (ImportError, RuntimeError):
            return ""
    return own


def _in_palette(frame: np.ndarray, palette: np.ndarray) -> Image.Image:
    """A frame (rows, columns, 3) in the nearest colours of a palette (256, 3)."""
    # what Pillow takes for nearest is a few steps off: white was grey
    red, green, blue = np.moveaxis(frame.astype(np.int64), -1, 0)
    codes = red << 16 | green << 8 | blue
    nearest = np.zeros(1 << 24, dtype=np.uint8)  # place in the palette of every colour there is
    nearest[codes] = 1
    (there,) = np.nonzero(nearest)
    each = np.stack([there >> 16, there >> 8 & 255, there & 255], axis=1)
    off = (palette**2).sum(axis=1) - 2 * each @ palette.T
    nearest[there] = off.argmin(axis=1)
    found = Image.fromarray(nearest[codes])
    found.putpalette(palette.astype(np.uint8).tobytes())
    return found


class GifWriter(PillowWriter):
    """Writes all frames with one palette: the colour map's, greys and what marks are drawn in.

    A palette found in each frame gives few colours to what is rare, as the rock around a well.
    """

    _frames: list[Image.Image]

    def finish(self) -> None:
        """Write the file."""
        field = colormaps[SEQUENTIAL](np.linspace(0.0, 1.0, 200))[:, :3]
        grey = np.repeat(np.linspace(0.0, 1.0, 54)[:, None], 3, axis=1)
        colours = np.concatenate([field, grey, [to_rgb(BLUE), to_rgb(VERMILION)]])
        palette = np.round(255.0 * colours).astype(np.int64)
        first, *others = (_in_palette(np.asarray(frame), palette) for frame in self._frames)
        first.save(
            self.outfile, save_all=True, append_images=others, duration=int(1000 / self.fps), loop=0
        )


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
    writer: AbstractMovieWriter = (GifWriter if kind == "gif" else FFMpegWriter)(FRAMES_A_SECOND)
    if kind == "mp4":
        rcParams["animation.ffmpeg_path"] = _ffmpeg()  # the house's style puts it back
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
