# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What stands for hardware goes before what is software, where the system allows it."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
import platform
import struct
import threading

# Niceness at which a thread gets nine times the processor time of an ordinary one.
EAGER = -10
# Niceness at which it gets three times that, and a third of an eager one's.
KEEN = -5
AUTOGROUP = Path('/proc/self/autogroup')
# The system call sched_setattr, and nanoseconds for which a thread that runs seldom wants to run.
SCHED_SETATTR = {'x86_64': 314, 'aarch64': 274}
SLICE = 100_000


def before_others() -> bool:
    """
    Run this thread, which sends bytes at their times, before all ordinary ones.

    Where that is not allowed, it asks at least for short turns, which Linux 6.12 and later gives
    sooner; nobody needs a right for that.

    Returns
    -------
    bool
        Whether it is allowed.

    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except (OSError, AttributeError):
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


def behind_the_eager() -> None:
    """
    Let threads with little to do, such as an estimator's, go before this one, which casts rays.

    It works ahead by a second and is not to hold up for whole batches what is being measured:
    real scanners take no processor time at all.
    """
    try:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), KEEN)
    except OSError:
        pass


def _take_short_turns() -> None:
    """Ask for turns of `SLICE`; older kernels take no notice."""
    number = SCHED_SETATTR.get(platform.machine())
    if number is not None:
        # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period
        attributes = struct.pack('=IIQiIQQQ', 48, os.SCHED_OTHER, 0, 0, 0, SLICE, 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)
