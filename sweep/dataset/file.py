"""The file of a dataset: made aside, put in its place whole, known by the hash beside it."""

from __future__ import annotations

import errno
import hashlib
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import netCDF4
import numpy as np

from demflow.model.outcome import Status
from demflow.sweep.dataset.verdict import Verdict
from demflow.sweep.plan.graph import Plan
from demflow.sweep.store.durable import naming, rename_durably, write_durably
from demflow.sweep.study.cases import coordinates
from demflow.sweep.study.load import Study

PROBE_BYTES = 1_000_000  # written to find why the library could not write


def make_dataset(path: Path, fill: Callable[[netCDF4.Dataset], bool]) -> None:
    """Make a dataset aside and put it in place, if `fill` says that it is good.

    Raises OSError where it cannot be written; the earlier dataset stays then.
    """
    aside = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        if not _written(aside, path, fill):
            return
        with aside.open("rb+") as written, naming(path):
            os.fsync(written.fileno())
            sha256 = hashlib.file_digest(written, "sha256").hexdigest()
        with _hash_beside(path, sha256):
            rename_durably(aside, path)
    finally:
        with suppress(OSError):
            aside.unlink()


def _written(aside: Path, path: Path, fill: Callable[[netCDF4.Dataset], bool]) -> bool:
    """Fill a file through the netCDF library; what `fill` says of it. Raises OSError."""
    try:
        with netCDF4.Dataset(aside, "w", format="NETCDF4") as file:
            try:
                good = fill(file)
                file.sync()  # what cannot be written is told here, and not on closing
            finally:
                _detach(aside)
    except (RuntimeError, PermissionError) as error:  # its words for whatever happened
        if type(error) not in (RuntimeError, PermissionError):
            raise
        _give_up(aside, path)
        why = f"netCDF cannot write it ({error}); most often the disk is full"
        raise OSError(errno.EIO, why, str(path)) from error
    return good


def _give_up(aside: Path, path: Path) -> None:
    """Raise the OSError that the library met, if the disk still gives it.

    The file stays open, empty: the library may not have let go of it, and would take another
    for it that is given its number.
    """
    with naming(path):
        probe = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        try:
            os.write(probe, bytes(PROBE_BYTES))
            os.fsync(probe)
        finally:
            with suppress(OSError):
                os.truncate(probe, 0)


def _detach(path: Path) -> None:
    """Let all further writes of this process to an open file go nowhere.

    The netCDF library crashes where the last write to a file, on closing it, fails. After `sync`
    the file is whole and closing has nothing to add; after an error nobody wants it.
    """
    own = path.stat()
    with Path(os.devnull).open("rb+", buffering=0) as nowhere:
        for name in os.listdir("/dev/fd"):  # noqa: PTH208 (whole before any of them is changed)
            with suppress(OSError):  # the descriptor of the listing itself
                if os.path.samestat(os.fstat(int(name)), own):
                    os.dup2(nowhere.fileno(), int(name), inheritable=False)


@contextmanager
def _hash_beside(path: Path, sha256: str) -> Iterator[None]:
    """Record the hash of a dataset that takes its place while a `with` block runs.

    Until it has, the hash of the one that is there stands beside it, so that whenever this
    ends a whole dataset is known as one.
    """
    line = f"{sha256}  {path.name}\n"
    earlier = ""
    if (known := _known_hashes(path)) and path.exists() and (there := _hash(path)) in known:
        earlier = f"{there}  {path.name}\n"
    write_durably(_hash_file(path), (line + earlier).encode())
    yield
    write_durably(_hash_file(path), line.encode())


def _known_hashes(path: Path) -> list[str]:
    try:
        lines = _hash_file(path).read_text(errors="replace").splitlines()
    except FileNotFoundError:
        return []
    return [line.partition(" ")[0] for line in lines]


def dataset_problem(path: Path) -> str | None:
    """What is wrong with the dataset at `path` by the hash beside it, None if nothing is."""
    recorded = _known_hashes(path)
    if not recorded:
        return f"there is no hash in {_hash_file(path).name} beside it"
    return None if _hash(path) in recorded else "the data differ from what was written"


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _hash_file(path: Path) -> Path:
    return path.with_name(path.name + ".sha256")  # as `sha256sum --check` reads it


def collected_digest(path: Path) -> str | None:
    """Return what the dataset at `path` was made from, None where there is no whole dataset."""
    if not path.exists() or dataset_problem(path):
        return None
    return attribute(path, "demflow_digest")


def attribute(path: Path, name: str) -> str | None:
    """An attribute of the dataset at `path`, None where it has none or is none."""
    return attributes(path).get(name)


def attributes(path: Path) -> dict[str, str]:
    """All attributes of the dataset at `path`, as words; none where it is none."""
    with suppress(OSError, RuntimeError), netCDF4.Dataset(path) as file:
        return {name: str(file.getncattr(name)) for name in file.ncattrs()}
    return {}


def recorded(path: Path) -> list[Verdict]:
    """How each case ended by the dataset at `path`, (cases,)."""
    with netCDF4.Dataset(path) as file:
        status = np.ma.getdata(file["status"][...]).ravel()
        messages = np.asarray(file["message"][...], dtype=object).ravel()
        return [Verdict(Status(int(s)), str(m)) for s, m in zip(status, messages, strict=True)]


def recorded_at(path: Path, index: tuple[int, ...]) -> Verdict | None:
    """How one case ended by the dataset at `path`, None where it has no such case."""
    with netCDF4.Dataset(path) as file:
        status = file["status"]
        if status.ndim != len(index) or any(
            k >= n for k, n in zip(index, status.shape, strict=True)
        ):
            return None
        ended = Status(int(np.ma.getdata(status[index])))
        return Verdict(ended, str(file["message"][index]))


def below_zero(path: Path) -> tuple[str, ...]:
    """What to say of pressures below zero in the dataset at `path`: a line, or none."""
    with suppress(OSError, IndexError, RuntimeError), netCDF4.Dataset(path) as file:
        lowest = np.ma.filled(file["lowest_pressure"][...], math.nan).ravel()
        below = lowest < 0.0
        if below.any():
            return (
                f"in {np.count_nonzero(below)} of {len(below)} cases a pressure falls below zero, "
                f"to {lowest[below].min() / 1e6:,.4g} MPa: no liquid bears that, if pressures are "
                "absolute (`lowest_pressure` in the dataset says where; `expect: "
                "{lowest_pressure: 0 Pa}` makes it count)",
            )
    return ()


def difference(path: Path, study: Study, plan_of: Callable[[], Plan]) -> str | None:
    """Why the dataset at `path` is not that of the cases of a study, None where it is.

    Parameters
    ----------
    path : of the dataset
    study : the study, read and checked
    plan_of : gives all distinct stage runs of the study; called only where its text, or a file
        that it names, is another than that of the dataset and its axes are the same
    """
    with netCDF4.Dataset(path) as file:
        known = {name: str(file.getncattr(name)) for name in file.ncattrs()}
        if known.get("study_smoke") != ("yes" if study.smoke else "no"):
            return f"it was made {'without' if study.smoke else 'with'} the smoke block"
        made_of = known.get("study_sha256"), known.get("study_files_sha256", "")
        if made_of == (study.sha256, study.files_sha256):
            return None
        names = list(file["status"].dimensions)
        if names != [axis.name for axis in study.axes]:
            return f"it varies {', '.join(names) or 'nothing'}"
        for axis in study.axes:
            for coordinate in coordinates(axis):
                if coordinate.name not in file.variables or not np.array_equal(
                    np.asarray(file[coordinate.name][...]), coordinate.values
                ):
                    return f"it has other values of {axis.name}"
    return None if known.get("plan_sha256") == plan_of().digest() else "its scene is another"
