# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What stands for hardware goes before what is software, where the system allows it."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
import platform
import struct

# Real-time priorities: bytes go before the rays that later ones are made of.
CASTING, SENDING = 1, 2
# Niceness at which a thread gets nine times the processor time of an ordinary one.
EAGER = -10
AUTOGROUP = Path('/proc/self/autogroup')
# The system call sched_setattr, and nanoseconds for which a thread that runs seldom wants to run.
SCHED_SETATTR = {'x86_64': 314, 'aarch64': 274}
SLICE = 100_000


def before_others(priority: int) -> bool:
    """
    Run this thread before all ordinary ones.

    Where that is not allowed, who sends asks at least for short turns, which Linux 6.12 and
    later gives sooner; nobody needs a right for that.

    Returns
    -------
    bool
        Whether it is allowed.

    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
    except (OSError, AttributeError):
        if priority == SENDING:
            _take_short_turns()
        return False
    return True


def ahead_of_others() -> bool:
    """
    Give this thread, and those it will start, nine times an ordinary one's share.

    Returns
    -------
    bool
        Whether that is allowed.

    """
    try:
        os.setpriority(os.PRIO_PROCESS, 0, EAGER)
        # Linux shares out among sessions first: within one, niceness counts for nothing outside
        if os.getsid(0) == os.getpid() and AUTOGROUP.exists():
            AUTOGROUP.write_text(str(EAGER), encoding='ascii')
    except OSError:
        return False
    return True


def _take_short_turns() -> None:
    """Ask for turns of `SLICE`; older kernels take no notice."""
    number = SCHED_SETATTR.get(platform.machine())
    if number is not None:
        # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period
        attributes = struct.pack('=IIQiIQQQ', 48, os.SCHED_OTHER, 0, 0, 0, SLICE, 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)
