"""What systemd is told of a line: that it is ready, and that it still works."""

from __future__ import annotations

import os
import socket
from contextlib import suppress

UNIT = """\
[Unit]
Description=roemetry line {name}
After=network-online.target
Wants=network-online.target
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={python} -m roemetry serve {path} --start-anyway
WorkingDirectory={home}
Environment=NUMBA_CACHE_DIR={folder}/kernels
TimeoutStartSec=600
WatchdogSec=20
Restart=always
RestartSec=2
CPUWeight=1000
KillMode=mixed
TimeoutStopSec=60
ProtectSystem=strict
ProtectHome=read-only
ReadWritePaths={folder}
PrivateTmp=yes
NoNewPrivileges=yes

[Install]
WantedBy=multi-user.target
"""


def tell_systemd(what: str) -> None:
    """Send a word such as ``READY=1``; nothing where systemd has not started this process."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.sendto(what.encode(), "\0" + address[1:] if address[0] == "@" else address)
