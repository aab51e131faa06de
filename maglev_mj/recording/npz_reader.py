"""Recordings as arrays, read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import IO, Any
from zipfile import ZIP_STORED, ZipFile

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.recording.fields import check_setup, checked, parsed, text_in
from maglev_mj.recording.stretch import COLUMNS, FORMAT, Recording, Stretch
from maglev_mj.recording.unpacking import Allowance, UnpackingError

__all__ = ["read_npz"]


def read_npz(file: IO[bytes], size: int) -> Recording:
    """Read a recording.

    Args:
        file: What to read.
        size: Of the file [bytes].

    Raises:
        ParameterError: If there is no recording in it, or it holds what none can.
        OSError: If it cannot be read.
    """
    allowance = Allowance(size)
    try:
        with ZipFile(file) as archive:
            header = _header(archive, allowance)
            setups = header["setups"]
            if not isinstance(setups, list):
                raise ParameterError("setups must be a list")
            stretches = [_stretch(archive, allowance, index, setup) for index, setup in enumerate(setups)]
    except (OSError, ParameterError):
        raise
    except UnpackingError as error:
        raise ParameterError(str(error)) from None
    except Exception:  # of zip files, of what unpacks, of headers: a damaged one fails in many ways
        raise ParameterError("it is damaged") from None
    events = header.get("events", [])
    if not isinstance(events, list):
        raise ParameterError("events must be a list")
    return Recording(stretches, events=tuple(text_in({"event": event}, "event") for event in events))


def _header(archive: ZipFile, allowance: Allowance) -> Mapping[str, Any]:
    text = str(_array(archive, allowance, "header"))
    allowance.text(len(text))
    header = parsed(text)
    if text_in(header, "format") != FORMAT:
        raise ParameterError(f"format must be {FORMAT!r}, not {header['format']!r}")
    return dict(header)


def _stretch(archive: ZipFile, allowance: Allowance, index: int, setup: Any) -> Stretch:
    arrays: dict[str, Any] = {name: _column(_array(archive, allowance, f"{index}/{name}"), name) for name in COLUMNS}
    if len({len(values) for values in arrays.values()}) > 1:
        raise ParameterError(f"the arrays of stretch {index} must be of one length")
    return checked(Stretch(setup=check_setup(setup), **arrays))


def _array(archive: ZipFile, allowance: Allowance, name: str) -> Any:
    """Return an array; one that is not packed takes up no more than is there."""
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type != ZIP_STORED:
        allowance.part(info.file_size)
    elif info.file_size != info.compress_size:
        raise UnpackingError(f"{name} must have one size, not {info.file_size} and {info.compress_size}")
    with archive.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _column(array: Any, name: str) -> Array:
    columns = COLUMNS[name]
    if array.dtype != np.float64 or array.ndim != (2 if columns else 1) or (columns and array.shape[1] != columns):
        shape = f"(N, {columns})" if columns else "(N,)"
        raise ParameterError(f"{name} must be numbers {shape}, not {array.dtype} {array.shape}")
    return np.asarray(array)
