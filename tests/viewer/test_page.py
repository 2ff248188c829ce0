"""Pages that play a run: what they hold, how large they are, and how a browser shows them."""

import base64
import io
import re
import sys
from dataclasses import replace

import browser
import msgspec
import numpy as np
import pytest
import roma
import torch
import zstandard
from PIL import Image

from pwm_gym.cli import main
from pwm_gym.errors import PwmGymError
from pwm_gym.planning import Run
from pwm_gym.scene import Layout
from pwm_gym.viewer import TwinRecord, write_html


def recorded(page):
    """What viser's player reads: messages (seconds, dict), and the bytes of their arrays."""
    embedded = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page).group(1))
    size = int.from_bytes(embedded[:8], "little")
    inner = zstandard.ZstdDecompressor().decompress(embedded[8:], max_output_size=size)
    length = int.from_bytes(inner[:8], "little")
    told = msgspec.msgpack.decode(inner[8 : 8 + length])
    return told, inner[8 + length :]


@pytest.fixture(scope="module")
def turning():
    """100 steps of 2 x 1,200 points: a hand that turns as it goes, and dough whose every point goes its own way."""
    generator = np.random.default_rng(0)
    layout = Layout.build([("hand", 900), ("dough", 300)], driven=("hand",))
    hand, dough = generator.uniform(-0.05, 0.05, (900, 3)), generator.uniform(-0.05, 0.05, (300, 3))
    turns = roma.rotvec_to_rotmat(torch.linspace(0, 3, 100)[:, None] * torch.tensor([0.2, 0.3, 0.9])).numpy()
    path = np.linspace([0.4, -0.2, 0.1], [0.6, 0.2, 0.3], 100)
    hands = hand @ turns.swapaxes(1, 2) + path[:, None]
    doughs = dough + [0.6, 0.0, 0.05] + generator.normal(0, 0.01, (100, 300, 3))
    true = np.concatenate([hands, doughs], 1)
    off = 0.001 * np.arange(100)
    return TwinRecord(true + off[:, None, None], true, layout, off, title="<turning>", subtitle="a & b")


@pytest.fixture(scope="module")
def page(turning, tmp_path_factory):
    return write_html(turning, tmp_path_factory.mktemp("page") / "run.html", fps=10)


def test_a_page_is_small_and_loads_nothing(page):
    assert page.stat().st_size < 5e6
    text = page.read_text()
    assert "<title>&lt;turning&gt;</title>" in text and "a &amp; b" in text
    assert not re.search(r"""(?:src|href|action)\s*=\s*["']?(?:https?:)?//|url\(\s*["']?https?:|@import""", text)


def test_rigid_entities_are_sent_once_and_go_where_the_points_go(turning, page):
    told, _ = recorded(page.read_text())
    assert told["durationSeconds"] == pytest.approx(99 / 10 + 1.0)
    name = "/Simulator (true)/hand"
    clouds = [m for _, m in told["messages"] if m.get("name") == name and "props" in m]
    moves = {
        kind: {round(10 * t): m for t, m in told["messages"] if m["type"] == kind and m["name"] == name}
        for kind in ("SetPositionMessage", "SetOrientationMessage")
    }
    assert len(clouds) == 1 and list(moves["SetPositionMessage"]) == list(range(100))
    place = clouds[0]["props"]["points"]
    sizes = told["binaryBufferLengths"]
    largest = max(sizes)
    assert sizes.count(largest) <= 2 and largest == 900 * 3 * 2  # once a world at most, 16 bits a number
    assert place["dtype"] == "<f2"
    turn = roma.unitquat_to_rotmat(torch.tensor(moves["SetOrientationMessage"][60]["wxyz"])[[1, 2, 3, 0]]).numpy()
    position = np.array(moves["SetPositionMessage"][60]["position"])
    centred = turning.true[0, :900] - turning.true[0, :900].mean(0)
    np.testing.assert_allclose(centred @ turn.T + position, turning.true[60, :900], atol=1e-4)


def test_other_points_are_sent_at_every_step(page):
    told, _ = recorded(page.read_text())
    sent = [m for _, m in told["messages"] if m.get("name") == "/Simulator (true)/dough" and "updates" in m]
    assert len(sent) == 99 and all("points" in m["updates"] for m in sent)


def test_the_command_writes_what_is_asked_for(tmp_path, scene, capsys):
    poses = np.repeat(scene.poses[:1], 2, 0)
    nothing = np.zeros(1)
    run = Run(scene, 0, True, np.zeros((1, 7), np.float32), nothing, nothing, poses, poses[1:], nothing)
    run.save(tmp_path / "run.npz")
    html, gif, mp4 = (tmp_path / "new" / f"run.{kind}" for kind in ("html", "gif", "mp4"))
    main(
        ["view", str(tmp_path / "run.npz"), "--html", str(html), "--gif", str(gif), "--mp4", str(mp4), "--panel", "200"]
    )
    told = capsys.readouterr().out
    assert all(str(path) in told and path.stat().st_size > 10_000 for path in (html, gif, mp4))
    assert "viser" not in told and len(list(tmp_path.iterdir())) == 2  # nothing is written that was not asked for
    assert "reward 0.00 predicted, 0.00 true" in html.read_text()


def test_what_cannot_be_written_is_named(record, tmp_path, monkeypatch):
    with pytest.raises(PwmGymError, match="fps=0; expected a positive rate"):
        write_html(record, tmp_path / "run.html", fps=0)
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[viewer\]'"):
        write_html(record, tmp_path / "run.html")
    assert not (tmp_path / "run.html").exists()


@pytest.mark.skipif(browser.CHROMIUM is None, reason="no chromium or google-chrome on the PATH")
def test_a_browser_without_network_plays_it(record, tmp_path):
    path = write_html(replace(record, goal=None), tmp_path / "run.html", fps=2)
    with browser.opened(path, tmp_path / "profile", (420, 560)) as page:
        step = "document.querySelector('#panel output').textContent"
        assert page.wait_for(f"{step}.startsWith('step ') && {step}").endswith("true")
        cursor = "document.querySelector('#panel svg > line').getAttribute('x1')"
        before = page.value(cursor)
        later = page.wait_for(f"!{step}.startsWith('step 0 ') && {step}")
        assert re.match(r"step [1-9] / 9 · error [1-9]\.0 mm · reward -0\.0\d predicted, 0\.00 true", later)
        assert float(page.value(cursor)) > float(before)
        drawn = np.asarray(Image.open(io.BytesIO(page.canvas())).convert("RGB"), int)
        red, green, _ = np.moveaxis(drawn, -1, 0)
        assert (green - red > 30).sum() > 20 and (red - green > 30).sum() > 20  # both worlds' colours
        assert not page.errors
        assert not [a for a in page.requests if not a.startswith(("file:", "data:", "blob:"))]
