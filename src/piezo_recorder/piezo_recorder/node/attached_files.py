# SPDX-License-Identifier: BSD-3-Clause
"""Attachments of a recording that are given as path and hash of a file."""

import hashlib
from collections.abc import Callable
from itertools import zip_longest

from piezo_interfaces.srv import StartRecording

from piezo_common.regular_file import open_regular

MOST_BYTES = 64_000_000
"""Largest size of an attachment; a model of 1000 levels has a third of it."""


def read_attachments(request: StartRecording.Request, readable: Callable[[str], str],
                     ) -> tuple[dict[str, bytes], list[str], str]:
    """Read the attachments of a recording; return them with the names of the unread ones and why.

    Files are unread that cannot be read, or have changed since the request; the reason is empty if
    everything was read. `readable` returns the path of a file to read, and raises ValueError if it
    must not be read.
    """
    contents, unread, reasons = {}, [], []
    for name, content, path, sha256 in zip_longest(
            request.attachment_names, request.attachment_contents, request.attachment_paths,
            request.attachment_sha256, fillvalue=""):
        contents[name] = content.encode()
        if not path:
            continue
        try:
            contents[name] = _read(readable(path), sha256)
        except (OSError, ValueError) as error:
            unread.append(name)
            reasons.append(f"the attachment {name} cannot be kept: {path!r}: "
                           f"{getattr(error, 'strerror', None) or error}")
    return contents, unread, reasons and f"{'; '.join(reasons)}; send its content instead." or ""


def _read(path: str, sha256: str) -> bytes:
    """Return the content of a file; raise ValueError unless it is what the client has read."""
    with open_regular(path, MOST_BYTES) as file:
        content = file.read(MOST_BYTES)
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ValueError("has another sha256 than the request states")
    return content
