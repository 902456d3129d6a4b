# SPDX-License-Identifier: Apache-2.0
"""A film strip: pictures of a run side by side, one row a run (simulation above, robot below), in one SVG that holds them."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.errors import ParameterError
from trueup.report.drawing import EDGE, HEAD, WIDTH, document, title, words
from trueup.report.markup import tag

Pictures = NDArray[np.uint8]


def film_strip(rows: Mapping[str, Pictures], time: Sequence[float], about: str) -> str:
    """An SVG of rows by name, each (n, height, width, 3) pictures at n instants in s, which are written below.

    Raises ParameterError where a row has not as many pictures as there are instants.
    """
    for name, pictures in rows.items():
        if len(pictures) != len(time):
            raise ParameterError(
                f"row '{name}' of the film strip has {len(pictures)} pictures for {len(time)} instants"
            )
    across = (WIDTH - 2 * EDGE) / max(len(time), 1)
    parts, y = [title(about)], float(HEAD)
    for name, pictures in rows.items():
        parts.append(words(name, EDGE, y + 13, bold=True, colour="soft"))
        y += 20  # for its name
        high = across * pictures.shape[1] / pictures.shape[2]
        for k, picture in enumerate(pictures):
            shown = "data:image/png;base64," + base64.b64encode(png(picture)).decode("ascii")
            parts.append(tag("image", href=shown, x=EDGE + k * across, y=y, width=across, height=high))
        y += high + 6
    for k, t in enumerate(time):
        parts.append(words(f"{t:.2f} s", EDGE + (k + 0.5) * across, y + 14, anchor="middle", colour="soft"))
    return document(parts, y + 28, about)


def png(picture: Pictures) -> bytes:
    """The PNG file of a picture (height, width, 3) with eight bits a colour (W3C PNG, rows filtered by 'up')."""
    height, width, _ = picture.shape
    rows = picture.reshape(height, -1)
    above = np.vstack([np.zeros_like(rows[:1]), rows[:-1]])
    lines = np.column_stack([np.full(height, 2, dtype=np.uint8), rows - above])

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(np.ascontiguousarray(lines).tobytes(), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")
