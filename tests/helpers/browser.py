"""A headless Chromium that shows a file, by its DevTools protocol: requests, the page's text and a screenshot."""

import base64
import itertools
import json
import shutil
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
"""Path of a browser, or None."""
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--disable-gpu-watchdog",  # a software renderer on a busy machine is slow, not hung
    "--remote-debugging-port=0",
)

# What WebGL has drawn can be read later, too.
_KEEP_PIXELS = """
const made = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return made.call(this, kind, {...options, preserveDrawingBuffer: true});
};
"""


class Page:
    """One tab. ``requests`` are the addresses that it asked for so far, ``errors`` its uncaught errors."""

    def __init__(self, socket):
        self.requests, self.errors = [], []
        self._socket, self._numbers = socket, itertools.count(1)
        for domain in ("Page", "Network", "Runtime"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """Result of one command."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=240))
            if message.get("method") == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])
            if message.get("method") == "Runtime.exceptionThrown":
                self.errors.append(message["params"]["exceptionDetails"])
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]

    def value(self, expression):
        """What a JavaScript expression gives."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def wait_for(self, expression, seconds=60):
        """The value of an expression once it is true."""
        end = time.monotonic() + seconds
        while not (value := self.value(expression)):
            assert time.monotonic() < end, f"{expression} is {value!r} after {seconds} s"
            time.sleep(0.1)
        return value

    def canvas(self):
        """PNG of the largest canvas, as it was drawn last."""
        largest = "[...document.querySelectorAll('canvas')].sort((a, b) => b.width * b.height - a.width * a.height)[0]"
        return base64.b64decode(self.value(f"{largest}.toDataURL('image/png')").split(",")[1])

    def screenshot(self):
        """PNG of the window."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])


def _address(told, seconds=60):
    """Where a browser that has just been started listens; it tells in a file: the port, and the path."""
    end = time.monotonic() + seconds
    while not told.exists() or len(lines := told.read_text().split()) < 2:
        assert time.monotonic() < end, f"the browser has not written {told} after {seconds} s"
        time.sleep(0.1)
    return f"ws://127.0.0.1:{lines[0]}{lines[1]}"


@contextmanager
def opened(path, folder, size=(1200, 760)):
    """A tab that shows a file; ``folder`` is for the browser's own files."""
    from websockets.sync.client import connect

    flags = (*_FLAGS, f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}")
    process = subprocess.Popen([CHROMIUM, *flags, "about:blank"], stderr=subprocess.DEVNULL)
    try:
        root = _address(Path(folder) / "DevToolsActivePort")
        with connect(root, max_size=None, proxy=None) as socket:
            browser = Page.__new__(Page)
            browser.requests, browser.errors = [], []
            browser._socket, browser._numbers = socket, itertools.count(1)
            targets = browser.call("Target.getTargets")["targetInfos"]
            tab = next(t["targetId"] for t in targets if t["type"] == "page")
        with connect(root.split("/devtools")[0] + f"/devtools/page/{tab}", max_size=None, proxy=None) as socket:
            page = Page(socket)
            page.call("Page.addScriptToEvaluateOnNewDocument", source=_KEEP_PIXELS)
            page.call("Page.navigate", url=f"file://{path}")
            yield page
    finally:
        process.terminate()
        process.wait(timeout=10)
