import sys
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from pwm_gym.errors import PwmGymError
from pwm_gym.viewer import draw_overlays, twin_frame, write_gif, write_mp4, write_png
from pwm_gym.viewer.labels import fit


def test_frame_is_an_image_and_deterministic(record):
    image = twin_frame(record, 3, panel=200)
    assert image.dtype == np.uint8
    assert image.shape[1:] == (2 * 28 + 3 * 200 + 2 * 16, 3)
    np.testing.assert_array_equal(image, twin_frame(record, 3, panel=200))
    assert (image != twin_frame(record, 4, panel=200)).any()
    np.testing.assert_array_equal(twin_frame(record, -1, panel=200), twin_frame(record, 9, panel=200))


@pytest.mark.parametrize("change", [{"goal": None}, {"true_reward": None}, {"title": "long " * 80}])
def test_optional_parts(record, change):
    assert twin_frame(replace(record, **change), 0, panel=200).shape == twin_frame(record, 0, panel=200).shape


def test_a_single_step(record):
    one = {k: getattr(record, k)[:1] for k in ("predicted", "true", "error", "predicted_reward", "true_reward")}
    assert twin_frame(replace(record, **one), 0, panel=200).ndim == 3


def test_a_prediction_that_flies_off_keeps_the_view(record):
    far = record.predicted.copy()
    far[-1] += 100.0
    near, wide = record.view(200), replace(record, predicted=far).view(200)
    assert np.linalg.norm(np.subtract(near.eye, wide.eye)) < 0.6


def test_gif_has_every_stride_and_the_last_step(record, tmp_path):
    path = write_gif(record, tmp_path / "twin.gif", fps=10, stride=4, panel=200)
    with Image.open(path) as image:
        assert image.n_frames == 4  # steps 0, 4, 8 and 9
        assert image.info["duration"] == 100
        assert image.info["loop"] == 0
        image.seek(3)
        last = np.asarray(image.convert("RGB"), dtype=float)
    assert np.abs(last - twin_frame(record, 9, panel=200)).mean() < 6


def test_png_is_a_contact_sheet(record, tmp_path):
    with Image.open(write_png(record, tmp_path / "sheet.png", steps=(0, 4, 9), panel=160)) as image:
        assert image.size[0] == max(58 + 3 * 170 - 10 + 28, 640)
        assert image.mode == "RGB"
    assert write_png(record, tmp_path / "one.png", steps=[2], panel=160).exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"predicted": np.zeros((9, 60, 3))}, r"predicted has shape \(9, 60, 3\); expected \(10, 60, 3\)"),
        ({"true": np.zeros((10, 59, 3))}, r"true has shape \(10, 59, 3\)"),
        ({"error": np.zeros(9)}, r"error has shape \(9,\)"),
        ({"error": np.full(10, np.nan)}, "10 of 10 error values are not finite"),
    ],
)
def test_records_that_do_not_fit(record, change, message):
    with pytest.raises(PwmGymError, match=message):
        replace(record, **change)


def test_not_finite_points_are_counted(record):
    broken = record.predicted.copy()
    broken[2, 5:8] = np.nan
    with pytest.raises(PwmGymError, match="3 of 600 predicted points are not finite"):
        replace(record, predicted=broken)


def test_bad_arguments(record, tmp_path):
    with pytest.raises(PwmGymError, match="t=10"):
        twin_frame(record, 10)
    with pytest.raises(PwmGymError, match="panel=50"):
        twin_frame(record, 0, panel=50)
    with pytest.raises(PwmGymError, match=r"steps=\[11\]"):
        write_png(record, tmp_path / "sheet.png", steps=[11])
    with pytest.raises(PwmGymError, match="fps=0"):
        write_gif(record, tmp_path / "twin.gif", fps=0)


def test_long_text_is_shortened():
    assert fit("short", 14, 200) == "short"
    assert fit("a very long heading indeed", 14, 60).endswith("...")


def test_stages_are_written_beside_the_step(record, tmp_path):
    staged = replace(record, stages=("open",) * 4 + ("close",) * 6)
    plain, first, later = (twin_frame(r, t) for r, t in ((record, 2), (staged, 2), (staged, 6)))
    assert not np.array_equal(plain, first)
    rows, columns, _ = np.nonzero(plain != first)
    assert rows.max() < 80 and columns.min() > plain.shape[1] / 2  # in the heading, at its right
    assert not np.array_equal(first[:80], later[:80])
    assert write_png(staged, tmp_path / "a.png").read_bytes() != write_png(record, tmp_path / "b.png").read_bytes()
    one = (draw_overlays([r], "").convert("RGB") for r in (record, staged))
    assert not np.array_equal(*map(np.asarray, one))
    with pytest.raises(PwmGymError, match="2 stages; expected one for each of 10 steps"):
        replace(record, stages=("open", "close"))


def test_a_film_has_every_step_and_holds_the_last(record, tmp_path):
    some = {k: getattr(record, k)[:4] for k in ("predicted", "true", "error", "predicted_reward", "true_reward")}
    record = replace(record, **some)
    path = write_mp4(record, tmp_path / "twin.mp4", fps=10, panel=201)
    frames = imageio_ffmpeg.read_frames(str(path))
    about = next(frames)
    assert about["fps"] == 10 and about["codec"] == "h264"
    width, height = about["size"]
    films = [np.frombuffer(f, np.uint8).reshape(height, width, 3).astype(float) for f in frames]
    assert len(films) == 4 + 15
    shown = twin_frame(record, 3, panel=201)
    assert (height, width) == (shown.shape[0] + shown.shape[0] % 2, shown.shape[1] + shown.shape[1] % 2)
    assert np.abs(films[-1][: len(shown), : shown.shape[1]] - shown).mean() < 3 < np.abs(films[0] - films[3]).max()
    with pytest.raises(PwmGymError, match="fps=-1; expected a positive rate"):
        write_mp4(record, path, fps=-1)


def test_a_film_without_its_writer_is_named(record, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[video\]'"):
        write_mp4(record, tmp_path / "twin.mp4")
