# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What all tests have in common: no deadlines that a busy machine could miss."""

import signal

from hypothesis import settings
import pytest

# Real processes over DDS and pseudo terminals, at true times.  Another process that takes the
# machine for a second makes a scan late or lost, which is what they look for: tried again.
REAL_TIME = ('test_node_', 'test_graph_', 'test_recording', 'test_live_', 'test_lms_device',
             'test_lms_network', 'test_lms_emulator_ports', 'test_command_lms')

settings.register_profile('suite', deadline=None)
settings.load_profile('suite')
# A script that runs the suite in the background has it ignore SIGINT, and so would every process
# that a test starts and then stops by it.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """Let tests at true times run up to three times."""
    for item in items:
        if item.path.name.startswith(REAL_TIME):
            item.add_marker(pytest.mark.flaky(reruns=2))
