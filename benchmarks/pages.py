# SPDX-License-Identifier: Apache-2.0
"""How a page stands in a real browser at a width: what is cut off, what lies over what; and pictures of it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from string import Template

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WIDTHS = (1300, 390)
"""px: a screen, and a telephone."""
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--hide-scrollbars", "--disable-background-networking", "--disable-component-update",
         "--force-device-scale-factor=1", "--allow-file-access-from-files", "--virtual-time-budget=8000")  # fmt: skip
_FRAME = Template((Path(__file__).parent / "page.html").read_text(encoding="utf-8"))


def measured(browser: str, page: Path, width: int, folder: Path) -> tuple[list[str], int] | None:
    """What is cut or overlaps in a page of `width` px, and the page's height in px; None where the browser does not start."""
    frame = page.with_name(f".{page.stem}-{width}.html")
    frame.write_text(_FRAME.substitute(name=page.name, width=width, height=1200), encoding="utf-8")
    command = [
        browser,
        *FLAGS,
        f"--user-data-dir={folder / 'profile'}",
        "--window-size=1400,1300",
        "--dump-dom",
        frame.as_uri(),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    except subprocess.TimeoutExpired:
        return None
    finally:
        frame.unlink()
    match = re.search(r'<pre id="measured">(.*?)</pre>', done.stdout, re.DOTALL)
    if match is None:
        return None
    plain = json.loads(unescape(match[1]))
    return list(plain["found"]), int(plain["height"])


def checked(page: Path, folder: Path, picture: str = "") -> str:
    """Why a page cannot be looked at here, '' where it was; raises AssertionError where something is cut off or covered.

    With TRUEUP_PICTURES a picture of the page goes to docs/images/report-PICTURE.png; of the page FOLDER/PICTURE/report.html
    instead, where that variable names a folder in which there is one.
    """
    if BROWSER is None:
        return "no Chromium to open the report with"
    for width in WIDTHS:
        found = measured(BROWSER, page, width, folder)
        if found is None:
            return "the browser does not start here"
        if found[0]:
            raise AssertionError(f"{page.name} at {width} px: " + "; ".join(found[0]))
    given = os.environ.get("TRUEUP_PICTURES", "")
    if given and picture:
        real = Path(given) / picture / "report.html"
        photographed(BROWSER, real if real.is_file() else page, IMAGES / f"report-{picture}.png", folder)
    return ""


def photographed(browser: str, page: Path, picture: Path, folder: Path) -> None:
    """Writes a PNG of the top of a page."""
    command = [browser, *FLAGS, f"--user-data-dir={folder / 'profile'}", f"--window-size={WIDTHS[0]},1100",
               f"--screenshot={picture}", page.as_uri()]  # fmt: skip
    subprocess.run(command, capture_output=True, timeout=90, check=True)
