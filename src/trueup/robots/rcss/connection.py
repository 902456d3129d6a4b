# SPDX-License-Identifier: Apache-2.0
"""Messages over TCP as RoboCup servers exchange them: a length in four bytes, the highest first, then so many bytes."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from types import TracebackType

from trueup.errors import TrialError

LONGEST = 1 << 20
"""Bytes of a message: a server's own have some thousand; whatever asks for more speaks another protocol."""


class Connection:
    """To one server, closed at the end of a `with`. Raises TrialError, which says what to do, where none answers."""

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._where, self._timeout = f"{host}:{port}", timeout
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except (OSError, OverflowError) as error:
            raise TrialError(
                f"no RoboCup server answers at {self._where} ({error}): start one, such as `rcssservermj --sync "
                "--no-realtime --no-render`, or say in [robot] where it is: host, port"
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __enter__(self) -> Connection:
        """Itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Leaves, and takes what is still on its way: a server that meets a closed door may come down with it."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
            until = time.monotonic() + self._timeout
            while (left := until - time.monotonic()) > 0.0:
                self._socket.settimeout(left)
                if not self._socket.recv(1 << 16):
                    break
        self._socket.close()

    def send(self, message: str) -> None:
        """Raises TrialError where the server is gone."""
        body = message.encode()
        try:
            self._socket.settimeout(self._timeout)
            self._socket.sendall(struct.pack(">I", len(body)) + body)
        except OSError as error:
            raise self._lost(error) from None

    def receive(self) -> bytes:
        """The next message. Raises TrialError for silence, for an end in the midst of it, and for an impossible length."""
        until = time.monotonic() + self._timeout
        (length,) = struct.unpack(">I", self._exactly(4, until))
        if length > LONGEST:
            raise TrialError(
                f"the server at {self._where} announces a message of {length} bytes, and {LONGEST} are the most: it "
                "speaks another protocol; is this the port for agents (60000 of rcssservermj, 3100 of rcssserver3d)?"
            )
        return self._exactly(length, until)

    def _exactly(self, count: int, until: float) -> bytes:
        parts, missing = [], count
        while missing:
            try:
                self._socket.settimeout(max(until - time.monotonic(), 1e-3))
                part = self._socket.recv(missing)
            except TimeoutError:
                raise TrialError(
                    f"the server at {self._where} sent nothing whole for {self._timeout:g} s: it has stopped, or waits for "
                    "another agent"
                ) from None
            except OSError as error:
                raise self._lost(error) from None
            if not part:
                got = count - missing
                raise self._lost(
                    f"in the midst of a message, {got} of {count} bytes" if got else "closed by the server"
                )
            parts.append(part)
            missing -= len(part)
        return b"".join(parts)

    def _lost(self, why: object) -> TrialError:
        return TrialError(f"the connection to the RoboCup server at {self._where} was lost: {why}")
