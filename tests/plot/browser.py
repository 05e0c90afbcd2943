"""A headless Chromium or Chrome, driven through its DevTools socket."""

import base64
import itertools
import json
import shutil
import subprocess
import time
import urllib.request

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find() -> str | None:
    """Path of a browser, if there is one."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """One page of a browser of its own, until the block ends."""

    def __init__(self, path: str, folder, size: tuple[int, int] = (900, 600)):
        self.log = open(folder / "browser.log", "w")  # noqa: SIM115
        # WebGL in software: test machines have no GPU. No sandbox: they may be root.
        flags = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        flags += ["--remote-debugging-port=0", "--remote-allow-origins=*", "--disable-dev-shm-usage"]
        flags += [
            f"--user-data-dir={folder / 'profile'}",
            f"--window-size={size[0]},{size[1]}",
            "about:blank",
        ]
        self.process = subprocess.Popen([path, *flags], stdout=self.log, stderr=subprocess.STDOUT)
        self.folder, self.numbers = folder, itertools.count(1)

    def __enter__(self) -> "Browser":
        from websockets.sync.client import connect

        answer = self.folder / "profile" / "DevToolsActivePort"
        until(lambda: answer.exists() and "\n" in answer.read_text(), 60, "the browser to start")
        self.port = int(answer.read_text().split()[0])
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{self.port}/json/list"))
        (page,) = (each for each in pages if each["type"] == "page")
        self.socket = connect(page["webSocketDebuggerUrl"], max_size=None)
        self.ask("Page.enable")
        return self

    def __exit__(self, *_) -> None:
        self.socket.close()
        self.process.terminate()
        self.process.wait(30)
        self.log.close()

    def ask(self, method: str, **parameters) -> dict:
        """The answer of one command of the DevTools protocol."""
        number = next(self.numbers)
        self.socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.socket.recv(timeout=120))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def open(self, url: str) -> None:
        self.ask("Page.navigate", url=url)

    def evaluate(self, expression: str):
        """The value of a JavaScript expression."""
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def text(self) -> str:
        """All text of the page."""
        return self.evaluate("document.body ? document.body.innerText : ''") or ""

    def picture(self) -> bytes:
        """The page as a PNG."""
        return base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])

    def mouse(self, kind: str, x: float, y: float, buttons: int = 0) -> None:
        """mouseMoved, mousePressed or mouseReleased at a place [pixels]."""
        button = "left" if buttons or kind == "mouseReleased" else "none"
        self.ask(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons, clickCount=1
        )

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
        """Press the button at one place and release it at another."""
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start, buttons=1)
        for k in range(1, steps + 1):
            here = [a + (b - a) * k / steps for a, b in zip(start, end, strict=True)]
            self.mouse("mouseMoved", *here, buttons=1)
        self.mouse("mouseReleased", *end)


def until(true, seconds: float, what: str) -> None:
    """Wait for something to be true."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, f"waited {seconds} s for {what}"
        time.sleep(0.2)
