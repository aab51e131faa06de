"""Forces as sound: `maglev-mj convert run.maglev run.wav`, and in clips."""

from __future__ import annotations

import subprocess
import wave
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from maglev_mj import export, record_run
from maglev_mj.cli import main
from maglev_mj.recording import Recording
from maglev_mj.recording.export import write_sound
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.theory.loop_array import LoopArray
from maglev_mj.views.window import offscreen
from maglev_mj.views.window.offscreen import render

PERIOD = 0.001


def recording_of(force: Any, axis: int = 2) -> Recording:
    """Return a recording at 1 kHz with a force [N] on one axis, (N,)."""
    (segment,) = record_run(Drop(period=PERIOD, delay=0.0, duration=0.1), plant="exact").segments
    rows = len(force)
    assert abs(segment.metadata.period - PERIOD) < 1e-12
    arrays = {name: np.resize(values, (rows, *values.shape[1:])) for name, values in segment.arrays.items()}
    arrays["applied"] = np.zeros((rows, 6))
    arrays["applied"][:, axis] = force
    return Recording([replace_arrays(segment, arrays)])


def replace_arrays(segment: Any, arrays: dict[str, Any]) -> Any:
    """Return a segment with other arrays."""
    return type(segment)(setup=segment.setup, arrays=arrays, gaps=())


def heard(recording: Recording, path: Path) -> tuple[int, Any]:
    """Return rate and values between -1 and 1 of a recording's sound."""
    export(recording, "wav", path)
    with wave.open(str(path)) as sound:
        assert (sound.getnchannels(), sound.getsampwidth()) == (1, 2)
        return sound.getframerate(), np.frombuffer(sound.readframes(sound.getnframes()), "<i2") / 32767


def test_a_sine_of_force_has_its_frequency_and_the_documented_amplitude(tmp_path: Path) -> None:
    time = np.arange(20_000) * PERIOD  # more than one block
    recording = recording_of(7.0 + 20.0 * np.sin(2 * np.pi * 125.0 * time), axis=0)
    rate, sound = heard(recording, tmp_path / "sine.wav")
    assert rate == 48_000 and len(sound) == 20 * rate
    spectrum = np.abs(np.fft.rfft(sound[rate:])) * 2 / (19 * rate)
    assert np.argmax(spectrum) / 19 == 125.0
    turn, kept = np.exp(-2j * np.pi * 125 * PERIOD), np.exp(-2 * np.pi * 20 * PERIOD)
    passed = abs(kept * (1 - turn) / (1 - kept * turn)) * np.sinc(125 * PERIOD)  # high-pass, and each sample held
    assert abs(spectrum.max() * 50 / (20 * passed) - 1) < 0.001


def test_a_scene_of_a_rotation_plays_the_torque_and_nan_is_silent(tmp_path: Path) -> None:
    (segment,) = record_run(Pull(period=PERIOD, delay=0.0, axis="ry", duration=0.1), plant="exact").segments
    applied = np.zeros((100, 6))
    applied[:, 2], applied[50:, 4], applied[60:, 4] = np.arange(100.0), -0.5, np.nan
    arrays = {name: values[:100] for name, values in segment.arrays.items()} | {"applied": applied}
    held = heard(Recording([replace_arrays(segment, arrays)]), tmp_path / "torque.wav")[1].reshape(-1, 48)[:, 0]
    kept = np.exp(-2 * np.pi * 20 * PERIOD)
    step = -0.5 * kept ** np.arange(1, 11)  # of 1 N m
    assert not held[:50].any() and held[50:60] == pytest.approx(step, abs=1e-4)
    assert held[60] == pytest.approx(kept * (step[-1] + 0.5), abs=1e-4)


def test_a_force_at_rest_is_silent_and_a_slow_one_is_faint(tmp_path: Path) -> None:
    assert not heard(recording_of(np.full(500, 7.0)), tmp_path / "rest.wav")[1].any()
    slow = 20.0 * np.sin(2 * np.pi * 1.0 * np.arange(4000) * PERIOD)
    assert np.abs(heard(recording_of(slow), tmp_path / "slow.wav")[1]).max() < 0.06 * 20 / 50


def test_forces_are_held_and_clipped_at_full_scale(tmp_path: Path) -> None:
    sound = heard(recording_of(np.where(np.arange(100) % 2, 200.0, -200.0)), tmp_path / "loud.wav")[1]
    held = sound.reshape(-1, 48)
    assert (held == held[:, :1]).all() and set(held[40:, 0]) == {-1.0, 1.0}


def test_a_step_in_slow_motion_decays_as_fast_as_in_real_time(tmp_path: Path) -> None:
    wrench = np.zeros((2, 6))
    wrench[1, 2] = 40.0
    with (tmp_path / "step.wav").open("wb") as file:
        write_sound(file, [(wrench, 0.1)], turns=False)
    with wave.open(str(tmp_path / "step.wav")) as sound:
        frames = np.frombuffer(sound.readframes(sound.getnframes()), "<i2") / 32767
    kept = np.exp(-2 * np.pi * 20.0 * 0.005 * (1 + np.arange(4800) // 240))
    assert not frames[:4800].any() and frames[4800:] == pytest.approx(40 / 50 * kept, abs=1e-4)


def test_empty_and_invalid_files_are_rejected_in_one_line(tmp_path: Path, capsys: Any) -> None:
    Recording([]).save(tmp_path / "empty.maglev")
    (tmp_path / "wrong.maglev").write_bytes(b"no recording")
    for name, words in {"empty": "nothing to export to wav", "wrong": "wrong.maglev"}.items():
        assert main(["convert", str(tmp_path / f"{name}.maglev"), str(tmp_path / f"{name}.wav")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line and not (tmp_path / f"{name}.wav").exists()


def render_buzz(path: Path, time_scale: float) -> float:
    """Write a clip of 1.5 s of a wall that rings; return its frequency [Hz]."""
    scene = Drop(height=1e-4, stiffness=9_500.0, pulse=0.0, duration=3.0)
    render(scene, path, seconds=1.5, time_scale=time_scale, width=160, height=160, rate=2, plots=False)
    loop = LoopArray(period=scene.period, delay=scene.delay, mass=scene.mass)
    roots = np.linalg.eigvals(loop.matrix(scene.stiffness, scene.damping))
    return float(abs(np.angle(roots[np.abs(roots).argmax()]))) / (2.0 * np.pi * scene.period)


def decoded(path: Path, *options: str) -> Any:
    """Return the sound of a file, by ffmpeg."""
    from imageio_ffmpeg import get_ffmpeg_exe

    command = [get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path), "-f", "s16le", "-ar", "48000", *options, "-"]
    return np.frombuffer(subprocess.run(command, check=True, capture_output=True).stdout, "<i2") / 32767


@pytest.mark.needs("drawing")
def test_a_clip_plays_a_wall_buzz_at_its_time_scale(tmp_path: Path) -> None:
    time_scale = 0.5
    frequency = render_buzz(tmp_path / "buzz.mp4", time_scale)
    sound, length = decoded(tmp_path / "buzz.mp4"), 1.5 / time_scale
    assert len(sound) == pytest.approx(48_000 * length, abs=2048)  # a block of the encoder
    ringing = sound[len(sound) // 3 :]
    spectrum = np.abs(np.fft.rfft(ringing * np.hanning(len(ringing))))
    assert np.argmax(spectrum) * 48_000 / len(ringing) == pytest.approx(frequency * time_scale, abs=1.5 / length)


@pytest.mark.needs("drawing")
def test_a_missing_audio_encoder_is_reported(tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = subprocess.CalledProcessError(1, "ffmpeg", stderr=b"Unknown encoder 'aac'\nnothing written")
    parts: list[Any] = []
    monkeypatch.setattr(subprocess, "run", Mock(side_effect=refused))
    monkeypatch.setattr(offscreen, "write_sound", lambda file, heard, turns: parts.extend(heard))
    render_buzz(tmp_path / "buzz.mp4", 1.0)
    assert capsys.readouterr().out.splitlines() == ["  the clip has no sound: Unknown encoder 'aac'"]
    assert [one.name for one in tmp_path.iterdir()] == ["buzz.mp4"]
    assert [(forces.shape, period) for forces, period in parts] == [((300, 6), 0.005)]  # each sample once
    monkeypatch.undo()
    with pytest.raises(subprocess.CalledProcessError):
        decoded(tmp_path / "buzz.mp4")  # no sound in it
